"""Reading a survey file of any kind, which is told by what stands in it."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path

from palletloc.geometry import FloatArray
from palletloc.io.reading import read_bytes
from palletloc.survey.gsi_points import read_gsi_points
from palletloc.survey.landxml import read_landxml_points
from palletloc.survey.point import Survey, SurveyError
from palletloc.survey.point_table import columns_in, read_point_table
from palletloc.survey.prism import PrismUse

_BEGIN = 4096
"""How many bytes of a file tell what it is."""
_GSI = re.compile(r"\s*\*?(11|41)[0-9.?]{4}[+?-]")
"""A line of GSI: a point or a code, in the columns where its word begins."""
_OTHERS = {
    "an Excel workbook": r"PK\x03\x04|\xd0\xcf\x11\xe0",
    "a PDF document": r"%PDF",
    "a Sokkia or Trimble field book (SDR, DC)": r"(00|10)NM",
    "a field book of Zeiss or Trimble (M5, Rec)": r"For\s*(M5|R5|R4|_M5)\s*\|",
    "a field book of Geodimeter (JOB, ARE)": r"\d{1,2}=[^\r\n]*\r?\n\d{1,2}=",
    "a raw file of Carlson (RW5)": r"JB,NM",
    "a raw file of Nikon": r"CO,\s*Nikon",
    "a raw file of Topcon (GTS)": r"_'|_\+",
    "a drawing (DXF)": r"\s*(999[^\r\n]*\r?\n[^\r\n]*\r?\n\s*)?0\r?\n\s*SECTION",
    "JSON": r"\s*[\[{]",
}
"""Files of surveyors that are not read, by how they begin."""


def read_survey(
    path: Path,
    prism: PrismUse | None = None,
    known: Mapping[str, FloatArray] | None = None,
    columns: Sequence[str] | None = None,
) -> Survey:
    """Read the points of a survey.

    Parameters
    ----------
    path : Path
        Leica GSI-8 or GSI-16, LandXML, Trimble JobXML, or a table of points.
    prism : PrismUse, optional
        Corrects distances; for GSI only, as the other kinds hold none.
    known : mapping of str to (3,) array, optional
        Known points, from which free stations are found; for GSI only, too.
    columns : sequence of str, optional
        What the columns of a table are, from the left: ``P, E, N, H`` and the like.

    Returns
    -------
    Survey
        Points in metres.

    Raises
    ------
    InputError
        If the file cannot be read; names file and line.
    SurveyError
        If it is of another kind (names it), or a prism, known points or columns are given that it has no use for.
    """
    begin = read_bytes(path)[:_BEGIN].decode("latin-1").removeprefix("\xef\xbb\xbf")
    ending = path.suffix.lower()
    if _GSI.match(begin) or (ending in (".gsi", ".gs8", ".g16") and columns is None):
        return read_gsi_points(path, prism, known)
    if prism is not None or known is not None:
        raise SurveyError(f"{path}: holds no distances; expected a .gsi file where a prism or known points are given")
    if begin.lstrip().startswith("<") or ending in (".xml", ".jxl"):
        return read_landxml_points(path)
    kind = next((kind for kind, start in _OTHERS.items() if re.match(start, begin)), None)
    if kind is not None:
        raise SurveyError(f"{path}: is {kind}; expected its points exported as GSI, LandXML or a table (CSV)")
    survey = read_point_table(path, columns)
    return _unnamed(path) if survey is None else survey


def _unnamed(path: Path) -> Survey:
    """Raise the error about a table whose columns nobody names."""
    first = columns_in(path)
    if first == "''":
        raise SurveyError(f"{path}: unknown kind of survey; expected a name that ends with .gsi, .csv or .xml")
    raise SurveyError(
        f"{path}, line 1: no header that names a point, its easting, northing and height, but {first}; expected one"
        " such as name,x_m,y_m,z_m or P,E,N,H, or 'columns: P,E,N,H' in survey.yaml (--columns)"
    )
