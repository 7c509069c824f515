"""The fit of one or two lenses to boards: start, robust fit, corners left out, linear fit; and what it is worth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import RigidTransform

from calibration.bearings import cross_matrices
from calibration.least_squares import MEDIAN_LENGTH
from calibration.lenses.linking import link
from calibration.lenses.models import LensModel
from calibration.lenses.problem import BoardView, LensProblem, Rig, adjust, shared_covariance
from calibration.lenses.start import first_fisheye, start_model
from palletloc.errors import PalletLocError
from palletloc.geometry import BoolArray, FloatArray

_FEWEST_SHOTS, _EVERY = 8, 4
"""Views are held out of eight shots or more, every fourth one: fewer leave too few boards to the fit."""
_AZIMUTHS = 16
"""Directions around the axis in which bearings are looked at: every 22.5 degrees."""
_OUTLIER = 4.0
"""Corners beyond this many robust standard deviations are left out: one good corner in 3000."""
_FEWEST_CORNERS = 6
"""A view with fewer corners counts for nothing: its own pose takes three of them."""
_ROUNDS = 3
"""Robust fits, each with the scatter of the one before; the third hardly changes it."""


class NoStartError(PalletLocError):
    """Boards from which no first lens follows."""


@dataclass(frozen=True, slots=True, eq=False)
class LensFit:
    """The result of a fit."""

    problem: LensProblem
    """All corners that the models can image."""
    rig: Rig
    """The solution."""
    used: tuple[BoolArray, ...]
    """Of each view, which corners the last fit took."""
    sigma_factor: float
    """How much larger the corners' errors are than their stated sigma."""
    covariance: FloatArray
    """(g, g) of the shared unknowns, by the corners' own scatter, not below their stated sigma."""
    plain_rms: float
    """Root mean square distance in pixels of a plain fit to every corner, as other programs state it."""
    dropped: tuple[str, ...] = ()
    """Views without a pose, or with too few corners that the model can image."""

    @property
    def residuals(self) -> tuple[FloatArray, ...]:
        """(n, 2) predicted minus seen, of each view, in pixels."""
        all_of_them = self.problem.linearize(self.rig).residuals
        parts = np.split(all_of_them, np.cumsum([len(view.points) for view in self.problem.views])[:-1])
        return tuple(part * view.sigma[:, None] for part, view in zip(parts, self.problem.views, strict=True))

    def corner_rays(self, lens: int) -> FloatArray:
        """Return the directions of a lens's used corners in its own frame, (n, 3)."""
        rays = [
            self.rig.lens_from_board(view).apply(view.points[used])
            for view, used in zip(self.problem.views, self.used, strict=True)
            if view.lens == lens
        ]
        return np.concatenate(rays)

    def rms(self, *, every: bool = False) -> float:
        """Return the root mean square of the corners' distances, in pixels: of those used, or of every one."""
        squared = [(part**2).sum(-1) for part in self.residuals]
        if not every:
            squared = [part[used] for part, used in zip(squared, self.used, strict=True)]
        return float(np.sqrt(np.concatenate(squared).mean()))

    @property
    def sigma(self) -> FloatArray:
        """(g,) standard deviations of the shared unknowns."""
        sigma: FloatArray = np.sqrt(np.diag(self.covariance))
        return sigma

    @property
    def correlation(self) -> FloatArray:
        """(g, g) correlations of the shared unknowns."""
        correlation: FloatArray = self.covariance / np.outer(self.sigma, self.sigma)
        return correlation


@dataclass(frozen=True, slots=True, eq=False)
class Aperture:
    """The part of the image that a lens fills."""

    center: FloatArray
    """(2,) its middle, in pixels."""
    width: float
    """In pixels."""


def fit_lenses(
    views: Sequence[BoardView], models: Sequence[LensModel], apertures: Sequence[Aperture], boards: int = 1
) -> LensFit:
    """Fit lenses and the poses of boards, from nothing but corners.

    Parameters
    ----------
    views : sequence of BoardView
        All that was seen.
    models : sequence of LensModel
        One for each lens.
    apertures : sequence of Aperture
        One for each lens.
    boards : int
        How many boards stand still against each other; 1 where each has a pose of its own in each shot.

    Returns
    -------
    LensFit
        With the outliers marked.

    Raises
    ------
    NoStartError
        If no lens explains the corners at all.
    UnlinkedError
        If the lenses or the boards have nothing in common.
    LinAlgError
        If the boards leave an unknown open.
    """
    started, values, poses = _start(views, models, apertures)
    names = {view.name for view in started}
    ordered = sorted(zip(started, poses, strict=True), key=lambda pair: pair[0].shot)
    numbers = {shot: i for i, shot in enumerate(dict.fromkeys(view.shot for view, _ in ordered))}
    kept = tuple(replace(view, shot=numbers[view.shot]) for view, _ in ordered)
    linked = link(kept, [pose for _, pose in ordered], len(models), boards)
    problem = LensProblem(kept, tuple(models), boards)
    dropped = tuple(view.name for view in views if view.name not in names)
    fits = []
    for i in range(max(len(starts) for starts in values)):
        chosen = tuple(starts[min(i, len(starts) - 1)] for starts in values)
        fits.append(refined(problem, Rig(chosen, linked.lenses, linked.shots, linked.boards), dropped))
    return min(fits, key=lambda fit: fit.plain_rms)


def refined(problem: LensProblem, rig: Rig, dropped: tuple[str, ...] = (), free: BoolArray | None = None) -> LensFit:
    """Return the fit from a start near it: robust first, then linear without the outliers.

    Parameters
    ----------
    problem : LensProblem
        The observations.
    rig : Rig
        Where to begin.
    dropped : tuple of str
        Views that are not among them.
    free : (g,) array of bool, optional
        Which shared unknowns may change; all by default.

    Raises
    ------
    LinAlgError
        If the observations leave an unknown open.
    """
    for _ in range(_ROUNDS):
        rig = adjust(problem, rig, free, robust=2 * _scatter(problem, rig))
    used = _inliers(problem, rig)
    clean, kept_shots = _without(problem, used)
    solution = adjust(clean, replace(rig, shots=rig.shots[kept_shots]), free)
    poses = rig.shots.as_matrix()
    poses[kept_shots] = solution.shots.as_matrix()
    residuals = clean.linearize(solution).residuals
    width = len(clean.names()) if free is None else int(free.sum())
    redundancy = residuals.size - width - 6 * len(kept_shots)
    factor = float(np.sqrt((residuals**2).sum() / max(redundancy, 1)))
    covariance = max(factor, 1.0) ** 2 * shared_covariance(clean, solution, free)
    solution = replace(solution, shots=RigidTransform.from_matrix(poses))
    return LensFit(problem, solution, used, factor, covariance, _plain_rms(problem, solution, free), dropped)


def _plain_rms(problem: LensProblem, rig: Rig, free: BoolArray | None) -> float:
    sigma = np.concatenate([view.sigma for view in problem.views])
    residuals = problem.linearize(adjust(problem, rig, free)).residuals * sigma[:, None]
    return float(np.sqrt((residuals**2).sum(-1).mean()))


def _scatter(problem: LensProblem, rig: Rig) -> float:
    """Return the typical standard deviation of a residual, in stated sigmas, by its median."""
    sizes = np.linalg.norm(problem.linearize(rig).residuals, axis=-1)
    return float(np.nanmedian(sizes)) / MEDIAN_LENGTH + 1e-9


def _inliers(problem: LensProblem, rig: Rig) -> tuple[BoolArray, ...]:
    """Return which corners are no outliers; a view with too few of them counts for nothing."""
    sizes = np.linalg.norm(problem.linearize(rig).residuals, axis=-1)
    good = sizes < _OUTLIER * _scatter(problem, rig)
    parts = np.split(good, np.cumsum([len(view.points) for view in problem.views])[:-1])
    return tuple(part if part.sum() >= _FEWEST_CORNERS else np.zeros_like(part) for part in parts)


def _without(problem: LensProblem, used: Sequence[BoolArray]) -> tuple[LensProblem, list[int]]:
    """Return the problem with the used corners only, and the shots that it still has."""
    views = [view.kept(keep) for view, keep in zip(problem.views, used, strict=True) if keep.any()]
    shots = list(dict.fromkeys(view.shot for view in views))
    numbered = tuple(replace(view, shot=shots.index(view.shot)) for view in views)
    return replace(problem, views=numbered), shots


def _start(
    views: Sequence[BoardView], models: Sequence[LensModel], apertures: Sequence[Aperture]
) -> tuple[list[BoardView], list[list[FloatArray]], list[RigidTransform]]:
    """Return the views that have a pose, parameters for each lens to begin with, and those poses."""
    kept, values, poses = list[BoardView](), list[list[FloatArray]](), list[RigidTransform]()
    for lens, (model, aperture) in enumerate(zip(models, apertures, strict=True)):
        own = [view for view in views if view.lens == lens and len(view.points) >= _FEWEST_CORNERS]
        fisheye, found = first_fisheye(own, aperture.center, aperture.width)
        posed = [(view, pose) for view, pose in zip(own, found, strict=True) if pose is not None]
        if not posed:
            raise NoStartError(f"no board of lens {lens} has a pose; expected whole boards, seen sharply")
        started, near = start_model(model, fisheye, [view for view, _ in posed], [pose for _, pose in posed])
        values.append(started)
        for (view, pose), keep in zip(posed, near, strict=True):
            if keep.sum() >= _FEWEST_CORNERS:
                kept.append(view.kept(keep))
                poses.append(pose)
    return kept, values, poses


def hold_out_rms(fit: LensFit) -> float:
    """Return the root mean square distance in pixels over every fourth shot, with lenses fitted to the others.

    Parameters
    ----------
    fit : LensFit
        Its outliers stay left out.

    Returns
    -------
    float
        NaN where there are fewer than 8 shots.
    """
    shots = sorted({view.shot for view, used in zip(fit.problem.views, fit.used, strict=True) if used.any()})
    if len(shots) < _FEWEST_SHOTS:
        return float("nan")
    held = set(shots[_EVERY - 1 :: _EVERY])
    rest = _part(fit, [shot for shot in shots if shot not in held])
    fitted = adjust(*rest)
    problem, rig = _part(fit, sorted(held))
    rig = replace(rig, values=fitted.values, lenses=fitted.lenses, boards=fitted.boards)
    rig = adjust(problem, rig, np.zeros(len(problem.names()), dtype=np.bool_))
    sigma = np.concatenate([view.sigma for view in problem.views])
    residuals = problem.linearize(rig).residuals * sigma[:, None]
    return float(np.sqrt((residuals**2).sum(-1).mean()))


def _part(fit: LensFit, shots: list[int]) -> tuple[LensProblem, Rig]:
    """Return the observations of some shots, and the rig with their poses."""
    views = tuple(
        replace(view.kept(used), shot=shots.index(view.shot))
        for view, used in zip(fit.problem.views, fit.used, strict=True)
        if view.shot in shots and used.any()
    )
    return replace(fit.problem, views=views), replace(fit.rig, shots=fit.rig.shots[shots])


def bearing_sigma(model: LensModel, values: FloatArray, covariance: FloatArray, angles: FloatArray) -> FloatArray:
    """Return the standard deviation of bearings at angles off axis, in radians, the largest around the axis.

    A common rotation of all bearings is left out: it belongs to the mounting.

    Parameters
    ----------
    model : LensModel
        Of the lens.
    values : (k,) array
        Its parameters.
    covariance : (k, k) array
        Their covariance.
    angles : (n,) array
        Off axis, in radians; the model must image them.
    """
    around = 2 * np.pi * np.arange(_AZIMUTHS) / _AZIMUTHS
    angle, azimuth = (grid.ravel() for grid in np.meshgrid(angles, around, indexing="ij"))
    rays = np.stack([np.cos(angle), np.sin(angle) * np.cos(azimuth), np.sin(angle) * np.sin(azimuth)], axis=-1)
    imaged = model.evaluate(values, rays)
    # How a bearing turns when its pixel moves: the inverse of the derivative, across the ray.
    across = np.linalg.pinv(imaged.by_ray)
    moved = (across @ imaged.by_values).reshape(-1, len(values))
    turned = -cross_matrices(rays).reshape(-1, 3)
    moved = moved - turned @ np.linalg.lstsq(turned, moved, rcond=None)[0]
    by_ray = moved.reshape(len(rays), 3, -1)
    variance = np.einsum("nij,jk,nik->ni", by_ray, covariance, by_ray).sum(-1)
    sigma: FloatArray = np.sqrt(variance).reshape(len(angles), -1).max(-1)
    return sigma
