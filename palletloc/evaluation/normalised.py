"""Errors in the units of their covariance."""

from __future__ import annotations

import math

import numpy as np

from palletloc.geometry import FloatArray


def normalised(error: FloatArray, variance: FloatArray) -> FloatArray:
    r"""Return errors in units of their standard deviation.

    .. math:: e / \sqrt{\sigma_\text{est}^2 + \sigma_\text{truth}^2}

    where the variance given is the sum under the root.

    Parameters
    ----------
    error : (...) array
        Estimate minus truth.
    variance : (...) array
        Of that difference, in the square of its unit.

    Returns
    -------
    (...) array
        Standard normal where the variances are true; infinite, with the error's sign, where a variance is
        not positive.
    """
    proper = np.asarray(variance) > 0
    sigma = np.sqrt(np.where(proper, variance, 1.0))
    return np.asarray(np.where(proper, error / sigma, np.copysign(np.inf, error)))


def nees(error: FloatArray, covariance: FloatArray) -> float:
    r"""Return the normalised estimation error squared, :math:`e^T C^{-1} e`.

    Parameters
    ----------
    error : (k,) array
        Estimate minus truth.
    covariance : (k, k) array
        Of that difference.

    Returns
    -------
    float
        Chi-square with k degrees of freedom where the covariance is true, so k on average; infinite where
        the covariance is none (not positive definite).
    """
    variances, axes = np.linalg.eigh(covariance)
    if not variances[0] > 0:
        return math.inf
    return float(((axes.T @ error) ** 2 / variances).sum())
