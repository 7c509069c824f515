"""Words of Leica's GSI format: what stands in their columns, and what their data mean.

A word is a word index (2 or 3 digits), information up to column 6, a sign in column 7 and 8 or 16 characters of data.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum

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
_ANGLES = frozenset({"21", "22", "24", "25"})
_LENGTHS = frozenset({"31", "32", "33", "58", "81", "82", "83", "84", "85", "86", "87", "88"})
_LEVEL_LENGTHS = re.compile(r"33[0-6]|391|57[1-4]")
_TEXTS = re.compile(r"1[1-9]|4[1-9]|7[1-9]")


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
    """Data that have no value; says why."""


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
