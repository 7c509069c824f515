"""Inputs that the tracker cannot use, and the checks that find them."""

from __future__ import annotations

import math

import numpy as np

from palletloc.errors import PalletLocError
from palletloc.geometry import FloatArray

LEAST_VARIANCE = 1e-12
"""Smallest variance that an input may state, in square metres and radians."""
LARGEST = 1e6
"""Largest coordinate, rate or standard deviation that makes sense, in metres, radians and seconds."""


class BadInputError(PalletLocError):
    """An input with a value that cannot be used.

    Parameters
    ----------
    name : str
        Which part of it.
    time : float
        Of the input, in seconds.
    expected : str
        What was expected, and what was there.
    """

    def __init__(self, name: str, time: float, expected: str) -> None:
        super().__init__(f"input at {time!r} s: {name}: {expected}")


class UnknownTrackError(PalletLocError):
    """A track was asked for that is not there, or not at that time."""


def check_time(time: float) -> None:
    """Raise an `BadInputError` where a time is not a finite number."""
    if not math.isfinite(time):
        raise BadInputError("time", time, "expected a finite number of seconds")


def checked_covariance(given: FloatArray, size: int, time: float) -> FloatArray:
    """Return a covariance that the filter can use.

    Parameters
    ----------
    given : (size, size) array
        As it came.
    size : int
        How many rows are expected.
    time : float
        Of the input, for the message.

    Returns
    -------
    (size, size) array
        Symmetric.

    Raises
    ------
    BadInputError
        If it has another shape, a number is not finite, or it is not symmetric positive definite.
    """
    covariance = np.asarray(given, dtype=np.float64)
    if covariance.shape != (size, size):
        raise BadInputError("covariance", time, f"expected {size} x {size} numbers, got {covariance.shape}")
    if not np.isfinite(covariance).all() or np.abs(covariance).max() > LARGEST**2:
        raise BadInputError("covariance", time, "expected finite numbers")
    if not np.allclose(covariance, covariance.T, rtol=1e-6, atol=1e-12):
        raise BadInputError("covariance", time, "expected a symmetric matrix")
    covariance = (covariance + covariance.T) / 2
    scale = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    if scale.min() ** 2 < LEAST_VARIANCE or np.linalg.eigvalsh(covariance / np.outer(scale, scale))[0] < 1e-9:
        raise BadInputError("covariance", time, "expected a positive definite matrix")
    return covariance
