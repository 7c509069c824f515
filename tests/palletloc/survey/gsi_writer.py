"""Writing GSI-8 and GSI-16: what was read comes out as it stood, and values become words."""

import math
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from palletloc.geometry import FloatArray
from palletloc.io.atomic import write_bytes
from palletloc.survey.gsi import ANGLE_UNITS, LENGTH_UNITS, SEXAGESIMAL, GsiBlock, GsiWord, Kind


def format_block(block: GsiBlock) -> str:
    """Return a block as a line without its ending; a line that was well formed comes out byte by byte.

    Examples
    --------
    >>> format_block(point_block(1, "A-LL", np.array([413.7033, 190.69962, -11.6112])))
    '*110001+000000000000A-LL 81..46+0000000004137033 82..46+0000000001906996 83..46-0000000000116112 '
    """
    words = " ".join(f"{word.index}{word.info}{word.sign}{word.data}" for word in block.words)
    return f"{'*' if block.wide else ''}{words}{' ' if block.closed else ''}"


def write_gsi(path: Path, blocks: Iterable[GsiBlock], ending: str = "\r\n") -> None:
    """Write blocks as a GSI file, whole or not at all."""
    write_bytes(path, "".join(format_block(block) + ending for block in blocks).encode("utf-8"))


def point_block(number: int, name: str, position: FloatArray, *, unit: str = "6", wide: bool = True) -> GsiBlock:
    """Return the block of a point with its (3,) easting, northing and height, in metres."""
    coordinates = zip(("81", "82", "83"), np.asarray(position, dtype=np.float64), strict=True)
    words = [measured_word(index, float(value), unit, wide=wide, info="..4") for index, value in coordinates]
    return GsiBlock(number, wide, (text_word("11", name, wide=wide, info=f"{number:04d}"), *words))


def text_word(index: str, text: str, *, wide: bool = True, info: str = "....") -> GsiWord:
    """Return a word that holds a text of at most 8 characters, or 16 in a wide one; ValueError if it cannot."""
    width = 16 if wide else 8
    filled = text.startswith("0") and text != "0"
    if not text or len(text) > width or not text.isprintable() or text != text.strip() or filled:
        raise ValueError(f"expected a text of 1 to {width} characters that starts with none of zero and blank")
    return GsiWord(index, info, "+", text.rjust(width, "0"))


def measured_word(index: str, value: float, unit: str, *, wide: bool = True, info: str = "...") -> GsiWord:
    """Return a word that holds an angle or a length, in radians or metres, rounded to the unit's last digit."""
    width = 16 if wide else 8
    kind = GsiWord(index, info + unit, "+", "0" * width).kind
    if kind is Kind.ANGLE and unit == SEXAGESIMAL:
        tenths = round(abs(value) * 180 * 36000 / math.pi)
        steps = tenths // 36000 * 100000 + tenths // 600 % 60 * 1000 + tenths % 600
    else:
        units = {Kind.ANGLE: ANGLE_UNITS, Kind.LENGTH: LENGTH_UNITS}.get(kind, {})
        if unit not in units:
            raise ValueError(f"word {index} cannot have the unit digit '{unit}'")
        divisor, size = units[unit]
        steps = round(abs(value) / size * divisor)
    if len(digits := f"{steps:0{width}d}") > width:
        raise ValueError(f"word {index}: {value} does not fit {width} digits of unit {unit}")
    return GsiWord(index, info + unit, "-" if value < 0 and steps else "+", digits)
