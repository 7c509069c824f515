"""From GSI lines to points: coordinates as they stand there, or polar words reduced."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from palletloc.geometry import FloatArray
from palletloc.survey.gsi import GsiFile, read_gsi
from palletloc.survey.gsi_setups import Pointing, Setup, setups_of
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
_RESECTION_LIMIT = 0.05
"""Farthest that known points may lie from where their sights lead, in metres: beyond it they are other points."""

_LEAST_KEPT = 3
"""How many sights a station rests on at least, where there are so many: of two, none can be told to be wrong."""
_MOST_TRIED = 12
"""Up to how many sights are left out one by one in search of the wrong one."""
_MOST_NAMED = 6
"""How many points an error names."""


@dataclass(frozen=True, slots=True, eq=False)
class _Place:
    """A point's place by one line, or by several sights averaged."""

    position: FloatArray
    lines: tuple[int, ...]
    sight: FloatArray | None


class _MisfitError(ValueError):
    """Known points that their sights do not lead to; gives line, station and how far they are off."""


@dataclass(slots=True, eq=False)
class _Found:
    """What the set-ups have given so far."""

    notes: list[LineNote]
    places: dict[str, list[_Place]] = field(default_factory=dict)
    faces: list[FaceErrors] = field(default_factory=list)
    lost: dict[str, str] = field(default_factory=dict)


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
    setups = setups_of(file.blocks, prism, notes)
    found = _Found(notes=notes)
    has_frame = bool(known) or any(
        setup.station or any(shot.position is not None for shot in setup.shots) for setup in setups
    )
    waiting = []
    for number, setup in enumerate(setups):
        try:
            station = _free_station(setup, known or {}, notes) or setup.station or _implied_station(setup, notes)
        except _MisfitError as error:
            _place_shots(setup, None, found, str(error))
            continue
        if station is None and not has_frame and number == 0:
            station = Station()
        if station is None and setup.line:
            waiting.append(setup)
        else:
            _place_shots(setup, station, found)
    _tie(waiting, known or {}, found)
    for pair in misread_faces(found.faces):
        index, collimation = (math.degrees(error) * 3600 for error in (pair.index, pair.collimation))
        text = f"point '{pair.name}': index error {index:.1f}\" and collimation error {collimation:.1f}\" with line"
        notes.append(LineNote(pair.lines[0], f"{text} {pair.lines[1]}, unlike the other faces: misread?"))
    points, unusable = _merged(found.places)
    lost = {name: why for name, why in found.lost.items() if name not in found.places}
    ordered = tuple(sorted(notes, key=lambda note: note.line))
    return Survey(file.path, points, file.rejected, ordered, tuple(found.faces), {**lost, **unusable})


def _tie(waiting: list[Setup], known: Mapping[str, FloatArray], found: _Found) -> None:
    """Place set-ups without coordinates by points that they share with others, as long as that leads to more."""
    while waiting:
        for setup in waiting:
            shared = {name: np.mean([place.position for place in some], 0) for name, some in found.places.items()}
            try:
                station = _free_station(setup, {**shared, **known}, found.notes)
            except _MisfitError as error:
                station, why = None, str(error)
            else:
                why = ""
            if station is not None or why:
                _place_shots(setup, station, found, why)
                waiting.remove(setup)
                break
        else:
            break
    for setup in waiting:
        why = (
            f"line {setup.line}: {setup.label} has no coordinates (84, 85, 86), and fewer than two points of it have"
            " known places; state known points (key 'known' of survey.yaml)"
        )
        _place_shots(setup, None, found, why)


def _free_station(setup: Setup, known: Mapping[str, FloatArray], notes: list[LineNote]) -> Station | None:
    """Return the station that sights to known points give; None with fewer than two of these.

    Raises
    ------
    _MisfitError
        If the known points do not fit.
    """
    aimed = [shot for shot in setup.shots if shot.name in known and shot.sight is not None]
    if len({shot.name for shot in aimed}) < 2:
        return None
    # Coordinates that the instrument computed belong to the station that it believed in.
    setup.shots[:] = [replace(shot, position=None) if shot.sight else shot for shot in setup.shots]
    sights = [shot.sight for shot in aimed if shot.sight is not None]
    try:
        station, off = _consistent(sights, known)
    except ResectionError as error:
        _note_failure(sights, aimed[0].name, error, notes)
        if setup.station is None:
            line = setup.line or sights[0].line
            raise _MisfitError(f"line {line}: {setup.label} is not found from known points: {error}") from None
        return None
    if sorted(off)[min(len(off), _LEAST_KEPT) - 1] > _RESECTION_LIMIT:
        told = ", ".join(f"'{shot.name}' {far:.3f} m" for shot, far in zip(aimed[:_MOST_NAMED], off, strict=False))
        raise _MisfitError(
            f"line {setup.line or sights[0].line}: {setup.label} does not fit its known points, which its sights miss"
            f" by {told}; expected at most {_RESECTION_LIMIT} m: are their places and names right?"
        )
    _note_misses(sights, [shot.name for shot in aimed], off, notes, "its known place")
    return station


def _implied_station(setup: Setup, notes: list[LineNote]) -> Station | None:
    """Return the station that lines with both coordinates and polar words imply."""
    both = [shot for shot in setup.shots if shot.position is not None and shot.sight is not None]
    if len(both) < 2:
        return None
    # As measured, without the prism's correction: so the instrument computed the coordinates.
    sights = [_uncorrected(shot, name=str(number)) for number, shot in enumerate(both)]
    given = {str(number): shot.position for number, shot in enumerate(both) if shot.position is not None}
    try:
        station, off = _consistent(sights, given)
    except ResectionError as error:
        _note_failure(sights, both[0].name, error, notes)
        return None
    _note_misses(sights, [shot.name for shot in both], off, notes, "its coordinates")
    return station


def _note_failure(
    sights: Sequence[PolarObservation], name: str, error: ResectionError, notes: list[LineNote]
) -> None:
    notes.append(LineNote(sights[0].line, f"point '{name}': no station from it and others: {error}"))


def _note_misses(
    sights: Sequence[PolarObservation], names: Sequence[str], off: Sequence[float], notes: list[LineNote], what: str
) -> None:
    """Note the sights that do not agree with a station."""
    for sight, name, distance in zip(sights, names, off, strict=True):
        if distance > _POLAR_LIMIT:
            text = f"point '{name}': angles and distance lead {distance * 1e3:.1f} mm away from {what}"
            notes.append(LineNote(sight.line, text))


def _consistent(sights: Sequence[PolarObservation], known: Mapping[str, FloatArray]) -> tuple[Station, list[float]]:
    """Return the station by the sights that agree, and how far each leads from its point: the worst are left out."""
    kept = list(range(len(sights)))
    while True:
        station, off = _resected(sights, kept, known)
        worst = max(kept, key=off.__getitem__)
        if off[worst] <= _POLAR_LIMIT or len(kept) <= _LEAST_KEPT:
            return station, off
        if len(kept) <= _MOST_TRIED:
            # A wrong point pulls the station to it: the others agree best without it.
            worst = min(kept, key=lambda index: _spread_without(index, sights, kept, known))
        kept.remove(worst)


def _resected(
    sights: Sequence[PolarObservation], kept: Sequence[int], known: Mapping[str, FloatArray]
) -> tuple[Station, list[float]]:
    station = resect([sights[index] for index in kept], known).station
    return station, [float(np.linalg.norm(reduce_sight(sight, station) - known[sight.name])) for sight in sights]


def _spread_without(
    left_out: int, sights: Sequence[PolarObservation], kept: Sequence[int], known: Mapping[str, FloatArray]
) -> float:
    """Return the largest distance that is left without one sight."""
    others = [index for index in kept if index != left_out]
    try:
        _, off = _resected(sights, others, known)
    except ResectionError:
        return math.inf
    return max(off[index] for index in others)


def _uncorrected(shot: Pointing, name: str) -> PolarObservation:
    sight = shot.sight
    if sight is None or sight.distance is None:
        raise ValueError("expected a shot with a distance")
    return replace(sight, name=name, distance=sight.distance - shot.correction)


def _place_shots(setup: Setup, station: Station | None, found: _Found, why: str = "") -> None:
    """Add the places of a setup's points, target by target; without a station those that need none."""
    groups: dict[tuple[str, float, float], list[Pointing]] = {}
    for shot in setup.shots:
        heights = (shot.sight.reflector_height, shot.sight.instrument_height) if shot.sight else (0.0, 0.0)
        groups.setdefault((shot.name, *heights), []).append(shot)
    for (name, *_), shots in groups.items():
        sights = [shot.sight for shot in shots if shot.sight is not None]
        mean, errors = average_faces(sights) if sights else (None, [])
        found.faces.extend(errors)
        given = [shot for shot in shots if shot.position is not None]
        if given:
            found.places.setdefault(name, []).extend(_given_place(shot, station) for shot in given)
        elif mean is not None and station is not None:
            lines = tuple(shot.line for shot in shots)
            place = _Place(reduce_sight(mean, station), lines, line_of_sight(mean, station))
            found.places.setdefault(name, []).append(place)
        else:
            text = f"point '{name}' has angles and a distance, but the file tells no station (84, 85, 86) for them"
            if why:
                text = (
                    f"point '{name}' has no place: {why if why not in found.lost.values() else 'as the one before'}"
                )
                found.lost.setdefault(name, why)
            found.notes.extend(LineNote(shot.line, text) for shot in shots)


def _given_place(shot: Pointing, station: Station | None) -> _Place:
    """Return a line's own coordinates, moved along the line of sight by the prism's correction."""
    position = np.zeros(3) if shot.position is None else shot.position
    if shot.sight is None or station is None:
        return _Place(position, (shot.line,), None)
    toward = line_of_sight(shot.sight, station)
    return _Place(position + shot.correction * toward, (shot.line,), toward)


def _merged(places: dict[str, list[_Place]]) -> tuple[dict[str, SurveyPoint], dict[str, str]]:
    """Return one point for each name, and the reason for each name whose places disagree."""
    points, unusable = {}, {}
    for name, given in places.items():
        some = sorted(given, key=lambda place: place.lines[0])
        lines = tuple(line for place in some for line in place.lines)
        positions = np.array([place.position for place in some])
        distance = float(np.linalg.norm(positions - positions[0], axis=1).max())
        if distance > _REPEAT_LIMIT:
            unusable[name] = f"{lines_text(lines)}: point '{name}' has places {distance:.3f} m apart; expected one"
            continue
        toward = [place.sight for place in some if place.sight is not None]
        points[name] = SurveyPoint(name, positions.mean(axis=0), lines, toward[0] if toward else None)
    return points, unusable
