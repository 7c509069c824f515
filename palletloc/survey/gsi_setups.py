"""The set-ups of a total station in a GSI file: where its station changes, and what was sighted from each."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np

from palletloc.geometry import FloatArray
from palletloc.survey.gsi import GsiBlock, GsiWord, WordError
from palletloc.survey.point import LineNote
from palletloc.survey.polar import PolarObservation, Station
from palletloc.survey.prism import PrismUse

COORDINATES = ("81", "82", "83")
"""Words with easting, northing and height of a point."""
POLAR = ("21", "22", "31")
"""Words with horizontal direction, zenith angle and slope distance."""
STATION = ("84", "85", "86")
"""Words with easting, northing and height of the station."""
_STATION_CODES = ("2", "21", "23")
"""Code numbers of a new station, its name in word 42: 2 in WildSoft (traverse-pc.com, "Leica GSI"), 23 in Topocad's
("Leica configuration"), 21 in lists of Leica's users. Codes are free; others count where word 42 names a station."""
_STATION_NAME = re.compile(
    r"(ST|STN|STA|STAT|STATION|STP|STPKT|STANDPUNKT|SP|FS|TP|TPS)[-_. ]?\d{1,6}[A-Z]?", re.IGNORECASE
)
"""Names that people give to stations."""


@dataclass(frozen=True, slots=True, eq=False)
class Pointing:
    """What a line holds about its point."""

    line: int
    """Its number in the file."""
    name: str
    """Of the point."""
    position: FloatArray | None
    """(3,) its coordinates as the line gives them."""
    sight: PolarObservation | None
    """Angles and distance, corrected for the prism."""
    correction: float
    """What was added to the distance, in metres."""


@dataclass(slots=True, eq=False)
class Setup:
    """The lines between two changes of the station."""

    station: Station | None
    """Where it is; None where the file does not give its coordinates."""
    name: str = ""
    """Name of the station; empty where the file has none."""
    line: int = 0
    """Line that begins the set-up; 0 for the begin of the file."""
    shots: list[Pointing] = field(default_factory=list)
    """What was sighted."""

    @property
    def label(self) -> str:
        """The set-up as messages name it."""
        return f"station '{self.name}'" if self.name else "the station"


def setups_of(blocks: Iterable[GsiBlock], prism: PrismUse | None, notes: list[LineNote]) -> list[Setup]:
    """Split the lines of a file where the station changes.

    The station changes where a line gives other coordinates of it (84, 85, 86), where a line without angles names
    it (16) or its height (88), where word 16 of a measured line changes, and where a code block (41) says so.

    Parameters
    ----------
    blocks : iterable of GsiBlock
        The lines in the file's order.
    prism : PrismUse or None
        Corrects the distances.
    notes : list of LineNote
        Takes what cannot be used.

    Returns
    -------
    list of Setup
        Those from which something was sighted, in the file's order.
    """
    setups = [Setup(None)]
    height = 0.0
    for block in blocks:
        mark, name, now = _lengths(block, STATION), _station_name(block), setups[-1]
        if mark is not None:
            height = _height(block, "88") or 0.0
            if now.station is None or not block.has("21") or not np.array_equal(now.station.position, mark):
                setups.append(Setup(Station(mark), name or "", block.line))
        elif name is not None and _continues(now, block, name):
            now.name, now.line = name, now.line or block.line
            height = height if _height(block, "88") is None else _height(block, "88") or 0.0
        elif name is not None:
            # A code block's height is of no use: it would move the station, which is not known, and no point.
            height = _height(block, "88") or 0.0
            setups.append(Setup(None, name, block.line))
        shot = _shot(block, height, prism, notes)
        if shot is not None:
            setups[-1].shots.append(shot)
        elif mark is None and name is None and block.words[0].index == "11":
            notes.append(LineNote(block.line, f"point '{block.words[0].text}' {_lack(block)}"))
    return [setup for setup in setups if setup.shots]


def _station_name(block: GsiBlock) -> str | None:
    """Return the name of the station where a line tells one, or that there is a new one."""
    first, given = block.words[0], block.word("16")
    if first.index == "41":
        name = block.word("42")
        if name is None or not (first.text in _STATION_CODES or _STATION_NAME.fullmatch(name.text)):
            return None
        return name.text
    if given is not None:
        return given.text
    alone = not any(block.has(index) for index in (*POLAR, *COORDINATES))
    return first.text if alone and (block.has(*STATION) or (block.has("88") and not block.has("87"))) else None


def _continues(now: Setup, block: GsiBlock, name: str) -> bool:
    """Return whether a line with a station's name tells more of this set-up, and does not begin another."""
    if block.has("21"):
        return not now.shots or now.name in ("", name)
    if now.station is not None:
        return now.name == name or not (now.shots or now.name)
    return not now.shots


def _lack(block: GsiBlock) -> str:
    heights = [index for index in ("87", "88") if _silent(block, index)]
    if heights and block.has(*POLAR):
        return f"has a word {heights[0]} without a value; its height cannot be reduced"
    return "has neither coordinates (81, 82, 83) nor angles with a distance (21, 22, 31)"


def _shot(block: GsiBlock, height: float, prism: PrismUse | None, notes: list[LineNote]) -> Pointing | None:
    name = block.words[0]
    if name.index != "11":
        return None
    position = _lengths(block, COORDINATES)
    correction = prism.correction(_set_constant(block)) if prism else 0.0
    sight = _sight(block, name, height, correction)
    if position is None and sight is None:
        return None
    if correction and sight is None:
        notes.append(
            LineNote(block.line, f"point '{name.text}': no angles (21, 22, 31), prism constant not corrected")
        )
    return Pointing(block.line, name.text, position, sight, correction)


def _sight(block: GsiBlock, name: GsiWord, height: float, correction: float) -> PolarObservation | None:
    polar = _lengths(block, POLAR)
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
