"""The lens of one model that images given rays as another one does."""

from __future__ import annotations

import numpy as np

from calibration.lenses.models import LensModel
from palletloc.geometry import FloatArray

_MAX_STEPS, _SETTLED = 100, 1e-12


def match_lens(model: LensModel, start: FloatArray, rays: FloatArray, pixels: FloatArray) -> FloatArray:
    """Return the parameters whose pixels differ least from given ones, by damped least squares.

    Parameters
    ----------
    model : LensModel
        Of the lens.
    start : (k,) array
        Its parameters to begin with.
    rays : (n, 3) array
        In the lens's camera frame.
    pixels : (n, 2) array
        Where they should appear.
    """
    values, damping = start, 1e-3
    residuals, derivatives = _residuals(model, values, rays, pixels)
    cost = _cost(residuals)
    for _ in range(_MAX_STEPS):
        normal, gradient = derivatives.T @ derivatives, derivatives.T @ residuals
        while damping < 1e12:
            trial = values - np.linalg.solve(normal + damping * np.diag(np.diag(normal) + 1e-12), gradient)
            trial_residuals, trial_derivatives = _residuals(model, trial, rays, pixels)
            reached = _cost(trial_residuals) if model.admits(trial) else np.inf
            if reached < cost:
                break
            damping *= 10
        else:
            return values
        settled = cost - reached <= _SETTLED * cost
        values, residuals, derivatives, cost = trial, trial_residuals, trial_derivatives, reached
        if settled:
            return values
        damping = max(damping / 10, 1e-12)
    return values


def _cost(residuals: FloatArray) -> float:
    cost = float(residuals @ residuals)
    return cost if np.isfinite(cost) else np.inf


def _residuals(
    model: LensModel, values: FloatArray, rays: FloatArray, pixels: FloatArray
) -> tuple[FloatArray, FloatArray]:
    imaged = model.evaluate(values, rays)
    return (imaged.pixels - pixels).ravel(), imaged.by_values.reshape(-1, len(values))
