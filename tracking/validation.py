"""Inputs that the tracker cannot use, and the checks that find them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from palletloc.errors import PalletLocError
from palletloc.geometry import BoolArray, FloatArray

LEAST_VARIANCE = 1e-12
"""Smallest variance that an input may state, in square metres and radians."""
LEAST_CORRELATION = 1e-9
"""Smallest eigenvalue of the correlations that it may state."""
LEAST_RATIO = 1e-12
"""Smallest eigenvalue of a covariance as a part of its largest: turning a smaller one ends in rounding."""
LARGEST = 1e6
"""Largest coordinate or rate that makes sense, in metres, radians and seconds."""
LARGEST_TIME = 1e12
"""Largest time, in seconds: the next one that differs is a tenth of a millisecond away."""
LARGEST_SIGMA = 1e3
"""Largest standard deviation: what is known no better is as good as unknown."""


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
    """Raise a `BadInputError` where a time is not a finite number, or too large to resolve milliseconds."""
    if not abs(time) <= LARGEST_TIME:
        raise BadInputError("time", time, f"expected a finite number of seconds, up to {LARGEST_TIME:g}")


def numbers(name: str, given: object, shape: tuple[int, ...], time: float) -> FloatArray:
    """Return an array of some shape; raise a `BadInputError` where it is none."""
    try:
        array = np.asarray(given, dtype=np.float64)
    except (TypeError, ValueError):
        raise BadInputError(name, time, f"expected numbers, got {type(given).__name__}") from None
    if array.shape != shape:
        expected = " x ".join(str(size) for size in shape)
        raise BadInputError(name, time, f"expected {expected} numbers, got an array of shape {array.shape}")
    return array


def beyond_reason(values: FloatArray) -> str:
    """Return what was expected of values that are not finite or too large."""
    return f"expected finite numbers below {LARGEST:g}, got {values.tolist()}"


def check_values(name: str, given: FloatArray | Sequence[float], time: float) -> None:
    """Raise a `BadInputError` where a number is not finite or beyond all reason."""
    values = numbers(name, given, (len(given),), time)
    if not (np.abs(values) < LARGEST).all():
        raise BadInputError(name, time, beyond_reason(values))


def covariance_faults(given: FloatArray) -> list[str]:
    """Return what is wrong with covariances that the filter could not use.

    Parameters
    ----------
    given : (n, k, k) array
        As they came.

    Returns
    -------
    list of str
        What was expected of each; nothing where it is finite, symmetric and positive definite.
    """
    finite: BoolArray = np.all(np.abs(given) <= LARGEST_SIGMA**2, axis=(1, 2))  # false for nan, too
    covariances = np.where(finite[:, None, None], given, np.eye(given.shape[1]))
    mirrored = covariances.transpose(0, 2, 1)
    symmetric: BoolArray = np.all(np.abs(covariances - mirrored) <= 1e-12 + 1e-6 * np.abs(mirrored), axis=(1, 2))
    variances = np.diagonal(covariances, axis1=1, axis2=2)
    positive: BoolArray = np.all(variances >= LEAST_VARIANCE, axis=1)
    scale = np.sqrt(np.where(positive[:, None], variances, 1.0))
    even = (covariances + mirrored) / 2
    correlations, eigenvalues = np.linalg.eigvalsh([even / (scale[:, :, None] * scale[:, None]), even])
    positive &= correlations[:, 0] >= LEAST_CORRELATION
    balanced: BoolArray = eigenvalues[:, 0] >= LEAST_RATIO * eigenvalues[:, -1]
    checks = zip(finite.tolist(), symmetric.tolist(), positive.tolist(), balanced.tolist(), strict=True)
    return [_expected(*passed) for passed in checks]


def _expected(finite: bool, symmetric: bool, positive: bool, balanced: bool) -> str:
    if not finite:
        return f"expected finite numbers, and standard deviations up to {LARGEST_SIGMA:g}"
    if not symmetric:
        return "expected a symmetric matrix"
    if not positive:
        return f"expected a positive definite matrix, and variances from {LEAST_VARIANCE:g} on"
    return "" if balanced else f"expected eigenvalues from {LEAST_RATIO:g} of the largest on"


def checked_covariance(given: object, size: int, time: float) -> FloatArray:
    """Return a covariance that can be used.

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
    covariance = numbers("covariance", given, (size, size), time)
    fault = covariance_faults(covariance[None])[0]
    if fault:
        raise BadInputError("covariance", time, fault)
    return (covariance + covariance.T) / 2
