"""Whether surveyed points can belong to the bodies they are named after; if not, the likeliest reason.

Distances between points need no pose: a body's are known, so they distinguish swapped targets, foreign units, a wrong
prism constant and the survey of another site.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from palletloc.geometry import FloatArray
from palletloc.survey.bodies import SurveyedBody
from palletloc.survey.point import Survey, SurveyError, SurveyPoint, lines_text
from palletloc.survey.rigid_body import free_scale

_CERTAIN = 5.0
"""Standard deviations beyond which a distance is wrong."""
_LEAST_LIMIT = 0.003
"""How well the places of targets on a body are known at best, in metres."""
_FAR_OFF = 1.0
"""Distances that are this wrong, in metres, are those of another scene."""
_UNIT_TOLERANCE = 0.02
"""How far a ratio of distances may be from that of two units."""
_UNITS: Mapping[str, float] = {
    "feet": 1 / 0.3048,
    "inches": 1 / 0.0254,
    "centimetres": 100.0,
    "millimetres": 1000.0,
    "kilometres": 1e-3,
}
"""How many of each unit make a metre."""
_METRES_AS_FEET = 0.3048
"""Ratio of distances where metres were taken for feet."""
_WRONG_DIGITS = (10.0, 0.1, 0.01)
"""Ratios of distances where a unit digit does not say what the data mean."""
_MIN_PRISM_ERROR = 0.003
"""Least error of the distances that is put down to a prism constant, in metres."""


def distance_limit(sigma: float) -> float:
    """Return how far a distance between two points may be from the body's, in metres."""
    return max(_CERTAIN * math.sqrt(2) * sigma, _LEAST_LIMIT)


def check_distances(survey: Survey, bodies: Sequence[SurveyedBody], sigma: float) -> None:
    """Compare the distances between points with those on the bodies.

    Parameters
    ----------
    survey : Survey
        Where the points come from.
    bodies : sequence of SurveyedBody
        All bodies, at all stops.
    sigma : float
        Standard deviation of each coordinate, in metres.

    Raises
    ------
    SurveyError
        If a distance is wrong; names file, line and points, and the likeliest reason.
    """
    limit = distance_limit(sigma)
    wrong = [body for body in bodies if not _fits(body, limit)]
    if not wrong:
        return
    body = wrong[0]
    reasons = (
        _foreign_unit(wrong),
        _prism_constant(bodies, limit),
        _swapped(body, limit),
        _mistaken(body, survey, limit),
        _other_site(body),
        _outlier(body, limit),
    )
    reason = next((reason for reason in reasons if reason), None) or _worst_pair(body)
    raise SurveyError(f"{survey.path}, {reason}")


def _fits(body: SurveyedBody, limit: float) -> bool:
    return bool(np.abs(body.surveyed() - body.nominal()).max() <= limit)


def _foreign_unit(wrong: Sequence[SurveyedBody]) -> str | None:
    ratios = np.concatenate([body.surveyed() / np.maximum(body.nominal(), 1e-9) for body in wrong])
    longest = np.argmax([body.nominal().max() for body in wrong])
    middle = float(np.median(ratios))
    if np.abs(ratios / middle - 1).max() > _UNIT_TOLERANCE:
        return None
    body = wrong[int(longest)]
    for unit, ratio in _UNITS.items():
        if abs(middle / ratio - 1) < _UNIT_TOLERANCE:
            return f"{_pair(body)}: distances are {middle:.5g} times the body's: in {unit}, expected metres"
    if abs(middle / _METRES_AS_FEET - 1) < _UNIT_TOLERANCE:
        return f"{_pair(body)}: distances are {middle:.5g} times the body's: metres that are marked as feet"
    if any(abs(middle / ratio - 1) < _UNIT_TOLERANCE for ratio in _WRONG_DIGITS):
        return f"{_pair(body)}: distances are {middle:.5g} times the body's: is the unit digit of the words wrong?"
    return None


def _prism_constant(bodies: Sequence[SurveyedBody], limit: float) -> str | None:
    """Return the error of all distances from the instrument that would explain everything."""
    if any(point.sight is None for body in bodies for point in body.points):
        return None
    offset = 0.0
    for _ in range(3):
        moved = [_moved(body, offset) for body in bodies]
        slopes = np.concatenate([_closing(body) for body in moved])
        errors = np.concatenate([body.surveyed() - body.nominal() for body in moved])
        if not (slopes**2).sum() > 0:
            return None
        offset -= float((slopes * errors).sum() / (slopes**2).sum())
    if abs(offset) < _MIN_PRISM_ERROR or not all(_fits(_moved(body, offset), limit) for body in bodies):
        return None
    scale = free_scale(bodies[0].places, bodies[0].world)
    return (
        f"{_pair(bodies[0])}: all distances from the instrument are {abs(offset) * 1e3:.1f} mm too"
        f" {'short' if offset > 0 else 'long'} (scale {scale:.4f}): a wrong prism constant; the conventions differ"
        " by 34.4 mm"
    )


def _moved(body: SurveyedBody, offset: float) -> SurveyedBody:
    """Return the body with its points farther from the instrument."""
    moved = {
        index: SurveyPoint(point.name, point.position + offset * point.sight, point.lines, point.sight)
        for index, point in enumerate(body.points)
        if point.sight is not None
    }
    return body.with_points(moved)


def _closing(body: SurveyedBody) -> FloatArray:
    """Return how much the distance of each pair grows as its points move away from the instrument."""
    sights = np.array([point.sight for point in body.points])
    between = np.array([body.world[i] - body.world[j] for i, j in body.pairs()])
    differences = np.array([sights[i] - sights[j] for i, j in body.pairs()])
    return np.asarray((between * differences).sum(axis=1) / np.linalg.norm(between, axis=1))


def _swapped(body: SurveyedBody, limit: float) -> str | None:
    for i, j in body.pairs():
        first, second = body.points[i], body.points[j]
        if _fits(body.with_points({i: second, j: first}), limit):
            where = lines_text((first.lines[0], second.lines[0]))
            return (
                f"{where}: points '{first.name}' and '{second.name}' look swapped:"
                f" the distances of {body.label} fit the other way round"
            )
    return None


def _mistaken(body: SurveyedBody, survey: Survey, limit: float) -> str | None:
    """Return which point of the survey stands where one of the body's is expected."""
    if len(body.points) < 3:
        return None
    for index, point in enumerate(body.points):
        for other in survey.points.values():
            if other not in body.points and _fits(body.with_points({index: other}), limit):
                where = lines_text((point.lines[0], other.lines[0]))
                return (
                    f"{where}: point '{point.name}' does not fit the others of {body.label}, but point '{other.name}'"
                    " does: are their names swapped?"
                )
    return None


def _other_site(body: SurveyedBody) -> str | None:
    off = np.abs(body.surveyed() - body.nominal())
    if not (off > _FAR_OFF).all():
        return None
    return f"{_pair(body)}, the body's {body.nominal()[_longest(body)]:.3f} m: is it the survey of another site?"


def _outlier(body: SurveyedBody, limit: float) -> str | None:
    """Return the one point without which the others fit."""
    if len(body.points) < 3:
        return None
    suspects = [index for index in range(len(body.points)) if _fits(body.without(index), limit)]
    if len(suspects) != 1:
        return None
    index = suspects[0]
    off = max((got - want for got, want, pair in _rows(body) if index in pair), key=abs)
    point = body.points[index]
    message = (
        f"{lines_text(point.lines)}: point '{point.name}' does not fit the others of {body.label}: its distances are"
    )
    if abs(off) > _FAR_OFF:
        return f"{message} up to {abs(off):.5g} m off; do its coordinates have other units?"
    return f"{message} up to {abs(off) * 1e3:.1f} mm off"


def _worst_pair(body: SurveyedBody) -> str:
    got, want, (i, j) = max(_rows(body), key=lambda row: abs(row[0] - row[1]))
    first, second = body.points[i], body.points[j]
    scale = free_scale(body.places, body.world)
    return (
        f"{lines_text((first.lines[0], second.lines[0]))}: points '{first.name}' and '{second.name}' are {got:.4f} m"
        f" apart, expected {want:.4f} m on {body.label} (scale {scale:.4f})"
    )


def _rows(body: SurveyedBody) -> Iterator[tuple[float, float, tuple[int, int]]]:
    yield from zip(body.surveyed().tolist(), body.nominal().tolist(), body.pairs(), strict=True)


def _longest(body: SurveyedBody) -> int:
    return int(body.nominal().argmax())


def _pair(body: SurveyedBody) -> str:
    """Return the longest pair as messages name it, with the body."""
    i, j = body.pairs()[_longest(body)]
    first, second = body.points[i], body.points[j]
    return (
        f"{lines_text((first.lines[0], second.lines[0]))}: points '{first.name}' and '{second.name}' of {body.label}"
        f" are {body.surveyed()[_longest(body)]:.3f} m apart"
    )
