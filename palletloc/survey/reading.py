"""Reading a survey file of any kind; its name's ending says which."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from palletloc.geometry import FloatArray
from palletloc.io.csv_table import read_rows
from palletloc.survey.gsi_points import read_gsi_points
from palletloc.survey.landxml import read_landxml_points
from palletloc.survey.point import Survey, SurveyError, SurveyPoint
from palletloc.survey.prism import PrismUse

COLUMNS = ("name", "x_m", "y_m", "z_m")
"""Header of a table of points; x, y, z are a right-handed frame with z up, like easting, northing and height."""


def read_survey(path: Path, prism: PrismUse | None = None, known: Mapping[str, FloatArray] | None = None) -> Survey:
    """Read the points of a survey.

    Parameters
    ----------
    path : Path
        ``.gsi`` (Leica GSI-8 or GSI-16), ``.csv`` (``name,x_m,y_m,z_m``) or ``.xml`` (LandXML).
    prism : PrismUse, optional
        Corrects distances; for GSI only, as the other kinds hold none.
    known : mapping of str to (3,) array, optional
        Known points, from which free stations are found; for GSI only, too.

    Returns
    -------
    Survey
        Points in metres.

    Raises
    ------
    InputError
        If the file cannot be read; names file and line.
    SurveyError
        If the name has another ending, or a prism or known points are given for a file without distances.
    """
    ending = path.suffix.lower()
    if ending in (".gsi", ".gs8", ".g16"):
        return read_gsi_points(path, prism, known)
    if ending not in (".csv", ".xml"):
        raise SurveyError(f"{path}: unknown kind of survey; expected a name that ends with .gsi, .csv or .xml")
    if prism is not None or known is not None:
        raise SurveyError(f"{path}: holds no distances; expected a .gsi file where a prism or known points are given")
    return _read_table(path) if ending == ".csv" else read_landxml_points(path)


def _read_table(path: Path) -> Survey:
    points: dict[str, SurveyPoint] = {}
    for row in read_rows(path, COLUMNS):
        name = row.text("name")
        if name in points:
            raise row.fault(
                f"name: '{name}' stands in line {points[name].lines[0]} already; expected different names"
            )
        points[name] = SurveyPoint(name, np.array(row.numbers(COLUMNS[1:])), (row.line,))
    return Survey(path, points)
