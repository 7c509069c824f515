"""Surveyed points as a table: ``name,x_m,y_m,z_m``."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from palletloc.evaluation.survey.point import Survey, SurveyPoint
from palletloc.io.csv_table import read_rows

COLUMNS = ("name", "x_m", "y_m", "z_m")
"""Header of the file."""


def read_csv_points(path: Path) -> Survey:
    """Read points from a csv file.

    Parameters
    ----------
    path : Path
        The file; x, y and z form a right-handed frame with z up, as easting, northing and height do.

    Returns
    -------
    Survey
        Its points.

    Raises
    ------
    InputError
        If the file, its header or a row is wrong, or a name stands there twice; names the line.
    """
    points: dict[str, SurveyPoint] = {}
    for row in read_rows(path, COLUMNS):
        name = row.text("name")
        if name in points:
            raise row.fault(
                f"name: '{name}' stands in line {points[name].lines[0]} already; expected different names"
            )
        points[name] = SurveyPoint(name, np.array(row.numbers(COLUMNS[1:])), (row.line,))
    return Survey(path, points)
