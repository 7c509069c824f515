"""Mappings, lists and numbers as other programs write them, read with file and key in every error."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from palletloc.errors import nearest_name
from palletloc.geometry import FloatArray
from palletloc.io.csv_table import shortened
from palletloc.io.images import MAX_SIDE_PX
from palletloc.io.reading import InputError, read_text
from palletloc.plain_yaml import is_other_base, number_hint

LARGEST = 1e12
"""Of any number in a file of cameras: pixels and metres end long before, and coefficients of r^9 too."""


class FormatError(InputError):
    """A camera file that does not hold what its format says; names file and key."""


@dataclass(frozen=True, slots=True)
class Fields:
    """A value in a file, with the way to it. What reads it raises `FormatError` where something else stands there."""

    path: Path
    """The file."""
    place: str
    """The keys that lead here, as ``cam0.intrinsics``; empty at the top."""
    value: Any
    """What stands there."""

    def fault(self, expected: str, hint: str = "") -> FormatError:
        """Return the error that says what was expected here."""
        return self.wrong(f"expected {expected}, got {shortened(self.value)}{hint or number_hint(self.value)}")

    def wrong(self, what: str) -> FormatError:
        """Return the error that says what is wrong here."""
        line = self.place.startswith("line ")
        where = f"{self.path}, {self.place}: " if line else f"{self.path}: {self.place}: " if self.place else ""
        return FormatError(f"{where or f'{self.path}: '}{what}")

    def has(self, key: str) -> bool:
        """Return whether there is such a key here; ``a.b`` is the key b under a, where there is no key ``a.b``."""
        if isinstance(self.value, dict) and key not in self.value and "." in key:
            first, _, rest = key.partition(".")
            return first in self.value and self.at(first).has(rest)
        return isinstance(self.value, dict) and key in self.value

    def at(self, key: str) -> Fields:
        """Return what stands under a key, as `has` has it."""
        if not isinstance(self.value, dict):
            raise self.fault("a mapping")
        first, _, rest = key.partition(".")
        if key not in self.value and rest and first in self.value:
            return self.at(first).at(rest)
        place = f"{self.place}.{key}" if self.place else key
        if key not in self.value:
            raise FormatError(f"{self.path}: {place}: is missing")
        return Fields(self.path, place, self.value[key])

    def first(self, keys: Sequence[str]) -> Fields:
        """Return what stands under the first of several keys that is there."""
        return self.at(next((key for key in keys if self.has(key)), keys[0]))

    def items(self) -> list[Fields]:
        """Return the entries of a list."""
        if not isinstance(self.value, list):
            raise self.fault("a list")
        return [Fields(self.path, f"{self.place}[{i}]", value) for i, value in enumerate(self.value)]

    def number(self) -> float:
        """Return a finite number."""
        given = self.value
        try:
            # A bool is a number to Python, and so are "1_0" and "010"; none is one to a reader.
            text = given if isinstance(given, str) else ""
            refused = isinstance(given, bool) or "_" in text or is_other_base(text)
            value = math.nan if refused else float(given)
        except (TypeError, ValueError, OverflowError):
            value = math.nan
        if not abs(value) <= LARGEST:
            raise self.fault("a finite number" if not math.isfinite(value) else f"a number up to {LARGEST:g}")
        return value

    def numbers(self, *counts: int) -> tuple[float, ...]:
        """Return as many finite numbers as one of the counts says."""
        if not isinstance(self.value, list) or len(self.value) not in counts:
            raise self.fault(f"{' or '.join(str(count) for count in counts)} numbers")
        return tuple(item.number() for item in self.items())

    def size(self) -> tuple[int, int]:
        """Return width and height in pixels from a list of two."""
        first, second = self.numbers(2)
        return self._side(first), self._side(second)

    def side(self) -> int:
        """Return a width or height in pixels."""
        return self._side(self.number())

    def whole(self, least: int, most: int) -> int:
        """Return a whole number within bounds."""
        value = self.number()
        if value != int(value) or not least <= value <= most:
            raise self.fault(f"a whole number from {least} to {most}")
        return int(value)

    def _side(self, value: float) -> int:
        if value != int(value) or not 0 < value <= MAX_SIDE_PX:
            raise self.fault(f"whole pixels, up to {MAX_SIDE_PX}")
        return int(value)

    def text(self, known: Sequence[str] = ()) -> str:
        """Return a text, one of the known ones where they are given."""
        if not isinstance(self.value, str):
            raise self.fault("a text")
        if known and self.value not in known:
            raise FormatError(
                f"{self.path}: {self.place}: unknown {shortened(self.value)}{nearest_name(self.value, known)}"
            )
        return self.value


class StorageFile:
    """A file of OpenCV's FileStorage that is open for reading; its nodes live as long as it does.

    Parameters
    ----------
    path : Path
        XML, YAML or JSON as OpenCV writes it.

    Raises
    ------
    InputError
        If it cannot be read.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        text = read_text(path)
        try:
            self._storage = cv2.FileStorage(text, cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
        except (cv2.error, SystemError) as error:
            raise InputError(f"{path}: is not a file of OpenCV: {_reason(error)}") from None
        if not self._storage.isOpened():
            raise InputError(f"{path}: is not a file of OpenCV; expected XML, YAML or JSON as FileStorage writes it")

    def node(self, key: str) -> cv2.FileNode:
        """Return the node of a key."""
        node = self._storage.getNode(key)
        if node.empty():
            raise InputError(f"{self._path}: {key}: is missing")
        return node

    def numbers(self, key: str) -> FloatArray | None:
        """Return the numbers of a key, be it a number, a list or a matrix, (n,); None where it is missing.

        Raises
        ------
        InputError
            If it holds anything else.
        """
        node = self._storage.getNode(key)
        if node.empty():
            return None
        try:
            if node.isInt() or node.isReal():
                values = np.array([node.real()])
            elif node.isSeq():
                values = np.array([node.at(i).real() for i in range(node.size())])
            else:
                values = np.asarray(node.mat(), dtype=np.float64).ravel()
        except (cv2.error, SystemError, TypeError, ValueError):
            values = np.array([np.nan])
        if not values.size or not np.isfinite(values).all():
            raise InputError(f"{self._path}: {key}: expected finite numbers")
        return values


def _reason(error: Exception) -> str:
    """Return the words of an error of OpenCV, on one line."""
    words = " ".join(str(error).split())
    return words.split("error: ", 1)[-1][:120]
