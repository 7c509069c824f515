"""Directions of the six numbers of a mounting: which of them data leave open, in words."""

from __future__ import annotations

import numpy as np

from calibration.findings import Finding, Severity
from palletloc.geometry import FloatArray

NAMES = ("x", "y", "z", "roll", "pitch", "yaw")
"""Of the six numbers: translation along, rotation about the forklift's axes."""
LIMITS = np.array([0.05, 0.05, 0.05, *np.radians([2.0, 2.0, 2.0])])
"""A direction with a larger standard deviation counts as not observed, in metres and radians."""
SPREAD = "hang more targets: on at least two sides of the forklift, at different heights"
"""What to do where targets do not tell all six numbers."""


def unobserved(covariance: FloatArray) -> Finding | None:
    """Return which direction a (6, 6) covariance of translation and rotation, in metres and radians, leaves open."""
    if not np.isfinite(covariance).all():
        what, worst = "the observations leave the camera's pose open", np.inf
    else:
        worst, words = weakest(covariance)
        size = f"{worst * 50:.0f} mm or {worst * 2:.1f} degrees"
        what = f"the observations do not tell {words}: its standard deviation is {size}"
    if worst <= 1:
        return None
    return Finding(Severity.DEGENERATE, "unobservable", what, SPREAD)


def weakest(covariance: FloatArray) -> tuple[float, str]:
    """Return the most uncertain direction of the six, in units of `LIMITS`, and in words.

    Examples
    --------
    >>> weakest(np.diag([1e-6, 1e-6, 0.01, 1e-8, 1e-8, 1e-8]))
    (2.0, 'z')
    """
    values, vectors = np.linalg.eigh(covariance / np.outer(LIMITS, LIMITS))
    return round(float(np.sqrt(max(values[-1], 0.0))), 6), in_words(vectors[:, -1])


def in_words(direction: FloatArray) -> str:
    """Return a direction of the six numbers in words: what moves together, and in which sense.

    Examples
    --------
    >>> in_words(np.array([0.7, 0, 0, 0, -0.7, 0]))
    'x coupled with -pitch'
    """
    strongest = int(np.argmax(np.abs(direction)))
    direction = direction * np.sign(direction[strongest])
    order = [i for i in np.argsort(-np.abs(direction), kind="stable") if abs(direction[i]) > 0.25]
    parts = [("-" if direction[i] < 0 else "") + NAMES[i] for i in order]
    return " and ".join([" coupled with ".join(parts[:2]), *parts[2:]]) if parts else "nothing"
