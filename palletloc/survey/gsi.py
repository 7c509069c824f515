"""Files in Leica's GSI-8 and GSI-16 formats: lines and their words, every bad line listed with its reason.

A word is a word index (2 or 3 digits), information up to column 6, a sign in column 7 and 8 or 16 characters of data.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

from palletloc.io.csv_table import shortened
from palletloc.io.reading import InputError, read_bytes
from palletloc.survey.point import LineNote, SurveyError

FOOT = 0.3048
"""International foot, in metres; the survey foot differs by 2 millionths."""
LENGTH_UNITS: Mapping[str, tuple[int, float]] = {
    "0": (1000, 1.0),
    "1": (1000, FOOT),
    "6": (10000, 1.0),
    "7": (10000, FOOT),
    "8": (100000, 1.0),
}
"""By unit digit: steps of the last digit in one unit, and the unit in metres."""
ANGLE_UNITS: Mapping[str, tuple[int, float]] = {
    "2": (100000, math.pi / 200),
    "3": (100000, math.pi / 180),
    "5": (10000, math.pi / 3200),
}
"""By unit digit: steps of the last digit in one unit, and the unit (gon, degree, mil) in radians."""
SEXAGESIMAL = "4"
"""Unit digit of degrees, minutes, seconds and tenths: DDDMMSSs."""
_TENTH_OF_SECOND = math.pi / (180 * 36000)
"""In radians: the last digit of sexagesimal data."""
_ANGLES = frozenset({"21", "22", "24", "25"})
"""Word indices of angles: directions and zenith angles, measured and to be set out."""
_LENGTHS = frozenset({"31", "32", "33", "58", "81", "82", "83", "84", "85", "86", "87", "88"})
"""Word indices of lengths: distances, prism constant, coordinates, heights."""
_LEVEL_LENGTHS = re.compile(r"33[0-6]|391|57[1-4]")
"""Word indices of lengths that a level measures."""
_TEXTS = re.compile(r"1[1-9]|4[1-9]|7[1-9]")
"""Word indices of names, codes and remarks."""
_HEAD = 7
"""Characters of a word before its data."""
_BLOCK_STARTS = ("11", "41")
"""Word indices that a line may begin with: a point, a code."""
_LEVEL_INDEX = re.compile(r"33[0-9]|39[0-9]|57[0-9]")
"""Word indices of three digits: only levels write them."""
_BYTE_ORDER_MARKS = {b"\xef\xbb\xbf": "utf-8-sig", b"\xff\xfe": "utf-16", b"\xfe\xff": "utf-16"}
"""Encoding by the bytes that a file begins with."""


class Kind(StrEnum):
    """What the data of a word are."""

    ANGLE = "angle"
    """An angle with a unit digit."""
    LENGTH = "length"
    """A length with a unit digit."""
    CONSTANTS = "constants"
    """Parts per million and millimetres, each with its sign."""
    TEXT = "text"
    """A name, code or remark, filled up with zeros on its left."""
    UNKNOWN = "unknown"
    """Anything else: kept as it stands."""


class WordError(ValueError):
    """Data that have no value; gives the reason."""


@dataclass(frozen=True, slots=True)
class GsiWord:
    """One word, as it stands in the file."""

    index: str
    """Word index: ``21``, or ``331`` from a level."""
    info: str
    """What stands between the index and the sign, in columns up to 6; for a block its number, or dots."""
    sign: str
    """``+`` or ``-``."""
    data: str
    """8 or 16 characters."""

    @property
    def kind(self) -> Kind:
        """What the data are."""
        if self.index in _ANGLES:
            return Kind.ANGLE
        if self.index in _LENGTHS or _LEVEL_LENGTHS.fullmatch(self.index):
            return Kind.LENGTH
        if self.index == "51":
            return Kind.CONSTANTS
        return Kind.TEXT if _TEXTS.fullmatch(self.index) else Kind.UNKNOWN

    @property
    def text(self) -> str:
        """The data without the zeros that fill them up; ``0`` where nothing else is there."""
        return self.data.strip().lstrip("0") or "0"

    def measure(self) -> float:
        """Return an angle in radians or a length in metres, by the word's unit digit.

        Raises
        ------
        WordError
            If the word is of another kind, has data that are no number (dashes stand for no value), or a unit digit
            that does not fit.

        Examples
        --------
        >>> GsiWord("31", "..00", "+", "00030485").measure()
        30.485
        >>> round(math.degrees(GsiWord("21", ".324", "+", "24943030").measure()), 6)
        249.7175
        """
        if self.kind not in (Kind.ANGLE, Kind.LENGTH):
            raise WordError(f"word {self.index} is neither an angle nor a length")
        if not re.fullmatch(r"[0-9]+", self.data):
            raise WordError(f"word {self.index} has no value, its data are {self.data!r}")
        steps = int(self.sign + self.data)
        unit = self.info[-1]
        if self.kind is Kind.ANGLE and unit == SEXAGESIMAL:
            return self._sexagesimal(steps)
        units = ANGLE_UNITS if self.kind is Kind.ANGLE else LENGTH_UNITS
        if unit not in units:
            known = ", ".join(sorted([*units, SEXAGESIMAL] if self.kind is Kind.ANGLE else units))
            raise WordError(
                f"word {self.index} has the unit digit '{unit}', expected one of {known} for {self._noun}"
            )
        divisor, size = units[unit]
        return steps / divisor * size

    @property
    def _noun(self) -> str:
        return "an angle" if self.kind is Kind.ANGLE else "a length"

    def _sexagesimal(self, steps: int) -> float:
        degrees, rest = divmod(abs(steps), 100000)
        minutes, tenths = divmod(rest, 1000)
        if minutes >= 60 or tenths >= 600:
            raise WordError(
                f"word {self.index} has {minutes} minutes and {tenths / 10} seconds, expected less than 60"
            )
        return math.copysign((degrees * 36000 + minutes * 600 + tenths) * _TENTH_OF_SECOND, steps)

    def constants(self) -> tuple[int, int]:
        """Return parts per million and millimetres of word 51, split at the second sign.

        Raises
        ------
        WordError
            If the word is another, or its data are not two numbers.

        Examples
        --------
        >>> GsiWord("51", "..1.", "+", "00000008+0000017").constants()
        (8, 17)
        """
        parts = re.fullmatch(r"([+-][0-9]+)([+-][0-9]+)", self.sign + self.data)
        if self.kind is not Kind.CONSTANTS or parts is None:
            raise WordError(f"word {self.index} has no ppm and mm, its data are {self.data!r}")
        return int(parts[1]), int(parts[2])

    def fault(self) -> str | None:
        """Return why a word that should have a value has none, or None where all is well."""
        try:
            if self.kind is Kind.CONSTANTS:
                self.constants()
            elif self.kind in (Kind.ANGLE, Kind.LENGTH):
                self.measure()
        except WordError as error:
            return str(error)
        return None


@dataclass(frozen=True, slots=True)
class GsiBlock:
    """One line: a measured point, a station, a code."""

    line: int
    """Number of the line in its file, from 1."""
    wide: bool
    """Whether the words have 16 characters of data (GSI-16) instead of 8."""
    words: tuple[GsiWord, ...]
    """The words in the line's order, none twice; the first is a point (11) or a code (41)."""
    closed: bool = True
    """Whether a blank ends the line, as the format wants."""

    def word(self, index: str) -> GsiWord | None:
        """Return the word with an index, or None."""
        return next((word for word in self.words if word.index == index), None)

    def has(self, *indices: str) -> bool:
        """Return whether all of these words are there."""
        return all(self.word(index) is not None for index in indices)


@dataclass(frozen=True, slots=True)
class GsiFile:
    """All lines of a GSI file: each is a block or a rejected line, unless it is empty."""

    path: Path
    """The file."""
    blocks: tuple[GsiBlock, ...]
    """The lines that were read."""
    rejected: tuple[LineNote, ...]
    """The lines that were not, with the reason."""
    notes: tuple[LineNote, ...]
    """Words of the read lines that have no value though they should, with the reason."""


class GsiLineError(ValueError):
    """A line that is not GSI; gives the reason."""


def read_gsi(path: Path) -> GsiFile:
    """Read a GSI file.

    GSI-8 and GSI-16 lines may be mixed; any line ending, a byte-order mark and a missing blank at the end of a line
    are accepted.

    Parameters
    ----------
    path : Path
        The file.

    Returns
    -------
    GsiFile
        With every line that is not empty, read or rejected.

    Raises
    ------
    SurveyError
        If no line could be read; gives the reason for the first.
    InputError
        If the file cannot be read.
    """
    return parse_gsi(path, _decoded(path))


def parse_gsi(path: Path, text: str) -> GsiFile:
    """Read the text of a GSI file, as `read_gsi` does; the path is for messages."""
    blocks: list[GsiBlock] = []
    rejected: list[LineNote] = []
    for number, line in enumerate(re.split(r"\r*\n|\r", text.rstrip("\x1a")), start=1):
        if not line.strip():
            continue
        try:
            blocks.append(parse_line(line, number))
        except GsiLineError as error:
            rejected.append(LineNote(number, str(error)))
    if not blocks:
        why = f", line {rejected[0].line}: {rejected[0].text}" if rejected else ": is empty"
        raise SurveyError(f"{path}{why}; expected lines in GSI form")
    notes = [LineNote(block.line, fault) for block in blocks for word in block.words if (fault := word.fault())]
    return GsiFile(path, tuple(blocks), tuple(rejected), tuple(notes))


def parse_line(line: str, number: int = 1) -> GsiBlock:
    """Read one line.

    Parameters
    ----------
    line : str
        Without its ending.
    number : int
        Its number in the file.

    Returns
    -------
    GsiBlock
        Its words, all of them as they stand there.

    Raises
    ------
    GsiLineError
        If the words do not stand in their columns, or one stands there twice.

    Examples
    --------
    >>> block = parse_line("110001+00000001 21.322+03496940 31..00+00030485 ")
    >>> [word.index for word in block.words], block.words[2].measure()
    (['11', '21', '31'], 30.485)
    """
    body = line.lstrip(" ")
    wide = body.startswith("*")
    body = body[1:] if wide else body
    words = _words(body.rstrip(" "), len(line) - len(line.lstrip(" ")) + wide, 16 if wide else 8)
    if not words:
        raise GsiLineError("has no words")
    if words[0].index not in _BLOCK_STARTS:
        raise GsiLineError(f"starts with word {words[0].index}, expected a point (11) or a code (41)")
    indices = [word.index for word in words]
    twice = next((index for index in indices if indices.count(index) > 1), None)
    if twice is not None:
        raise GsiLineError(f"word {twice} stands there twice")
    return GsiBlock(number, wide, tuple(words), closed=line.endswith(" "))


def _words(body: str, offset: int, width: int) -> list[GsiWord]:
    words = []
    start = 0
    while start < len(body):
        piece = body[start : start + _HEAD + width]
        column = start + offset + 1
        word = _word(piece, column)
        if len(piece) < _HEAD + width:
            raise GsiLineError(
                f"column {column}: word {word.index} has {len(word.data)} of {width} characters of data"
            )
        start += _HEAD + width
        if start < len(body) and body[start] != " ":
            hint = "; the line has no '*' for words of 16 characters" if width == 8 else ""
            raise GsiLineError(
                f"column {start + offset + 1}: expected a blank after word {word.index}, got {body[start]!r}{hint}"
            )
        while start < len(body) and body[start] == " ":
            start += 1
        words.append(word)
    return words


def _word(piece: str, column: int) -> GsiWord:
    head = re.match(r"([0-9]{2})([^ ]{4})([+-])", piece)
    if head is None:
        raise GsiLineError(f"column {column}: expected a word as '31..00+00030485', got {shortened(piece)}")
    # Only levels have indices of three digits; elsewhere a digit in column 3 belongs to a block's number.
    size = 3 if _LEVEL_INDEX.match(piece) else 2
    return GsiWord(piece[:size], piece[size:6], head[3], piece[_HEAD:])


def _decoded(path: Path) -> str:
    content = read_bytes(path)
    encoding = next((name for mark, name in _BYTE_ORDER_MARKS.items() if content.startswith(mark)), "utf-8")
    try:
        text = content.decode(encoding)
    except UnicodeDecodeError as error:
        if encoding != "utf-8":
            raise InputError(f"{path}: is not {encoding} text (byte {error.start})") from None
        # Remarks from an instrument's keyboard may have umlauts in its own alphabet.
        text = content.decode("latin-1")
    if "\0" in text:
        raise InputError(f"{path}: is not text, it has zero bytes")
    return text
