"""Fits to residuals of which some are wrong: weight functions, and iteratively reweighted least squares.

P. W. Holland, R. E. Welsch, "Robust regression using iteratively reweighted least-squares", Communications in
Statistics 6(9), 1977.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from palletloc.geometry import BoolArray, FloatArray

TUKEY = 4.685
"""Tukey's biweight constant, in standard deviations: 95 % efficient on normal residuals."""
HUBER = 1.5
"""Huber's constant, in standard deviations: 96 % efficient on normal residuals (1.345 would be 95 %)."""
CAUCHY = 2.0
"""Cauchy's constant, in standard deviations: 93 % efficient on normal residuals (2.385 would be 95 %)."""
SIGMA_PER_MEDIAN = 1.4826
"""Standard deviation of normal residuals over the median of their absolute values."""


def tukey_weights(residuals: FloatArray, sigma: FloatArray | float = 1.0, tuning: float = TUKEY) -> FloatArray:
    """Return Tukey's weights of squared residuals: those beyond `tuning` standard deviations do not count.

    Parameters
    ----------
    residuals : array
        Any shape.
    sigma : array or float
        Their standard deviation.
    tuning : float
        In standard deviations.

    Returns
    -------
    array
        From 0 to 1.

    Examples
    --------
    >>> tukey_weights(np.array([0.0, 1.0, 9.0])).round(3).tolist()
    [1.0, 0.911, 0.0]
    """
    return np.asarray(np.maximum(1 - (residuals / (tuning * sigma)) ** 2, 0.0) ** 2)


def huber_weights(residuals: FloatArray, sigma: FloatArray | float = 1.0, tuning: float = HUBER) -> FloatArray:
    """Return Huber's weights of squared residuals: beyond `tuning` standard deviations their size counts.

    Parameters
    ----------
    residuals : array
        Any shape.
    sigma : array or float
        Their standard deviation.
    tuning : float
        In standard deviations.

    Returns
    -------
    array
        From 0 to 1.

    Examples
    --------
    >>> huber_weights(np.array([0.0, 1.5, 3.0])).tolist()
    [1.0, 1.0, 0.5]
    """
    return 1 / huber_divisors(residuals, sigma, tuning)


def huber_divisors(residuals: FloatArray, sigma: FloatArray | float = 1.0, tuning: float = HUBER) -> FloatArray:
    """Return the inverse of `huber_weights`: rows that are divided by its root are weighed without rounding twice."""
    return np.asarray(np.maximum(np.abs(residuals) / (tuning * sigma), 1.0))


def cauchy_weights(residuals: FloatArray, sigma: FloatArray | float = 1.0, tuning: float = CAUCHY) -> FloatArray:
    """Return Cauchy's weights of squared residuals: they fall with the square of the residual.

    Parameters
    ----------
    residuals : array
        Any shape.
    sigma : array or float
        Their standard deviation.
    tuning : float
        In standard deviations.

    Returns
    -------
    array
        From 0 to 1.

    Examples
    --------
    >>> cauchy_weights(np.array([0.0, 2.0, 6.0])).tolist()
    [1.0, 0.5, 0.1]
    """
    return 1 / cauchy_divisors(residuals, sigma, tuning)


def cauchy_divisors(residuals: FloatArray, sigma: FloatArray | float = 1.0, tuning: float = CAUCHY) -> FloatArray:
    """Return the inverse of `cauchy_weights`."""
    return np.asarray(1 + (residuals / (tuning * sigma)) ** 2)


def robust_sigma(residuals: FloatArray, least: float = 0.0) -> float:
    """Return the standard deviation of residuals around zero by their median, not below a least one.

    Parameters
    ----------
    residuals : (n,) array
        At least one; less than half of them may be wrong.
    least : float
        What is returned at least.
    """
    return max(SIGMA_PER_MEDIAN * float(np.median(np.abs(residuals))), least)


@dataclass(frozen=True, slots=True, eq=False)
class Consensus:
    """The weighted mean of the largest group of measurements that agree."""

    mean: float
    """Of the group."""
    sigma: float
    """Its standard deviation; larger where the group scatters more than its standard deviations say."""
    group: BoolArray
    """(n,) which measurements agree."""


def consensus(values: FloatArray, sigma: FloatArray, agreement: float) -> Consensus:
    """Return the mean of the measurements around the one that most others agree with, weighted by their variances.

    Parameters
    ----------
    values : (n,) array
        At least one.
    sigma : (n,) array
        Their standard deviations.
    agreement : float
        How many standard deviations of their difference two that agree may be apart.

    Examples
    --------
    >>> found = consensus(np.array([1.0, 1.2, 7.0]), np.ones(3), 3.0)
    >>> round(found.mean, 6), found.group.tolist()
    (1.1, [True, True, False])
    """
    weight = sigma**-2
    agree = np.abs(values[:, None] - values) <= agreement * np.hypot(sigma[:, None], sigma)
    group = agree[(agree * weight).sum(axis=1).argmax()]
    mean = float((values * weight)[group].sum() / weight[group].sum())
    spread = float((weight * (values - mean) ** 2)[group].sum() / max(group.sum() - 1, 1))
    return Consensus(mean, float(np.sqrt(max(spread, 1.0) / weight[group].sum())), group)


@dataclass(frozen=True, slots=True, eq=False)
class RobustFit:
    """The result of iteratively reweighted least squares."""

    solution: FloatArray
    """The unknowns."""
    weights: FloatArray
    """(n,) weights of the squared residuals that follow from the solution, 0 to 1."""
    sigma: float
    """Standard deviation of the residuals that the weights are based on."""


def reweighted(
    fit: Callable[[FloatArray, float], FloatArray],
    residuals: Callable[[FloatArray], FloatArray],
    weigh: Callable[[FloatArray, float], FloatArray],
    spread: Callable[[FloatArray], float],
    start: FloatArray,
    rounds: int,
    settled: float = 0.0,
) -> RobustFit:
    """Fit again and again, each time with the weights that follow from the residuals of the last fit.

    Parameters
    ----------
    fit : callable
        Returns the unknowns for weights of the squared residuals and the residuals' standard deviation.
    residuals : callable
        Returns the residuals of unknowns, (n,).
    weigh : callable
        Returns weights for residuals and their standard deviation, such as `tukey_weights`; or divisors, if `fit`
        takes them.
    spread : callable
        Returns the standard deviation of residuals, such as `robust_sigma`.
    start : (n,) array
        The first weights.
    rounds : int
        How often to fit, at least once.
    settled : float
        The fit ends before that where no weight changes by as much.
    """
    weights, sigma = start, 1.0
    for _ in range(rounds):
        solution = fit(weights, sigma)
        left = residuals(solution)
        sigma = spread(left)
        last, weights = weights, weigh(left, sigma)
        if np.abs(weights - last).max() < settled:
            break
    return RobustFit(solution, weights, sigma)
