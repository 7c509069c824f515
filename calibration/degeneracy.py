"""Layouts of targets that cannot give the camera's pose, however exact the measurements are."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calibration.findings import Finding, Severity
from calibration.network import Sight, Survey
from palletloc.geometry import FloatArray

NAMES = ("x", "y", "z", "roll", "pitch", "yaw")
"""Of the six numbers: translation along, rotation about the forklift's axes."""
LIMITS = np.array([0.05, 0.05, 0.05, *np.radians([2.0, 2.0, 2.0])])
"""A direction with a larger standard deviation counts as not observed, in metres and radians."""
_LINE, _WALL, _CONE = 0.05, 0.04, np.radians(15.0)
_SPREAD = "hang more targets: on at least two sides of the forklift, at different heights"


def layout_fault(surveys: Sequence[Survey], sights: Sequence[Sight]) -> Finding | None:
    """Return why the layout is degenerate, or None.

    Parameters
    ----------
    surveys : sequence of Survey
        Of the targets that are seen.
    sights : sequence of Sight
        How they are seen.
    """
    if not surveys:
        how = "check the shots, the dictionary and the ids; a marker needs a side of about 20 px in the shot"
        return Finding(Severity.DEGENERATE, "no_target_seen", "no target is seen in any shot", how)
    if len(surveys) == 1:
        what = f"only one target is seen ({surveys[0].name}): place and direction of the camera cannot be told apart"
        return Finding(Severity.DEGENERATE, "one_target", what, _SPREAD)
    points = np.concatenate([_outline(survey) for survey in surveys])
    extent = np.linalg.svd(points - points.mean(0), compute_uv=False)
    if extent[1] < _LINE * extent[0]:
        what = "all targets lie on one straight line: the camera may turn about it"
        return Finding(Severity.DEGENERATE, "collinear", what, _SPREAD)
    if extent[2] < _WALL * extent[0]:
        what = "all targets lie in one plane, such as one wall: the camera's place is coupled with its rotation"
        return Finding(Severity.DEGENERATE, "one_wall", what, _SPREAD)
    angle = cone_angle(np.concatenate([sight.bearings for sight in sights]))
    if angle < _CONE:
        what = f"all targets lie within {np.degrees(angle):.0f} degrees of one direction, seen from the camera"
        return Finding(Severity.DEGENERATE, "narrow_cone", what, _SPREAD)
    return None


def _outline(survey: Survey) -> FloatArray:
    left, right, lower = survey.points
    return np.array([left, right, lower, right + lower - left])


def cone_angle(bearings: FloatArray) -> float:
    """Return the angle between the middle of the bearings, (n, 3), and the farthest of them, in radians."""
    middle = bearings.mean(0)
    length = float(np.linalg.norm(middle))
    if length < 0.1:
        return np.pi
    return float(np.arccos(np.clip((bearings @ middle).min() / length, -1.0, 1.0)))


def unobserved(covariance: FloatArray) -> Finding | None:
    """Return which direction of the six the data leave open, or None.

    Parameters
    ----------
    covariance : (6, 6) array
        Of translation and rotation, in metres and radians.
    """
    if not np.isfinite(covariance).all():
        what, worst = "the observations leave the camera's pose open", np.inf
    else:
        worst, words = weakest(covariance)
        size = f"{worst * 50:.0f} mm or {worst * 2:.1f} degrees"
        what = f"the observations do not tell {words}: its standard deviation is {size}"
    if worst <= 1:
        return None
    return Finding(Severity.DEGENERATE, "unobservable", what, _SPREAD)


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
