"""Points of XML files: LandXML's elements CgPoint, northing before easting, and Trimble JobXML's reductions."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
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


_JOB_PARTS = ("Name", "North", "East", "Elevation", "Deleted")
"""Elements of a point in the Reductions of Trimble's JobXML, whose lengths are metres in every file."""
_OBSERVATIONS = {"RawObservation": "LandXML", "ReducedObservation": "LandXML", "PointRecord": "JobXML"}
"""Elements with sights, which are not reduced here."""


@dataclass(frozen=True, slots=True)
class _Element:
    """A point as it stands there."""

    name: str
    text: str
    line: int
    reference: str = ""


@dataclass(slots=True)
class _Content:
    """What the parser has met so far."""

    root: str = ""
    unit: tuple[str, int] | None = None
    points: list[_Element] = field(default_factory=list)
    open_point: _Element | None = None
    text: list[str] = field(default_factory=list)
    inside: list[str] = field(default_factory=list)
    parts: dict[str, str] = field(default_factory=dict)
    has_observations: bool = False

    def begin(self, element: str, attributes: dict[str, str], line: int) -> None:
        """Take the begin of an element."""
        self.root = self.root or element
        self.inside.append(element)
        if element in ("Metric", "Imperial") and self.unit is None:
            self.unit = (attributes.get("linearUnit", ""), line)
        if element == "CgPoint":
            name = attributes.get("name") or attributes.get("oID") or ""
            self.open_point = _Element(name.strip(), "", line, attributes.get("pntRef", "").strip())
            self.text.clear()
        elif element == "Point" and self.root == "JOBFile" and "Reductions" in self.inside:
            self.open_point = _Element("", "", line)
            self.parts.clear()
        elif element in _JOB_PARTS and self.root == "JOBFile":
            self.text.clear()
        self.has_observations |= element in _OBSERVATIONS

    def finish(self, element: str) -> None:
        """Take the end of an element."""
        self.inside.pop()
        point = self.open_point
        if point is None:
            return
        if element == "CgPoint":
            self.points.append(replace(point, text="".join(self.text)))
            self.open_point = None
        elif element in _JOB_PARTS and self.root == "JOBFile":
            self.parts.setdefault(element, "".join(self.text).strip())
        elif element == "Point" and self.root == "JOBFile":
            text = " ".join(self.parts.get(part, "") for part in _JOB_PARTS[1:4])
            if self.parts.get("Deleted", "false") != "true":
                self.points.append(replace(point, name=self.parts.get("Name", ""), text=text))
            self.open_point = None


def read_landxml_points(path: Path) -> Survey:
    """Read the points of a LandXML file, of any version and namespace, or of Trimble's JobXML.

    Parameters
    ----------
    path : Path
        The file. Each CgPoint holds northing, easting and elevation, or refers to one that does (``pntRef``); the
        linear unit is that of its Units. A point that is there again with equal coordinates is one point.

    Returns
    -------
    Survey
        Points as easting, northing and height in metres; those without three numbers are among `rejected`.

    Raises
    ------
    SurveyError
        If it is neither, its unit is unknown, it has no usable point, or a name has two places.
    InputError
        If the file cannot be read.
    """
    content = _parsed(path)
    if content.root not in ("LandXML", "JOBFile"):
        raise SurveyError(f"{path}: expected the element LandXML, got {shortened(content.root)}")
    notes, metres = _unit(path, content) if content.root == "LandXML" else ([], 1.0)
    places = {element.name: place for element in content.points if (place := _numbers(element.text)) is not None}
    points: dict[str, SurveyPoint] = {}
    rejected = []
    for element in content.points:
        name, line = element.name, element.line
        position = _numbers(element.text) if element.text.strip() else places.get(element.reference)
        if not name or position is None:
            rejected.append(LineNote(line, f"point '{name}': {_lack(element)}"))
            continue
        if name not in points:
            points[name] = SurveyPoint(name, position * metres, (line,))
        elif np.array_equal(position * metres, points[name].position):
            notes.append(LineNote(line, f"point '{name}' is that of line {points[name].lines[0]} again"))
        else:
            raise SurveyError(
                f"{path}, line {line}: point '{name}' stands in line {points[name].lines[0]} already;"
                " expected different names, or equal coordinates"
            )
    if not points:
        why = f"line {rejected[0].line}: {rejected[0].text}" if rejected else "no element CgPoint"
        hint = "; its observations are not reduced: export points" if content.has_observations else ""
        raise SurveyError(f"{path}: has no points ({why}){hint}")
    return Survey(path, points, tuple(rejected), tuple(notes))


def _lack(element: _Element) -> str:
    """Return why an element gives no point."""
    if not element.text.strip() and element.reference:
        what = "has no name and only" if not element.name else "only"
        return f"{what} refers to point '{element.reference}'"
    if not element.name:
        return "has no name"
    return f"expected northing, easting, elevation, got {shortened(element.text.strip())}"


def _numbers(text: str) -> np.ndarray[tuple[int], np.dtype[np.float64]] | None:
    try:
        northing, easting, elevation = (float(part) for part in text.split())
    except ValueError:
        return None
    position = np.array([easting, northing, elevation])
    return position if np.isfinite(position).all() else None


def _unit(path: Path, content: _Content) -> tuple[list[LineNote], float]:
    if content.unit is None:
        return [LineNote(1, "has no Units; metres are assumed")], 1.0
    name, line = content.unit
    if name not in _LINEAR_UNITS:
        hint = nearest_name(name, _LINEAR_UNITS)
        raise SurveyError(f"{path}, line {line}: unknown linearUnit {shortened(name)}{hint}")
    return [], _LINEAR_UNITS[name]


def _parsed(path: Path) -> _Content:
    content = _Content()
    parser = expat.ParserCreate()

    def start(tag: str, attributes: dict[str, str]) -> None:
        content.begin(tag.rpartition(":")[2], attributes, parser.CurrentLineNumber)

    def end(tag: str) -> None:
        content.finish(tag.rpartition(":")[2])

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
    except (LookupError, ValueError) as error:  # an encoding that Python does not know, or not as expat needs it
        raise SurveyError(f"{path}, line 1: is not XML: {error}") from None
    return content
