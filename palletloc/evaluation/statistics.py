"""Statistics of errors: how large they are, how often they are inside, and whether covariances tell the truth."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import betaincinv, gammaincinv

from palletloc.geometry import FloatArray

LEAST_VARIANCE = 1e-18
"""Variance below which none is stated, in square metres and radians: nothing is known to a nanometre."""


@dataclass(frozen=True, slots=True)
class Spread:
    """Statistics of signed errors, in the unit of the errors."""

    n: int
    """How many there are."""
    bias: float
    """Median of the signed values: what a few large errors do not move."""
    mean: float
    """Mean of the signed values."""
    median: float
    """Median of the absolute values."""
    rms: float
    """Root of the mean square."""
    p95: float
    """95th percentile of the absolute values, linear between neighbours."""
    maximum: float
    """The largest absolute value."""


def spread(values: ArrayLike) -> Spread | None:
    """Summarize signed errors.

    Parameters
    ----------
    values : (n,) array_like
        Errors in one unit.

    Returns
    -------
    Spread or None
        None where there is nothing to summarize.

    Examples
    --------
    >>> found = spread([-0.3, 0.1, 0.2])
    >>> found.n, found.bias, found.median, found.maximum
    (3, 0.1, 0.2, 0.3)
    """
    signed = np.asarray(values, dtype=np.float64)
    if not signed.size:
        return None
    size = np.abs(signed)
    return Spread(
        n=signed.size,
        bias=float(np.median(signed)),
        mean=float(signed.mean()),
        median=float(np.median(size)),
        rms=float(np.sqrt(np.mean(signed**2))),
        p95=float(np.percentile(size, 95)),
        maximum=float(size.max()),
    )


@dataclass(frozen=True, slots=True)
class Proportion:
    """How many of some trials succeeded, with an interval for the probability of success."""

    successes: int
    """Trials that succeeded."""
    trials: int
    """All of them."""
    confidence: float
    """Of the interval, 0 to 1."""
    low: float
    """Its lower end."""
    high: float
    """Its upper end."""

    @property
    def value(self) -> float:
        """Part that succeeded, 0 to 1; NaN without a trial."""
        return self.successes / self.trials if self.trials else float("nan")

    @property
    def counted(self) -> str:
        """As tables and pages say it: ``59 of 60``."""
        return f"{self.successes} of {self.trials}"


def clopper_pearson(successes: int, trials: int, confidence: float = 0.95) -> Proportion:
    r"""Return a proportion with its two-sided Clopper-Pearson interval.

    The ends are where a binomial tail holds half of what is left of the confidence:

    .. math:: P(X \ge k \mid p_\text{low}) = P(X \le k \mid p_\text{high}) = \alpha/2,
              \qquad X \sim \operatorname{Bin}(n, p), \quad \alpha = 1 - \text{confidence}

    (Clopper and Pearson, *Biometrika* 26, 1934). They are quantiles of the beta distribution. The interval
    covers the true probability at least as often as it says, if the trials are independent.

    Parameters
    ----------
    successes : int
        k, 0 to ``trials``.
    trials : int
        n; without a trial the interval is 0 to 1.
    confidence : float
        0 to 1.

    Returns
    -------
    Proportion
        The counts with the interval.

    Raises
    ------
    ValueError
        If the counts or the confidence are out of range.

    Examples
    --------
    >>> found = clopper_pearson(59, 59)
    >>> round(found.low, 3), found.high
    (0.939, 1.0)
    """
    _require_counts(successes, trials, confidence)
    tail = (1 - confidence) / 2
    return Proportion(
        successes,
        trials,
        confidence,
        lower_bound(successes, trials, 1 - tail),
        upper_bound(successes, trials, 1 - tail),
    )


def lower_bound(successes: int, trials: int, confidence: float) -> float:
    """Return the one-sided lower Clopper-Pearson bound of a probability.

    Parameters
    ----------
    successes, trials : int
        As for `clopper_pearson`.
    confidence : float
        Least probability with which the bound is below the true value.

    Returns
    -------
    float
        0 to 1. With n of n successes it is ``(1 - confidence) ** (1 / n)``.
    """
    _require_counts(successes, trials, confidence)
    return float(betaincinv(successes, trials - successes + 1, 1 - confidence)) if successes else 0.0


def upper_bound(successes: int, trials: int, confidence: float) -> float:
    """Return the one-sided upper Clopper-Pearson bound of a probability; see `lower_bound`."""
    _require_counts(successes, trials, confidence)
    return float(betaincinv(successes + 1, trials - successes, confidence)) if successes < trials else 1.0


def _require_counts(successes: int, trials: int, confidence: float) -> None:
    if not 0 <= successes <= trials:
        raise ValueError(f"expected 0 to {trials} successes in {trials} trials, got {successes}")
    if not 0 < confidence < 1:
        raise ValueError(f"confidence: expected a number between 0 and 1, got {confidence}")


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
        none: below `LEAST_VARIANCE`.
    """
    proper = np.asarray(variance) > LEAST_VARIANCE
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
        the covariance is none: its least eigenvalue is below `LEAST_VARIANCE`.
    """
    variances, axes = np.linalg.eigh(covariance)
    if not variances[0] > LEAST_VARIANCE:
        return math.inf
    return float(((axes.T @ error) ** 2 / variances).sum())


class Consistency(StrEnum):
    """What a chi-square check found."""

    CONSISTENT = "consistent"
    """The errors are as large as the covariances say."""
    OVERCONFIDENT = "overconfident"
    """The covariances are too small."""
    UNDERCONFIDENT = "underconfident"
    """The covariances are too large."""
    UNKNOWN = "unknown"
    """There is no value."""


@dataclass(frozen=True, slots=True)
class ChiSquareCheck:
    """Squared normalised errors against what they should be."""

    n: int
    """How many values there are."""
    unknown: int
    """Values that were not a number, and are left out: a track's first measurement has no NIS."""
    improper: int
    """Infinite values: covariances that are none. They count, so the mean is infinite, too."""
    expected: float
    """Mean that true covariances give: the degrees of freedom."""
    mean: float
    """Mean of the values; NaN without any."""
    median: float
    """Their median; NaN without any."""
    low: float
    """Least mean at the confidence."""
    high: float
    """Greatest mean at the confidence."""
    inside: float
    """Part of the values below their own chi-square quantile at the confidence, 0 to 1; NaN without any."""
    confidence: float
    """Probability with which true covariances give a mean from `low` to `high`."""

    @property
    def verdict(self) -> Consistency:
        """Where the mean lies."""
        if not self.n:
            return Consistency.UNKNOWN
        if self.mean > self.high:
            return Consistency.OVERCONFIDENT
        return Consistency.UNDERCONFIDENT if self.mean < self.low else Consistency.CONSISTENT


def chi_square_check(values: ArrayLike, freedom: ArrayLike, confidence: float = 0.95) -> ChiSquareCheck:
    r"""Compare squared normalised errors (NEES, NIS) with chi-square.

    The sum of *n* independent values with :math:`k_i` degrees of freedom is chi-square with
    :math:`K = \sum k_i`, so the mean lies between :math:`\chi^2_K(\alpha/2)/n` and
    :math:`\chi^2_K(1 - \alpha/2)/n` with probability :math:`1 - \alpha` (Bar-Shalom, Li, Kirubarajan,
    *Estimation with Applications to Tracking and Navigation*, 2001, section 5.4). Shots of one approach are
    not independent: the band is then too narrow, and a mean just outside it says little.

    Parameters
    ----------
    values : (n,) array_like
        Squared normalised errors; NaN where one is not known.
    freedom : int or (n,) array_like of int
        Degrees of freedom: 4 for a pose, fewer for partial measurements.
    confidence : float
        Of the band, 0 to 1.

    Returns
    -------
    ChiSquareCheck
        With the mean, its band and a verdict.

    Raises
    ------
    ValueError
        If the confidence is not between 0 and 1, a freedom is not positive or the shapes do not fit.

    Examples
    --------
    >>> check = chi_square_check([3.0, 4.5, 5.0, 2.0], 4)
    >>> check.mean, str(check.verdict)
    (3.625, 'consistent')
    """
    if not 0 < confidence < 1:
        raise ValueError(f"confidence: expected a number between 0 and 1, got {confidence}")
    given = np.asarray(values, dtype=np.float64).ravel()
    degrees = np.broadcast_to(np.asarray(freedom, dtype=np.float64), given.shape)
    if not (degrees > 0).all():
        raise ValueError("freedom: expected positive degrees of freedom")
    known = ~np.isnan(given)
    squares, degrees = given[known], degrees[known]
    n = int(squares.size)
    unknown = int(given.size) - n
    if not n:
        nan = float("nan")
        return ChiSquareCheck(0, unknown, 0, nan, nan, nan, nan, nan, nan, confidence)
    low, high = (_chi_square(tail, degrees.sum()) / n for tail in ((1 - confidence) / 2, (1 + confidence) / 2))
    return ChiSquareCheck(
        n,
        unknown,
        improper=int(np.isinf(squares).sum()),
        expected=float(degrees.mean()),
        mean=float(squares.mean()),
        median=float(np.median(squares)),
        low=float(low),
        high=float(high),
        inside=float(np.mean(squares <= _chi_square(confidence, degrees))),
        confidence=confidence,
    )


def _chi_square(probability: float, degrees: FloatArray) -> FloatArray:
    """Return quantiles of chi-square; scipy.stats has them too, but takes longer to import than this package."""
    return np.asarray(2 * gammaincinv(degrees / 2, probability))
