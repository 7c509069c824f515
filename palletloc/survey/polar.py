"""Polar measurements of a total station: angles and a distance, reduced to coordinates, and two faces averaged.

Easting is x, northing y, height z. Horizontal angles run clockwise from the circle's zero, zenith angles down from
the zenith; in the second face the telescope is turned over and the zenith angle exceeds half a turn.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from palletloc.geometry import FloatArray, wrap_angle

_FULL_TURN = 2 * math.pi
"""In radians."""
_FACE_LIMIT = math.radians(20 / 3600)
"""How far the errors of a pair of faces may be from the usual ones, in radians: 1 mm at 10 m."""


@dataclass(frozen=True, slots=True)
class PolarObservation:
    """One pointing of a total station at a target."""

    name: str
    """Name of the target."""
    horizontal: float
    """Reading of the horizontal circle, clockwise, in radians."""
    zenith: float
    """Zenith angle, in radians; above pi in the second face."""
    distance: float | None
    """Slope distance from the instrument's axes to the target, in metres; None where only angles were taken."""
    reflector_height: float = 0.0
    """Of the prism above the surveyed point, in metres."""
    instrument_height: float = 0.0
    """Of the instrument's axes above the station's mark, in metres."""
    line: int = 0
    """Line of the file; 0 where there is none."""

    @property
    def second_face(self) -> bool:
        """Whether the telescope was turned over."""
        return self.zenith > math.pi


@dataclass(frozen=True, slots=True, eq=False)
class Station:
    """Where a total station stands and where its circle's zero points."""

    position: FloatArray = field(default_factory=lambda: np.zeros(3))
    """(3,) its mark: easting, northing, height, in metres."""
    orientation: float = 0.0
    """Azimuth of the circle's zero, clockwise from north, in radians."""


@dataclass(frozen=True, slots=True)
class FaceErrors:
    """Errors of the instrument that a pair of faces reveals, and whose effect their mean is free of."""

    name: str
    """Name of the target."""
    lines: tuple[int, int]
    """Lines of the first and the second face."""
    index: float
    """Of the vertical circle, (V1 + V2 - full turn) / 2, in radians."""
    collimation: float
    """Of the horizontal direction, (Hz1 - Hz2 + half a turn) / 2, in radians, -pi/2 to pi/2."""


def line_of_sight(sight: PolarObservation, station: Station) -> FloatArray:
    """Return the unit vector from the instrument to the target, (3,), in the station's frame."""
    azimuth = sight.horizontal + station.orientation
    sin, cos = math.sin(sight.zenith), math.cos(sight.zenith)
    return np.array([sin * math.sin(azimuth), sin * math.cos(azimuth), cos])


def reduce_sight(sight: PolarObservation, station: Station) -> FloatArray:
    """Return the coordinates of the point below the prism.

    ``dE = SD sin V sin Hz``, ``dN = SD sin V cos Hz``, ``dH = SD cos V + hi - hr``. The formula holds in both faces.

    Parameters
    ----------
    sight : PolarObservation
        With a distance.
    station : Station
        Where it was taken from.

    Returns
    -------
    (3,) array
        Easting, northing and height, in metres.

    Raises
    ------
    ValueError
        If the sight has no distance.

    Examples
    --------
    >>> level = math.pi / 2
    >>> due_east = PolarObservation("P", horizontal=math.pi / 2, zenith=level, distance=5.0, instrument_height=1.5)
    >>> reduce_sight(due_east, Station()).round(9).tolist()
    [5.0, 0.0, 1.5]
    """
    if sight.distance is None:
        raise ValueError(f"expected a distance to '{sight.name}' to reduce")
    up = np.array([0.0, 0.0, sight.instrument_height - sight.reflector_height])
    return np.asarray(station.position + sight.distance * line_of_sight(sight, station) + up)


def average_faces(sights: Sequence[PolarObservation]) -> tuple[PolarObservation, list[FaceErrors]]:
    """Average the sights of one target from one station, each face with the same weight.

    Parameters
    ----------
    sights : sequence of PolarObservation
        At least one, with equal heights; the k-th of the first face belongs to the k-th of the second.

    Returns
    -------
    sight : PolarObservation
        The mean, as the first face reads it, with the first sight's line. With one face only it keeps that
        face's errors.
    errors : list of FaceErrors
        One for each pair of faces.

    Raises
    ------
    ValueError
        If there is no sight, or names or heights differ.
    """
    if len({(sight.name, sight.reflector_height, sight.instrument_height) for sight in sights}) != 1:
        raise ValueError("expected sights of one target with equal heights")
    faces = [[sight for sight in sights if sight.second_face is second] for second in (False, True)]
    errors = [_face_errors(first, second) for first, second in zip(*faces, strict=False)]
    means = [_mean([_as_first_face(sight) for sight in face]) for face in faces if face]
    return replace(_mean(means), line=sights[0].line), errors


def misread_faces(faces: Sequence[FaceErrors]) -> list[FaceErrors]:
    """Return the pairs of faces whose errors differ from the usual ones: an instrument's own hardly change.

    Parameters
    ----------
    faces : sequence of FaceErrors
        Of one instrument; fewer than three do not show what is usual.

    Returns
    -------
    list of FaceErrors
        Those more than 20 seconds of arc from the median index or collimation error.
    """
    if len(faces) < 3:
        return []
    errors = np.array([[pair.index, pair.collimation] for pair in faces])
    off = np.abs(errors - np.median(errors, axis=0)).max(axis=1)
    return [pair for pair, far in zip(faces, off > _FACE_LIMIT, strict=True) if far]


def instrument_errors(faces: Sequence[FaceErrors]) -> tuple[float, float] | None:
    """Return the median index and collimation errors of pairs of faces, in radians; None without a pair."""
    if not faces:
        return None
    index, collimation = np.median([[pair.index, pair.collimation] for pair in faces], axis=0)
    return float(index), float(collimation)


def _face_errors(first: PolarObservation, second: PolarObservation) -> FaceErrors:
    index = (first.zenith + second.zenith - _FULL_TURN) / 2
    collimation = wrap_angle(first.horizontal - second.horizontal + math.pi) / 2
    return FaceErrors(first.name, (first.line, second.line), index, collimation)


def _as_first_face(sight: PolarObservation) -> PolarObservation:
    if not sight.second_face:
        return sight
    return replace(sight, horizontal=sight.horizontal - math.pi, zenith=_FULL_TURN - sight.zenith)


def _mean(sights: Sequence[PolarObservation]) -> PolarObservation:
    start = sights[0]
    turns = [wrap_angle(sight.horizontal - start.horizontal) for sight in sights]
    distances = [sight.distance for sight in sights if sight.distance is not None]
    return replace(
        start,
        horizontal=(start.horizontal + float(np.mean(turns))) % _FULL_TURN,
        zenith=float(np.mean([sight.zenith for sight in sights])),
        distance=float(np.mean(distances)) if distances else None,
    )
