"""Robust least squares over a bundle: the poses of shots are eliminated, so that many views take no time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.lenses.bundle import Bundle, Prediction, Rig
from palletloc.geometry import BoolArray, FloatArray

_MAX_STEPS, _SETTLED = 60, 1e-10
_DAMPING, _MOST_DAMPING = 1e-4, 1e12


@dataclass(frozen=True, slots=True, eq=False)
class _Normal:
    """Normal equations: shared unknowns, each shot, and what couples them."""

    shared: FloatArray
    by_shared: FloatArray
    shots: FloatArray
    by_shots: FloatArray
    coupling: FloatArray


def adjust(bundle: Bundle, start: Rig, free: BoolArray | None = None, robust: float = np.inf) -> Rig:
    """Return the rig with the least sum of losses, from a start near it.

    Parameters
    ----------
    bundle : Bundle
        The observations.
    start : Rig
        Where to begin.
    free : (g,) array of bool, optional
        Which shared unknowns may change; all by default.
    robust : float
        Residuals well beyond this many sigmas count by their size instead of their square (soft l1).
    """
    shots = bundle.shot_of
    rig, damping = start, _DAMPING
    prediction = bundle.predict(rig)
    cost = _cost(prediction, robust)
    for _ in range(_MAX_STEPS):
        normal = _normal(prediction, shots, len(rig.shots), robust)
        while damping < _MOST_DAMPING:
            trial = _trial(bundle, rig, normal, damping, free)
            forecast = None if trial is None else bundle.predict(trial)
            reached = np.inf if forecast is None else _cost(forecast, robust)
            if reached < cost:
                break
            damping *= 10
        else:
            return rig
        gain = cost - reached
        if trial is not None and forecast is not None:
            rig, prediction, cost = trial, forecast, reached
        damping = max(damping / 10, 1e-12)
        if gain <= _SETTLED * cost:
            return rig
    return rig


def shared_covariance(bundle: Bundle, rig: Rig, free: BoolArray | None = None) -> FloatArray:
    """Return the covariance of the shared unknowns for residuals of unit variance; zero for those that are not free.

    Parameters
    ----------
    bundle : Bundle
        The observations.
    rig : Rig
        The solution.
    free : (g,) array of bool, optional
        Which shared unknowns were fitted; all by default.

    Raises
    ------
    LinAlgError
        If the observations leave one of them open.
    """
    prediction = bundle.predict(rig)
    normal = _normal(prediction, bundle.shot_of, len(rig.shots), np.inf)
    reduced, _ = _reduced(normal, normal.shots)
    whole = np.zeros_like(reduced)
    chosen = np.ones(len(reduced), dtype=np.bool_) if free is None else free
    if not chosen.any():
        return whole
    reduced = reduced[np.ix_(chosen, chosen)]
    size = np.sqrt(np.diag(reduced))
    if not (size > 0).all():
        raise np.linalg.LinAlgError("an unknown is not observed")
    scaled = reduced / np.outer(size, size)
    if np.linalg.eigvalsh(scaled)[0] < 1e-13:
        raise np.linalg.LinAlgError("a combination of unknowns is not observed")
    whole[np.ix_(chosen, chosen)] = np.linalg.inv(scaled) / np.outer(size, size)
    return whole


def _cost(prediction: Prediction, robust: float) -> float:
    squared = (prediction.residuals**2).sum(-1)
    if not np.isfinite(squared).all():
        return np.inf
    if np.isinf(robust):
        return float(squared.sum())
    return float(2 * robust**2 * (np.sqrt(1 + squared / robust**2) - 1).sum())


def _normal(prediction: Prediction, shot_of: NDArray[np.intp], shots: int, robust: float) -> _Normal:
    residuals, by_shared, by_shot = prediction.residuals, prediction.by_shared, prediction.by_shot
    if np.isfinite(robust):
        weight = (1 + (residuals**2).sum(-1) / robust**2) ** -0.25  # root of the loss's slope
        residuals = residuals * weight[:, None]
        by_shared, by_shot = by_shared * weight[:, None, None], by_shot * weight[:, None, None]
    flat = by_shared.reshape(-1, by_shared.shape[-1])
    width = flat.shape[1]
    own, coupling, gradient = np.zeros((shots, 6, 6)), np.zeros((shots, width, 6)), np.zeros((shots, 6))
    np.add.at(own, shot_of, np.einsum("nij,nik->njk", by_shot, by_shot))
    np.add.at(coupling, shot_of, np.einsum("nij,nik->njk", by_shared, by_shot))
    np.add.at(gradient, shot_of, np.einsum("nij,ni->nj", by_shot, residuals))
    return _Normal(flat.T @ flat, flat.T @ residuals.ravel(), own, gradient, coupling)


def _reduced(normal: _Normal, shots: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the normal matrix of the shared unknowns without the shots, and what takes shots to shared ones."""
    takes = np.asarray(np.linalg.solve(shots, np.swapaxes(normal.coupling, 1, 2)), dtype=np.float64)
    reduced: FloatArray = normal.shared - np.einsum("sij,sjk->ik", normal.coupling, takes)
    return reduced, takes


def _trial(bundle: Bundle, rig: Rig, normal: _Normal, damping: float, free: BoolArray | None) -> Rig | None:
    """Return the rig after one damped step, or None where there is none."""
    own = normal.shots.copy()
    diagonal = np.einsum("sii->si", own)
    diagonal += damping * diagonal + 1e-12
    try:
        reduced, takes = _reduced(normal, own)
        reduced[np.diag_indices_from(reduced)] += damping * np.diag(normal.shared) + 1e-12
        right = normal.by_shared - np.einsum("sji,sj->i", takes, normal.by_shots)
        chosen = np.ones(len(right), dtype=np.bool_) if free is None else free
        shared = np.zeros_like(right)
        shared[chosen] = -np.linalg.solve(reduced[np.ix_(chosen, chosen)], right[chosen])
        alone = np.linalg.solve(own, normal.by_shots[..., None])[..., 0]
    except np.linalg.LinAlgError:
        return None
    return bundle.moved(rig, shared, -alone - takes @ shared)
