"""How large errors of one kind are: the numbers that stand in every table."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike


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
