"""A linear fit to sights of which some are wrong, with what was known before."""

from __future__ import annotations

import numpy as np

from palletloc.geometry import FloatArray

_HUBER = 1.5
_ROUNDS = 15


def robust_fit(
    design: FloatArray, values: FloatArray, sigma: FloatArray, prior: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Fit unknowns to values, with Huber's weights; scatter beyond what is stated counts.

    Parameters
    ----------
    design : (n, k) array
        Derivatives of the values by the unknowns.
    values : (n,) array
        What is seen.
    sigma : (n,) array
        Standard deviations of it.
    prior : (k, k) array
        Information about the unknowns before, around 0; with the sights it must tell all of them.

    Returns
    -------
    solution : (k,) array
        The unknowns.
    information : (k, k) array
        About them: the inverse of their covariance.
    """
    weight, scatter = 1 / sigma, 1.0
    solution: FloatArray = np.zeros(design.shape[1])
    information = prior
    for _ in range(_ROUNDS):
        weighted = (design * weight[:, None] ** 2).T / scatter**2
        information = weighted @ design + prior
        solution = np.asarray(np.linalg.solve(information, weighted @ values), np.float64)
        off = (values - design @ solution) / sigma
        scatter = max(1.4826 * float(np.median(np.abs(off))), 1.0)
        weight = 1 / sigma / np.sqrt(np.maximum(np.abs(off) / (_HUBER * scatter), 1.0))
    return solution, information
