"""From GSI lines to points: coordinates as they stand there, or polar words reduced."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from palletloc.geometry import FloatArray
from palletloc.survey.gsi import GsiBlock, GsiFile, GsiWord, WordError, read_gsi
from palletloc.survey.point import LineNote, Survey, SurveyPoint, lines_text
from palletloc.survey.polar import (
    FaceErrors,
    PolarObservation,
    Station,
    average_faces,
    line_of_sight,
    misread_faces,
    reduce_sight,
)
from palletloc.survey.prism import PrismUse
from palletloc.survey.resection import ResectionError, resect

_REPEAT_LIMIT = 0.01
"""Largest distance between two measurements of a point, in metres."""
_POLAR_LIMIT = 0.005
"""Farthest that a line's coordinates may lie from its own angles and distance without a note, in metres."""
_COORDINATES = ("81", "82", "83")
"""Words with easting, northing and height of a point."""
_POLAR = ("21", "22", "31")
"""Words with horizontal direction, zenith angle and slope distance."""
_STATION = ("84", "85", "86")
"""Words with easting, northing and height of the station."""


@dataclass(frozen=True, slots=True, eq=False)
class _Shot:
    """What a line holds about its point."""

    line: int
    name: str
    position: FloatArray | None
    sight: PolarObservation | None
    correction: float


@dataclass(slots=True, eq=False)
class _Setup:
    """The lines between two changes of the station."""

    station: Station | None
    shots: list[_Shot] = field(default_factory=list)


@dataclass(frozen=True, slots=True, eq=False)
class _Place:
    """A point's place by one line, or by several sights averaged."""

    position: FloatArray
    lines: tuple[int, ...]
    sight: FloatArray | None


def read_gsi_points(
    path: Path, prism: PrismUse | None = None, known: Mapping[str, FloatArray] | None = None
) -> Survey:
    """Read the points of a GSI file.

    A line with words 81, 82 and 83 gives its point's coordinates. One with 21, 22 and 31 only is reduced from the
    station of words 84, 85, 86 and 88 before it; its reflector's height is word 87. A file without station words is
    reduced in a frame of its own, with the instrument at the origin, unless other lines of the setup have
    coordinates beside their polar words: then these give the station by resection.

    Parameters
    ----------
    path : Path
        The file.
    prism : PrismUse, optional
        Corrects the distances; without it they are taken as they are.
    known : mapping of str to (3,) array, optional
        Known points: a setup with two or more of them is a free station, found by resection.

    Returns
    -------
    Survey
        With every line that gave no point among `rejected` or `notes`.

    Raises
    ------
    InputError
        If the file cannot be read or has no GSI line.
    """
    return points_of(read_gsi(path), prism, known)


def points_of(file: GsiFile, prism: PrismUse | None = None, known: Mapping[str, FloatArray] | None = None) -> Survey:
    """Return the points of a GSI file that was read; the parameters are those of `read_gsi_points`."""
    notes = list(file.notes)
    setups = _setups(file.blocks, prism, notes)
    has_frame = bool(known) or any(
        setup.station or any(shot.position is not None for shot in setup.shots) for setup in setups
    )
    places: dict[str, list[_Place]] = {}
    faces: list[FaceErrors] = []
    for number, setup in enumerate(setups):
        station = _free_station(setup, known or {}, notes) or setup.station or _implied_station(setup, notes)
        if station is None and not has_frame and number == 0:
            station = Station()
        _place_shots(setup, station, places, faces, notes)
    for pair in misread_faces(faces):
        index, collimation = (math.degrees(error) * 3600 for error in (pair.index, pair.collimation))
        text = f"point '{pair.name}': index error {index:.1f}\" and collimation error {collimation:.1f}\" with line"
        notes.append(LineNote(pair.lines[0], f"{text} {pair.lines[1]}, unlike the other faces: misread?"))
    points, unusable = _merged(places)
    ordered = tuple(sorted(notes, key=lambda note: note.line))
    return Survey(file.path, points, file.rejected, ordered, tuple(faces), unusable)


def _setups(blocks: Iterable[GsiBlock], prism: PrismUse | None, notes: list[LineNote]) -> list[_Setup]:
    """Split the lines where the station changes."""
    setups = [_Setup(None)]
    height = 0.0
    for block in blocks:
        mark = _lengths(block, _STATION)
        if mark is not None:
            height = _height(block, "88") or 0.0
            now = setups[-1].station
            if now is None or not block.has("21") or not np.array_equal(now.position, mark):
                setups.append(_Setup(Station(mark)))
        shot = _shot(block, height, prism, notes)
        if shot is not None:
            setups[-1].shots.append(shot)
        elif mark is None and block.words[0].index == "11":
            notes.append(LineNote(block.line, f"point '{block.words[0].text}' {_lack(block)}"))
    return [setup for setup in setups if setup.shots]


def _lack(block: GsiBlock) -> str:
    heights = [index for index in ("87", "88") if _silent(block, index)]
    if heights and block.has(*_POLAR):
        return f"has a word {heights[0]} without a value; its height cannot be reduced"
    return "has neither coordinates (81, 82, 83) nor angles with a distance (21, 22, 31)"


def _shot(block: GsiBlock, height: float, prism: PrismUse | None, notes: list[LineNote]) -> _Shot | None:
    name = block.words[0]
    if name.index != "11":
        return None
    position = _lengths(block, _COORDINATES)
    correction = prism.correction(_set_constant(block)) if prism else 0.0
    sight = _sight(block, name, height, correction)
    if position is None and sight is None:
        return None
    if correction and sight is None:
        notes.append(
            LineNote(block.line, f"point '{name.text}': no angles (21, 22, 31), prism constant not corrected")
        )
    return _Shot(block.line, name.text, position, sight, correction)


def _sight(block: GsiBlock, name: GsiWord, height: float, correction: float) -> PolarObservation | None:
    polar = _lengths(block, _POLAR)
    if polar is None or _silent(block, "87") or _silent(block, "88") or polar[2] <= 0:
        return None
    own = _height(block, "88")
    return PolarObservation(
        name.text,
        horizontal=float(polar[0]),
        zenith=float(polar[1]),
        distance=float(polar[2]) + correction,
        reflector_height=_height(block, "87") or 0.0,
        instrument_height=height if own is None else own,
        line=block.line,
    )


def _lengths(block: GsiBlock, indices: Sequence[str]) -> FloatArray | None:
    """Return the values of some words, or None if one is missing or has none."""
    values = []
    for index in indices:
        word = block.word(index)
        try:
            values.append(word.measure() if word else None)
        except WordError:
            return None
    return None if None in values else np.array(values, dtype=np.float64)


def _height(block: GsiBlock, index: str) -> float | None:
    value = _lengths(block, (index,))
    return None if value is None else float(value[0])


def _silent(block: GsiBlock, index: str) -> bool:
    """Return whether a word is there, but without a value."""
    return block.word(index) is not None and _lengths(block, (index,)) is None


def _set_constant(block: GsiBlock) -> float | None:
    """Return the prism constant that the line holds, in metres: word 58, or the millimetres of word 51."""
    fine = _height(block, "58")
    word = block.word("51")
    if fine is not None or word is None:
        return fine
    try:
        return word.constants()[1] / 1000
    except WordError:
        return None


def _free_station(setup: _Setup, known: Mapping[str, FloatArray], notes: list[LineNote]) -> Station | None:
    """Return the station that sights to known points give."""
    aimed = [shot for shot in setup.shots if shot.name in known and shot.sight is not None]
    if len({shot.name for shot in aimed}) < 2:
        return None
    # Coordinates that the instrument computed belong to the station that it believed in.
    setup.shots[:] = [replace(shot, position=None) if shot.sight else shot for shot in setup.shots]
    sights = [shot.sight for shot in aimed if shot.sight is not None]
    return _station(sights, [shot.name for shot in aimed], known, notes, "its known place")


def _implied_station(setup: _Setup, notes: list[LineNote]) -> Station | None:
    """Return the station that lines with both coordinates and polar words imply."""
    both = [shot for shot in setup.shots if shot.position is not None and shot.sight is not None]
    if len(both) < 2:
        return None
    # As measured, without the prism's correction: so the instrument computed the coordinates.
    sights = [_uncorrected(shot, name=str(number)) for number, shot in enumerate(both)]
    given = {str(number): shot.position for number, shot in enumerate(both) if shot.position is not None}
    return _station(sights, [shot.name for shot in both], given, notes, "its coordinates")


def _station(
    sights: Sequence[PolarObservation],
    names: Sequence[str],
    known: Mapping[str, FloatArray],
    notes: list[LineNote],
    what: str,
) -> Station | None:
    """Return the station by resection, and note what does not agree with it."""
    try:
        station, off = _consistent(sights, known)
    except ResectionError as error:
        notes.append(LineNote(sights[0].line, f"point '{names[0]}': no station from it and others: {error}"))
        return None
    for sight, name, distance in zip(sights, names, off, strict=True):
        if distance > _POLAR_LIMIT:
            text = f"point '{name}': angles and distance lead {distance * 1e3:.1f} mm away from {what}"
            notes.append(LineNote(sight.line, text))
    return station


def _consistent(sights: Sequence[PolarObservation], known: Mapping[str, FloatArray]) -> tuple[Station, list[float]]:
    """Return the station by the sights that agree, and how far each leads from its point: the worst are left out."""
    kept = list(range(len(sights)))
    while True:
        station = resect([sights[index] for index in kept], known).station
        off = [float(np.linalg.norm(reduce_sight(sight, station) - known[sight.name])) for sight in sights]
        worst = max(kept, key=off.__getitem__)
        if off[worst] <= _POLAR_LIMIT or len(kept) <= 3:
            return station, off
        kept.remove(worst)


def _uncorrected(shot: _Shot, name: str) -> PolarObservation:
    sight = shot.sight
    if sight is None or sight.distance is None:
        raise ValueError("expected a shot with a distance")
    return replace(sight, name=name, distance=sight.distance - shot.correction)


def _place_shots(
    setup: _Setup,
    station: Station | None,
    places: dict[str, list[_Place]],
    faces: list[FaceErrors],
    notes: list[LineNote],
) -> None:
    """Add the places of a setup's points, target by target."""
    groups: dict[tuple[str, float, float], list[_Shot]] = {}
    for shot in setup.shots:
        heights = (shot.sight.reflector_height, shot.sight.instrument_height) if shot.sight else (0.0, 0.0)
        groups.setdefault((shot.name, *heights), []).append(shot)
    for (name, *_), shots in groups.items():
        sights = [shot.sight for shot in shots if shot.sight is not None]
        mean, errors = average_faces(sights) if sights else (None, [])
        faces.extend(errors)
        given = [shot for shot in shots if shot.position is not None]
        if given:
            places.setdefault(name, []).extend(_given_place(shot, station) for shot in given)
        elif mean is not None and station is not None:
            lines = tuple(shot.line for shot in shots)
            place = _Place(reduce_sight(mean, station), lines, line_of_sight(mean, station))
            places.setdefault(name, []).append(place)
        else:
            text = f"point '{name}' has angles and a distance, but the file tells no station (84, 85, 86) for them"
            notes.extend(LineNote(shot.line, text) for shot in shots)


def _given_place(shot: _Shot, station: Station | None) -> _Place:
    """Return a line's own coordinates, moved along the line of sight by the prism's correction."""
    position = np.zeros(3) if shot.position is None else shot.position
    if shot.sight is None or station is None:
        return _Place(position, (shot.line,), None)
    toward = line_of_sight(shot.sight, station)
    return _Place(position + shot.correction * toward, (shot.line,), toward)


def _merged(places: dict[str, list[_Place]]) -> tuple[dict[str, SurveyPoint], dict[str, str]]:
    """Return one point for each name, and the reason for each name whose places disagree."""
    points, unusable = {}, {}
    for name, some in places.items():
        lines = tuple(line for place in some for line in place.lines)
        positions = np.array([place.position for place in some])
        distance = float(np.linalg.norm(positions - positions[0], axis=1).max())
        if distance > _REPEAT_LIMIT:
            unusable[name] = f"{lines_text(lines)}: point '{name}' has places {distance:.3f} m apart; expected one"
            continue
        toward = [place.sight for place in some if place.sight is not None]
        points[name] = SurveyPoint(name, positions.mean(axis=0), lines, toward[0] if toward else None)
    return points, unusable
