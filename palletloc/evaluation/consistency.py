"""Whether covariances tell the truth: NEES and NIS against chi-square."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import gammaincinv

from palletloc.geometry import FloatArray


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
