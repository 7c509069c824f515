"""Mappings, lists and numbers as other programs write them, read with file and key in every error."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import yaml

from palletloc.errors import nearest_name
from palletloc.geometry import FloatArray
from palletloc.io.csv_table import shortened
from palletloc.io.images import MAX_SIDE_PX
from palletloc.io.reading import InputError, read_text


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

    def fault(self, expected: str) -> FormatError:
        """Return the error that says what was expected here."""
        where = f"{self.path}: {self.place}: " if self.place else f"{self.path}: "
        return FormatError(f"{where}expected {expected}, got {shortened(self.value)}")

    def has(self, key: str) -> bool:
        """Return whether there is such a key here."""
        return isinstance(self.value, dict) and key in self.value

    def at(self, key: str) -> Fields:
        """Return what stands under a key."""
        if not isinstance(self.value, dict):
            raise self.fault("a mapping")
        place = f"{self.place}.{key}" if self.place else key
        if key not in self.value:
            raise FormatError(f"{self.path}: {place}: is missing")
        return Fields(self.path, place, self.value[key])

    def items(self) -> list[Fields]:
        """Return the entries of a list."""
        if not isinstance(self.value, list):
            raise self.fault("a list")
        return [Fields(self.path, f"{self.place}[{i}]", value) for i, value in enumerate(self.value)]

    def number(self) -> float:
        """Return a finite number."""
        try:
            value = math.nan if isinstance(self.value, bool) else float(self.value)
        except (TypeError, ValueError, OverflowError):
            value = math.nan
        if not math.isfinite(value):
            raise self.fault("a finite number")
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


def read_yaml(path: Path) -> Fields:
    """Read a yaml file.

    Raises
    ------
    InputError
        If it cannot be read or is not yaml; names the line.
    """
    try:
        return Fields(path, "", yaml.safe_load(read_text(path)))
    except yaml.MarkedYAMLError as error:
        line = "" if error.problem_mark is None else f", line {error.problem_mark.line + 1}"
        raise FormatError(f"{path}{line}: is not yaml: {error.problem or error.context}") from None
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        raise FormatError(f"{path}: is not yaml: {' '.join(str(error).split())}") from None


def read_json(path: Path) -> Fields:
    """Read a JSON file.

    Raises
    ------
    InputError
        If it cannot be read or is not JSON; names the line.
    """
    try:
        return Fields(path, "", json.loads(read_text(path)))
    except json.JSONDecodeError as error:
        raise FormatError(f"{path}, line {error.lineno}: is not JSON: {error.msg}") from None
    except RecursionError:
        raise FormatError(f"{path}: is not JSON: too deeply nested") from None


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
