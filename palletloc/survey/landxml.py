"""Points of LandXML files: elements CgPoint, in the file's linear unit, northing before easting."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from xml.parsers import expat

import numpy as np

from palletloc.errors import nearest_name
from palletloc.io.csv_table import shortened
from palletloc.io.reading import read_bytes
from palletloc.survey.point import LineNote, Survey, SurveyError, SurveyPoint

_LINEAR_UNITS: Mapping[str, float] = {
    "millimeter": 1e-3,
    "centimeter": 1e-2,
    "meter": 1.0,
    "kilometer": 1e3,
    "foot": 0.3048,
    "USSurveyFoot": 1200 / 3937,
    "inch": 0.0254,
    "mile": 1609.344,
}
"""Metres in each linear unit of the schema."""


@dataclass(slots=True)
class _Content:
    """What the parser has met so far."""

    root: str = ""
    unit: tuple[str, int] | None = None
    points: list[tuple[str, str, int]] = field(default_factory=list)
    open_point: tuple[str, int] | None = None
    text: list[str] = field(default_factory=list)


def read_landxml_points(path: Path) -> Survey:
    """Read the points of a LandXML file, of any version and namespace.

    Parameters
    ----------
    path : Path
        The file. Each CgPoint holds northing, easting and elevation; the linear unit is that of its Units.

    Returns
    -------
    Survey
        Points as easting, northing and height in metres; those without three numbers are among `rejected`.

    Raises
    ------
    SurveyError
        If it is not LandXML, its unit is unknown, it has no usable point, or a name stands there twice.
    InputError
        If the file cannot be read.
    """
    content = _parsed(path)
    if content.root != "LandXML":
        raise SurveyError(f"{path}: expected the element LandXML, got {shortened(content.root)}")
    notes, metres = _unit(path, content)
    points: dict[str, SurveyPoint] = {}
    rejected = []
    for name, text, line in content.points:
        position = _numbers(text)
        if not name or position is None:
            what = (
                "has no name" if not name else f"expected northing, easting, elevation, got {shortened(text.strip())}"
            )
            rejected.append(LineNote(line, f"point '{name}': {what}"))
            continue
        if name in points:
            raise SurveyError(
                f"{path}, line {line}: point '{name}' stands in line {points[name].lines[0]} already;"
                " expected different names"
            )
        points[name] = SurveyPoint(name, position * metres, (line,))
    if not points:
        why = f"line {rejected[0].line}: {rejected[0].text}" if rejected else "no element CgPoint"
        raise SurveyError(f"{path}: has no points ({why})")
    return Survey(path, points, tuple(rejected), notes)


def _numbers(text: str) -> np.ndarray[tuple[int], np.dtype[np.float64]] | None:
    try:
        northing, easting, elevation = (float(part) for part in text.split())
    except ValueError:
        return None
    position = np.array([easting, northing, elevation])
    return position if np.isfinite(position).all() else None


def _unit(path: Path, content: _Content) -> tuple[tuple[LineNote, ...], float]:
    if content.unit is None:
        return (LineNote(1, "has no Units; metres are assumed"),), 1.0
    name, line = content.unit
    if name not in _LINEAR_UNITS:
        hint = nearest_name(name, _LINEAR_UNITS)
        raise SurveyError(f"{path}, line {line}: unknown linearUnit {shortened(name)}{hint}")
    return (), _LINEAR_UNITS[name]


def _parsed(path: Path) -> _Content:
    content = _Content()
    parser = expat.ParserCreate()

    def start(tag: str, attributes: dict[str, str]) -> None:
        element = tag.rpartition(":")[2]
        content.root = content.root or element
        if element in ("Metric", "Imperial") and content.unit is None:
            content.unit = (attributes.get("linearUnit", ""), parser.CurrentLineNumber)
        if element == "CgPoint":
            name = attributes.get("name") or attributes.get("oID") or ""
            content.open_point = (name.strip(), parser.CurrentLineNumber)
            content.text.clear()

    def end(tag: str) -> None:
        if tag.rpartition(":")[2] == "CgPoint" and content.open_point is not None:
            name, line = content.open_point
            content.points.append((name, "".join(content.text), line))
            content.open_point = None

    def doctype(*_: object) -> None:
        # Entities could make a small file huge, and LandXML has no need of them.
        raise SurveyError(f"{path}, line {parser.CurrentLineNumber}: expected LandXML without a DOCTYPE")

    parser.StartElementHandler = start
    parser.EndElementHandler = end
    parser.CharacterDataHandler = content.text.append
    parser.StartDoctypeDeclHandler = doctype
    try:
        parser.Parse(read_bytes(path), True)
    except expat.ExpatError as error:
        raise SurveyError(f"{path}, line {error.lineno}: is not XML: {expat.ErrorString(error.code)}") from None
    return content
