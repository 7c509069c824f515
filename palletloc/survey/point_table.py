"""Tables of points as people write them: which column is what, and numbers in any of their usual forms."""

from __future__ import annotations

import csv
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from palletloc.io.csv_table import Row, TableError, read_rows, shortened
from palletloc.io.reading import read_bytes
from palletloc.survey.point import LineNote, Survey, SurveyPoint

COLUMNS = ("name", "x_m", "y_m", "z_m")
"""Our own header; x, y, z are a right-handed frame with z up, like easting, northing and height."""
_NAMES: Mapping[str, str] = {
    "name": "name p pt pnt id no point pointid pointname pointnumber pointno ptid station"
    " punkt pkt nr nummer pnr punktnr pktnr punktnummer punktname bezeichnung",
    "x": "x e east easting eastings ost ostwert r rechts rechtswert",
    "y": "y n north northing northings nord nordwert hoch hochwert",
    "z": "z h height elevation elev el rl level hoehe h\N{LATIN SMALL LETTER O WITH DIAERESIS}he",
    "code": "code codes pcode pointcode feature desc description remark remarks comment note layer"
    " kode beschreibung bemerkung kommentar art date time datum zeit",
}
"""By field: its names in English and German, without blanks and marks. Of a code nothing is used."""
_UNITS = {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "ft": 0.3048}
"""Units that names may end with, in metres."""
_MARKS = (";", "\t", ",", None)
"""What separates cells, the surest first; None for blanks."""
_NEEDED = ("name", "x", "y", "z")
"""Fields that a point has."""


@dataclass(frozen=True, slots=True)
class PointColumns:
    """Which column of a table is what."""

    places: Mapping[str, int]
    """Number of the column by field: name, x (easting), y (northing), z (height)."""
    factors: Mapping[str, float]
    """Metres in one of the column's unit, by field."""
    unused: tuple[str, ...] = ()
    """Names that are not known, in the file's order."""

    @property
    def is_known(self) -> bool:
        """Whether all fields are there."""
        return all(field in self.places for field in _NEEDED)


def point_columns(names: Sequence[str]) -> PointColumns:
    """Tell the columns of points by their names, whatever their order is.

    Examples
    --------
    >>> point_columns(["Punkt", "Rechtswert [m]", "Hochwert [m]", "H [mm]", "Code"]).places
    {'name': 0, 'x': 1, 'y': 2, 'z': 3}
    """
    given = [_plain(name) for name in names]
    known = {field: words.split() for field, words in _NAMES.items()}
    if {"r", "z"} <= {plain for plain, _ in given}:
        known |= {"y": [*known["y"], "h"], "z": ["z"]}  # Rechts, Hoch
    places: dict[str, int] = {}
    unused = []
    for at, (plain, _) in enumerate(given):
        field = next((field for field, words in known.items() if plain in words and field not in places), None)
        if field in _NEEDED:
            places[field] = at
        elif field is None and plain not in known["code"]:
            unused.append(names[at].strip())
    factors = {field: given[at][1] for field, at in places.items() if field != "name"}
    return PointColumns(places, factors, tuple(name for name in unused if name))


def _plain(name: str) -> tuple[str, float]:
    """Return a name in small letters without blanks, marks and its unit, and that in metres."""
    text = name.strip("\"'# ").lower()
    found = re.fullmatch(r"(.+?)[\s_]*[\s_\[(]\s*(mm|cm|m|ft)\s*[\])]?", text)
    plain, unit = (found[1], found[2]) if found else (text, "m")
    return re.sub(r"[\s_.-]", "", plain), _UNITS[unit]


def read_point_table(path: Path, columns: Sequence[str] | None = None) -> Survey | None:
    """Read points from a table.

    Parameters
    ----------
    path : Path
        Cells separated by semicolons, tabulators, commas or blanks, the first three also with decimal commas where
        commas do not separate; named by a header, or by `columns`.
    columns : sequence of str, optional
        What the columns are, from the left, such as ``P, E, N, H``; a header is then passed over.

    Returns
    -------
    Survey or None
        None where nothing says what the columns are.

    Raises
    ------
    TableError
        If a row is wrong or a name stands there twice, or the header is ambiguous.
    InputError
        If the file cannot be read.
    """
    lines = [(number, text) for number, text in enumerate(_text(path).splitlines(), start=1) if text.strip()]
    lines = [(number, text.lstrip("\ufeff")) for number, text in lines]
    while lines and lines[0][1].startswith("#") and not point_columns(_cells(lines[0][1], ",")).is_known:
        lines = lines[1:]
    if not lines:
        return None
    if columns is None and set(COLUMNS[1:]) & set(_cells(lines[0][1], ",")):
        return _own(path, _cells(lines[0][1], ","))
    mark = next(mark for mark in _MARKS if mark is None or mark in lines[0][1])
    told = point_columns(columns if columns is not None else _cells(lines[0][1], mark))
    if columns is not None and not told.is_known:
        lacking = ", ".join(field for field in _NEEDED if field not in told.places)
        raise TableError(
            f"{path}: columns: no column for {lacking} among {', '.join(columns)}; expected such as P,E,N,H"
        )
    if not told.is_known:
        return None
    _refuse_ambiguous(path, lines[0][0], told, columns or _cells(lines[0][1], mark))
    if columns is None:
        lines = lines[1:]
    points = _points(_rows(path, lines, told, mark, stated=columns is not None), told)
    if not points:
        raise TableError(f"{path}: has no rows; expected at least one point")
    unused = f"columns that are not used: {', '.join(told.unused)}"
    return Survey(path, points, notes=(LineNote(1, unused),) if told.unused and columns is None else ())


def _text(path: Path) -> str:
    """Return the text of a table; instruments and office programs write umlauts in either encoding."""
    content = read_bytes(path)
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError:
        return content.decode("latin-1")


def _cells(text: str, mark: str | None) -> list[str]:
    try:
        cells = next(csv.reader([text], delimiter=mark), []) if mark else text.split()
    except csv.Error:
        cells = text.split(mark)
    return [cell.strip() for cell in cells]


def _own(path: Path, header: Sequence[str]) -> Survey:
    codes = [name for name in header if name.lower() in _NAMES["code"].split()]
    points = _points(read_rows(path, COLUMNS, codes), point_columns(header))
    return Survey(path, points)


def _refuse_ambiguous(path: Path, line: int, told: PointColumns, header: Sequence[str]) -> None:
    """Refuse a northing called x: where y stands before x, as German surveyors write, y is the easting."""
    if {"x", "y"} <= {_plain(name)[0] for name in header} and told.places["y"] < told.places["x"]:
        raise TableError(
            f"{path}, line {line}: y stands before x: is y the easting? expected columns that say so, such as E"
            " and N, or stated ones ('columns' of survey.yaml)"
        )


def _rows(
    path: Path, lines: Sequence[tuple[int, str]], told: PointColumns, mark: str | None, *, stated: bool
) -> Iterator[Row]:
    width = max(told.places.values()) + 1
    for position, (number, text) in enumerate(lines):
        if text.lstrip().startswith("#"):
            continue
        cells = _cells(text, mark)
        if len(cells) < width:
            raise TableError(f"{path}, line {number}: expected at least {width} cells, got {len(cells)}")
        values = {field: cells[at] for field, at in told.places.items()}
        if mark != ",":
            values |= {field: values[field].replace(",", ".") for field in told.factors}
        if stated and position == 0 and not any(_is_number(values[field]) for field in told.factors):
            continue  # a header
        yield Row(path, number, {COLUMNS[_NEEDED.index(field)]: value for field, value in values.items()})


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _points(rows: Iterator[Row], told: PointColumns) -> dict[str, SurveyPoint]:
    points: dict[str, SurveyPoint] = {}
    factors = np.array([told.factors.get(field, 1.0) for field in _NEEDED[1:]])
    for row in rows:
        name = row.text("name")
        if name in points:
            raise row.fault(
                f"name: '{name}' stands in line {points[name].lines[0]} already; expected different names"
            )
        points[name] = SurveyPoint(name, np.array(row.numbers(COLUMNS[1:])) * factors, (row.line,))
    return points


def columns_in(path: Path) -> str:
    """Return what the first line of a table holds, for an error."""
    return shortened(next((text.strip() for text in _text(path).splitlines() if text.strip()), ""))
