"""The drive past a shelf as one least-squares problem: poses, odometry's faults, pallets and upright edges."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from calibration.drive import Drive, compose, relative
from calibration.shelf.pallets import PalletObservation
from palletloc.geometry import FloatArray, wrap_angle

_JOIN = 0.35
"""Sights that differ by less in place and height, in metres, show one pallet: less than half of its width."""
_INFLATION = 2.0
"""Factor on the variances of the localizer's poses, by judgement: neighbouring shots see a face in the same light,
and err alike."""
_FLOOR = np.array([0.002, 0.002, 0.0015])
"""Standard deviations of a pose at least, in metres and radians: what camera model and mounting add."""
_DRIFT = 3
"""Unknowns of the odometry: scale, bias, and the mounting's yaw."""
_ROBUST = 2.0
"""Residuals well beyond this many standard deviations count by their size (soft l1)."""


@dataclass(frozen=True, slots=True, eq=False)
class EdgeObservation:
    """One vertical edge in one shot."""

    shot: int
    """Index of the shot."""
    edge: int
    """Index of the edge."""
    azimuth: float
    """Where it is seen from the camera, in the forklift frame, in radians."""
    sigma: float
    """Standard deviation, in radians."""


@dataclass(frozen=True, slots=True, eq=False)
class Observed:
    """All that ties poses and landmarks together."""

    drive: Drive
    """Odometry."""
    camera: FloatArray
    """(2,) the camera's place in the forklift frame, in metres."""
    pallets: tuple[PalletObservation, ...] = ()
    """Pallets in shots."""
    pallet_of: NDArray[np.intp] = field(default_factory=lambda: np.zeros(0, np.intp))
    """Which pallet each of them is."""
    edges: tuple[EdgeObservation, ...] = ()
    """Vertical edges in shots."""


@dataclass(frozen=True, slots=True, eq=False)
class DriveSolution:
    """A solution."""

    scale: float
    """True distance over the odometry's."""
    bias: float
    """Error of its yaw rate, in radians per second."""
    yaw: float
    """By how much all is seen turned about the camera's upright axis, in radians; zero unless it was asked for."""
    poses: FloatArray
    """(n, 3) ``odom_from_forklift`` at the shots: x, y, yaw."""
    pallets: FloatArray
    """(m, 3) ``odom_from_pallet``: x, y, yaw."""
    edges: FloatArray
    """(k, 2) places of vertical edges in odom."""
    covariance: FloatArray
    """Of all parameters in this order: scale, bias and yaw (in units of their priors), poses, pallets, edges."""
    pallet_errors: FloatArray
    """(p, 3) residuals of the pallets' sights, in standard deviations."""
    edge_errors: FloatArray
    """(e,) residuals of the edges' sights, in standard deviations."""

    def landmark_covariance(self) -> tuple[FloatArray, FloatArray]:
        """Return the covariance of all pallets' parameters, and that of all edges'."""
        first = _DRIFT + self.poses.size
        middle = first + self.pallets.size
        return self.covariance[first:middle, first:middle], self.covariance[middle:, middle:]


def solve(observed: Observed, edges: FloatArray | None = None, yaw_sigma: float = 0.0) -> DriveSolution:
    """Find the poses, pallets and edges that fit best.

    Parameters
    ----------
    observed : Observed
        What was seen.
    edges : (k, 2) array, optional
        Where the edges are about, in odom; none if left out.
    yaw_sigma : float
        How far the mounting's yaw may be off, in radians; it is estimated where that is not zero.

    Returns
    -------
    DriveSolution
        Robust against single wrong sights.
    """
    problem = _Problem(observed, 0 if edges is None else len(edges), yaw_sigma)
    start = problem.start(np.zeros((0, 2)) if edges is None else edges)
    found = least_squares(problem.residuals, start, loss="soft_l1", f_scale=_ROBUST, x_scale="jac", max_nfev=60)
    jacobian = np.asarray(found.jac, dtype=np.float64)
    covariance = np.linalg.pinv(jacobian.T @ jacobian)
    return problem.unpack(np.asarray(found.x, dtype=np.float64), np.asarray(covariance, dtype=np.float64))


class _Problem:
    """The equations, for least_squares."""

    def __init__(self, observed: Observed, edges: int, yaw_sigma: float) -> None:
        self.yaw_sigma = yaw_sigma
        self.drive, self.camera = observed.drive, observed.camera
        self.shots = len(self.drive.steps)
        self.pallet_of = observed.pallet_of
        self.pallet_shot = np.array([sight.shot for sight in observed.pallets], np.intp)
        self.planar = np.array([sight.planar for sight in observed.pallets]).reshape(-1, 3)
        self.whiten = np.array([_whitener(sight.covariance) for sight in observed.pallets]).reshape(-1, 3, 3)
        self.pallets = int(self.pallet_of.max(initial=-1)) + 1
        self.edge_of = np.array([sight.edge for sight in observed.edges], np.intp)
        self.edge_shot = np.array([sight.shot for sight in observed.edges], np.intp)
        self.azimuth = np.array([sight.azimuth for sight in observed.edges])
        self.edge_sigma = np.array([sight.sigma for sight in observed.edges])
        self.edges = edges

    def start(self, edges: FloatArray) -> FloatArray:
        poses = self.drive.poses()
        pallets = np.zeros((self.pallets, 3))
        seen = compose(poses[self.pallet_shot], self.planar)
        for i in range(self.pallets):
            mine = seen[self.pallet_of == i]
            pallets[i, :2] = np.median(mine[:, :2], axis=0)
            pallets[i, 2] = mine[0, 2] + np.median(wrap_angle(mine[:, 2] - mine[0, 2]))
        return np.concatenate([np.zeros(_DRIFT), poses.ravel(), pallets.ravel(), edges.ravel()])

    def split(self, x: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        a = _DRIFT + 3 * self.shots
        b = a + 3 * self.pallets
        return (
            x[:_DRIFT] * (self.drive.noise.scale, self.drive.noise.bias, self.yaw_sigma) + (1.0, 0.0, 0.0),
            x[_DRIFT:a].reshape(-1, 3),
            x[a:b].reshape(-1, 3),
            x[b:].reshape(-1, 2),
        )

    def residuals(self, x: FloatArray) -> FloatArray:
        (scale, bias, yaw), poses, pallets, edges = self.split(x)
        before = np.concatenate([self.drive.start.as_array()[None, [0, 1, 3]], poses[:-1]])
        step = relative(before, poses) - self.drive.corrected(scale, bias)
        step[:, 2] = wrap_angle(step[:, 2])
        parts = [x[:_DRIFT], (step / self.drive.sigma).ravel()]
        parts += [self.pallet_errors(poses, pallets, yaw).ravel(), self.edge_errors(poses, edges, yaw)]
        return np.concatenate(parts)

    def pallet_errors(self, poses: FloatArray, pallets: FloatArray, yaw: float) -> FloatArray:
        center = np.array([*self.camera, 0.0])
        there = relative(poses[self.pallet_shot], pallets[self.pallet_of]) - center
        # Seen through a camera that is turned, all turns about the camera.
        off = compose(np.tile([*self.camera, yaw], (len(there), 1)), there) - self.planar
        off[:, 2] = wrap_angle(off[:, 2])
        return np.asarray(np.einsum("nij,nj->ni", self.whiten, off))

    def edge_errors(self, poses: FloatArray, edges: FloatArray, yaw: float) -> FloatArray:
        if not len(self.azimuth):
            return np.zeros(0)
        at = np.concatenate([edges[self.edge_of], np.zeros((len(self.edge_of), 1))], axis=1)
        x, y, _ = (relative(poses[self.edge_shot], at)).T
        azimuth = np.arctan2(y - self.camera[1], x - self.camera[0])
        return np.asarray(wrap_angle(azimuth + yaw - self.azimuth) / self.edge_sigma)

    def unpack(self, x: FloatArray, covariance: FloatArray) -> DriveSolution:
        (scale, bias, yaw), poses, pallets, edges = self.split(x)
        errors = self.pallet_errors(poses, pallets, yaw), self.edge_errors(poses, edges, yaw)
        return DriveSolution(float(scale), float(bias), float(yaw), poses, pallets, edges, covariance, *errors)


def _whitener(covariance: FloatArray) -> FloatArray:
    """Return the matrix that turns an error into standard deviations."""
    full = _INFLATION * covariance + np.diag(_FLOOR**2)
    return np.asarray(np.linalg.inv(np.linalg.cholesky(full)))


def same_pallets(
    drive: Drive, sights: Sequence[PalletObservation]
) -> tuple[list[PalletObservation], NDArray[np.intp]]:
    """Tell which sights show the same pallet, shot by shot along the way.

    Parameters
    ----------
    drive : Drive
        Odometry, for its drift is small from one sight of a pallet to the next.
    sights : sequence of PalletObservation
        In any order.

    Returns
    -------
    sights : list of PalletObservation
        Those of pallets that are seen at least twice.
    pallet : (n,) array of int
        Which pallet each is.
    """
    poses = drive.poses()
    newest: list[tuple[str, float, FloatArray]] = []
    ordered = sorted(sights, key=lambda sight: sight.shot)
    owner: list[int] = []
    for sight in ordered:
        at = compose(poses[sight.shot], sight.planar)
        near = [
            (float(np.hypot(*(at - place)[:2])), i)
            for i, (model, z, place) in enumerate(newest)
            if model == sight.model and abs(z - sight.pose.z) < _JOIN
        ]
        distance, index = min(near, default=(np.inf, -1))
        if distance > _JOIN:
            newest.append((sight.model, sight.pose.z, at))
            index = len(newest) - 1
        newest[index] = (sight.model, sight.pose.z, at)
        owner.append(index)
    counts = np.bincount(owner, minlength=len(newest)) if owner else np.zeros(0, int)
    kept = {int(old): new for new, old in enumerate(np.flatnonzero(counts >= 2))}
    chosen = [(sight, kept[i]) for sight, i in zip(ordered, owner, strict=True) if i in kept]
    return [sight for sight, _ in chosen], np.array([i for _, i in chosen], np.intp)
