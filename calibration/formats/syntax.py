"""Text to mappings, whatever it is written in: YAML, OpenCV's YAML and XML, JSON, XML, and tables of numbers.

What a file is written in is told by its text, never by its name. OpenCV's storage becomes what it is anyway, a
mapping of keys to numbers, lists and matrices (mappings with ``rows``, ``cols`` and ``data``).
"""

from __future__ import annotations

import json
import re
from contextlib import suppress
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

from calibration.formats.fields import Fields, FormatError
from palletloc.io.reading import read_text
from palletloc.plain_yaml import YamlError, load_plain

TABLE = "table"
"""Key under which the rows of a table stand: lists of words, each with its line in ``line``."""
_NUMBER = r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?"
"""A number as tables have it."""
_ROW = re.compile(rf"\s*{_NUMBER}(\s+([A-Z][A-Z_0-9]+|[-+]?(nan|inf)|{_NUMBER}))*\s*")
"""A row of a table: numbers between blanks, and names in capitals among them."""
_SHORT = 10_000
"""Characters of a mapping in one piece that may be YAML: its reader is slow."""
_DEEPEST = 20
"""Levels of XML that are read: camera files have five."""
_STORAGE_TAG = re.compile(r"!!opencv-[a-z-]+")
"""OpenCV's tag of a matrix."""
_BETWEEN = re.compile(r"^---(?=\s|$)|^\.\.\.(?=\s|$)", re.MULTILINE)
"""What stands between documents of YAML."""
_SHORT = 10_000
"""Characters of a mapping in one piece that may be YAML: its reader is slow."""
_DEEPEST = 20
"""Levels of XML that are read: camera files have five."""
_MOST_VALUES = 1_000_000
"""Values in a document of YAML, each repetition of an anchor counted: a bomb doubles with each of them."""


def read_documents(path: Path) -> list[Fields]:
    """Return what a file holds: a document, or several where YAML is parted by ``---``.

    Parameters
    ----------
    path : Path
        A text file of any of the kinds above.

    Raises
    ------
    InputError
        If it cannot be read, or is none of them; names the line.
    """
    text = read_text(path)
    start = text.lstrip()
    if start.startswith("<"):
        return [Fields(path, "", _xml(path, start, text.count("\n", 0, len(text) - len(start))))]
    rows = _rows(text)
    if rows is not None:
        return [Fields(path, "", {TABLE: rows})]
    if start.startswith(("{", "[")) and path.suffix.lower() not in (".yaml", ".yml"):
        return [Fields(path, "", _json(path, text))]
    return [Fields(path, "", value) for value in _yaml(path, text)]


def _rows(text: str) -> list[dict[str, Any]] | None:
    """Return the rows of a table; None where the text is none."""
    lines = [
        (i, line) for i, line in enumerate(text.splitlines(), start=1) if line.strip() and line.strip()[0] != "#"
    ]
    if not lines or len(lines[0][1].split()) < 2 or not _ROW.fullmatch(lines[0][1]):
        return None
    return [{"line": number, "words": line.split()} for number, line in lines]


def _yaml(path: Path, text: str) -> list[Any]:
    """Return the documents of a text; what follows a whole one may be cut off."""
    # OpenCV's first line, %YAML:1.0, is no directive of YAML, and its tags tell no more than the keys do.
    text = _STORAGE_TAG.sub("", re.sub(r"\A\s*%YAML[^\n]*", "", text))
    found: list[Any] = []
    line = 0
    for part in _BETWEEN.split(text):
        try:
            # Empty lines before it keep the numbers of the lines.
            value = load_plain("\n" * line + part)
        except YamlError as error:
            if not found:
                raise FormatError(error.of(path)) from None
            return found
        line += part.count("\n")
        found += [value] if value is not None else []
    return found or [None]


def _json(path: Path, text: str) -> Any:
    try:
        return json.loads(text)
    except json.JSONDecodeError as error:
        if path.suffix.lower() != ".json" and len(text) < _SHORT:
            # YAML may begin so, too.
            with suppress(FormatError):
                return _yaml(path, text)[0]
        raise FormatError(f"{path}, line {error.lineno}: is not JSON: {error.msg}") from None
    except (RecursionError, ValueError) as error:
        why = "too deeply nested" if isinstance(error, RecursionError) else "a number is too long"
        raise FormatError(f"{path}: is not JSON: {why}") from None


def _xml(path: Path, text: str, skipped: int) -> dict[str, Any]:
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        # Entities could make a small file huge, and camera files have no need of them.
        raise FormatError(f"{path}: expected XML without a DOCTYPE")
    try:
        root = ET.fromstring(text)
    except (ET.ParseError, ValueError) as error:
        line = skipped + getattr(error, "position", (1, 0))[0]
        why = str(error).split(":")[0]
        raise FormatError(f"{path}, line {line}: is not a file of OpenCV or another program: {why}") from None
    return {root.tag.rpartition("}")[2]: _element(path, root, 0)}


def _element(path: Path, element: ET.Element, depth: int) -> Any:
    """Return an element's children by name, or its text, split where it is several numbers."""
    if depth > _DEEPEST:
        raise FormatError(f"{path}: expected XML of at most {_DEEPEST} levels")
    found: dict[str, list[Any]] = {}
    for child in element:
        found.setdefault(child.tag.rpartition("}")[2], []).append(_element(path, child, depth + 1))
    children = {name: values if len(values) > 1 else values[0] for name, values in found.items()}
    if children or element.get("type_id"):
        return children
    words = (element.text or "").split()
    if len(words) > 1 and all(re.fullmatch(_NUMBER, word) for word in words):
        return words
    return " ".join(words).strip('"')
