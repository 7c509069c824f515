"""How large the numbers in files may be: one table for all readers.

A range is a guard, far from values that make sense: against other units, against a slip of the keyboard, and against
numbers with which arithmetic overflows. What a reader knows better it checks itself.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from functools import cache
from typing import Any

_MOST_DIGITS = 15
"""Of a number in a message."""


@dataclass(frozen=True, slots=True)
class Range:
    """Least and greatest value of a quantity."""

    pattern: str
    """Which keys and columns hold it, with ``*`` for any letters."""
    low: float
    """Least value."""
    high: float
    """Greatest value."""
    unit: str
    """What the numbers count, as messages say it."""
    reason: str
    """Why nothing beyond makes sense."""

    def fault(self, value: float) -> str:
        """Return what is wrong with a number; nothing where it is inside."""
        if self.low <= value <= self.high:
            return ""
        expected = f"expected {self.unit} from {self.low:g} to {self.high:g}, {self.reason}"
        return f"{expected}; got {value:.{_MOST_DIGITS}g}{self._other_unit(value)}"

    def _other_unit(self, value: float) -> str:
        """Return the question whether it is another unit, in which the number would be inside."""
        for unit, factor in _OTHER_UNITS.get(self.unit, ()):
            if self.low <= value * factor <= self.high:
                return f"; are these {unit}?"
        return ""


_OTHER_UNITS: Mapping[str, Sequence[tuple[str, float]]] = {
    "metres": (("millimetres", 1e-3),),
    "seconds": (("milliseconds", 1e-3),),
    "radians": (("degrees", math.pi / 180),),
}
"""Units that people and programs write in place of ours, and what makes ours of them."""

RANGES = (
    Range("exposure_s", 0, 10, "seconds", "as long as a shutter may be open"),
    Range("*_s", -1e20, 1e20, "seconds", "which are more than a clock counts, nanoseconds even"),
    Range("levels_m", -10, 50, "metres", "heights in a rack"),
    Range("translation_m", -100, 100, "metres", "places on a vehicle"),
    Range("*sigma_m", 0, 10, "metres", "how far off a point may be"),
    Range("rotation_sigma_deg", 0, 90, "degrees", "a quarter of a turn"),
    Range("*_deg", -360, 360, "degrees", "a whole turn"),
    Range("yaw_rad", -1e5, 1e5, "radians", "a heading that goes on counting turns"),
    Range("pallet_yaw_rad", -4 * math.pi, 4 * math.pi, "radians", "two whole turns"),
    Range("*_rad", -1e5, 1e5, "radians", "some thousand turns"),
    Range("*_m", -1e8, 1e8, "metres", "coordinates of a site on Earth"),
    Range("*_mm", -1e6, 1e6, "millimetres", "a kilometre"),
    Range("*_px", -1e6, 1e6, "pixels", "some hundred images beside each other"),
    Range("speed_mps", -1e4, 1e4, "metres per second", "far beyond a vehicle"),
    Range("yaw_rate_radps", -1e4, 1e4, "radians per second", "far beyond a vehicle"),
    Range("cov_*", -1e6, 1e6, "square metres and radians", "a kilometre squared"),
    Range("score", 0, 1, "a rank", "from none to certain"),
    Range("track", -1e9, 1e9, "a number of a track", "counted one by one"),
    Range("hits", -1e9, 1e9, "a count of measurements", "taken one by one"),
    Range("*", -1e15, 1e15, "a number", "all digits of which are kept"),
)
"""Least and greatest value of each number that is read, by its key or column; the first pattern that fits holds."""


@cache
def range_of(name: str) -> Range:
    """Return the range of the numbers under a key or in a column.

    Examples
    --------
    >>> range_of("levels_m").fault(1550.0)
    'expected metres from -10 to 50, heights in a rack; got 1550; are these millimetres?'
    >>> range_of("levels_m").fault(1.55)
    ''
    """
    return next(bounds for bounds in RANGES if fnmatchcase(name, bounds.pattern))


def out_of_range(name: str, content: Any) -> Iterator[tuple[str, str]]:
    """Find the numbers in a value of plain values that are out of their range.

    Parameters
    ----------
    name : str
        Its key. A mapping names the numbers in it itself, with its own keys where the table knows them.
    content : any
        Mappings, lists, texts and numbers.

    Yields
    ------
    (str, str)
        Where a number is, as ``.shelf.levels_m[1]``, and what is wrong with it.
    """
    if isinstance(content, dict):
        for key, value in content.items():
            known = range_of(str(key)) is not range_of("")
            for place, problem in out_of_range(str(key) if known else name, value):
                yield f".{key}{place}", problem
    elif isinstance(content, list | tuple):
        for index, value in enumerate(content):
            for place, problem in out_of_range(name, value):
                yield f"[{index}]{place}", problem
    elif isinstance(content, int | float) and not isinstance(content, bool):
        problem = range_of(name).fault(content)
        if problem:
            yield "", problem
