"""Boards and tags as printable pages: vector squares at true scale, a ruler, and what the print is."""

from __future__ import annotations

import io

from matplotlib.axes import Axes
from matplotlib.backends.backend_pdf import FigureCanvasPdf
from matplotlib.figure import Figure
from matplotlib.patches import PathPatch
from matplotlib.path import Path as DrawnPath

from calibration.targets.targets import AprilGrid, CharucoBoard, PrintedPattern, Target, patterns

_INCH, _MM = 0.0254, 0.001
"""In metres."""
_MARGIN, _FOOT, _LEAST_WIDTH = 0.015, 0.024, 0.1
"""White around the pattern, room for ruler and title below it, and width of the narrowest page, in metres."""
_RULER_MM = 100
"""Length of the ruler, in millimetres."""
_POINT, _LETTER = _INCH / 72, 0.56
"""Size of type in metres, and the width of a letter in units of its size."""


def board_pdf(target: Target) -> bytes:
    """Return a page of PDF with a target.

    Parameters
    ----------
    target : Target
        What to print.

    Returns
    -------
    bytes
        One page that is as large as the pattern, its white margin and the ruler below it.

    Raises
    ------
    TargetError
        If the target cannot exist.
    """
    pattern = patterns(target)[0]
    margin = max(_MARGIN, pattern.window if not isinstance(target, CharucoBoard) else 0.0)
    width = max(pattern.width, _RULER_MM * _MM, _LEAST_WIDTH) + 2 * margin
    height = pattern.height + 2 * margin + _FOOT
    figure = Figure(figsize=(width / _INCH, height / _INCH))
    FigureCanvasPdf(figure)
    axes = figure.add_axes((0, 0, 1, 1))
    axes.set_xlim(-margin, width - margin)
    axes.set_ylim(height - margin, -margin)
    axes.axis("off")
    axes.add_patch(PathPatch(_outline(pattern), facecolor="black", edgecolor="none", linewidth=0))
    _add_ruler(axes, pattern.height + margin)
    title = _title(target, pattern)
    size = min(7.0, (width - 2 * margin) / _POINT / (_LETTER * len(title)))
    axes.text(0, pattern.height + margin + 0.016, title, size=size, va="top", parse_math=False)
    buffer = io.BytesIO()
    figure.savefig(buffer, format="pdf", metadata={"Title": title, "CreationDate": None})
    return buffer.getvalue()


def _outline(pattern: PrintedPattern) -> DrawnPath:
    """Return all black as one path: a viewer then draws no bright seams between rectangles."""
    paths = [DrawnPath([(a, b), (c, b), (c, d), (a, d), (a, b)], closed=True) for a, b, c, d in pattern.black]
    return DrawnPath.make_compound_path(*paths)


def _add_ruler(axes: Axes, top: float) -> None:
    """Draw 100 mm with a line at each millimetre; a print at another scale shows against a steel ruler."""
    for mm in range(_RULER_MM + 1):
        length = 0.006 if mm % 10 == 0 else 0.004 if mm % 5 == 0 else 0.0025
        axes.plot([mm * _MM] * 2, [top, top + length], color="black", linewidth=0.25, solid_capstyle="butt")
        if mm % 10 == 0:
            axes.text(mm * _MM, top + 0.007, str(mm), size=6, ha="center", va="top")


def _title(target: Target, pattern: PrintedPattern) -> str:
    size = f"{1000 * pattern.width:g} x {1000 * pattern.height:g} mm"
    first, last = pattern.marker_ids[0], pattern.marker_ids[-1]
    if isinstance(target, CharucoBoard):
        squares = f"squares {1000 * target.square:g} mm, markers {1000 * target.marker:g} mm"
        what = f"ChArUco {target.columns} x {target.rows}, {squares}, {target.dictionary} ids {first} to {last}"
        return f"{what}; {size}; print at 100 %"
    if isinstance(target, AprilGrid):
        what = f"{target.columns} x {target.rows} tags {1000 * target.tag:g} mm, {target.dictionary}"
        return f"{what} ids {first} to {last}; {size}; print at 100 %"
    return f"{target.dictionary} id {first}; {size}; print at 100 %"


def target_yaml(target: Target) -> str:
    """Return the lines about a target for extrinsics.yaml.

    Examples
    --------
    >>> print(target_yaml(CharucoBoard(7, 5, 0.1, 0.075, "DICT_4X4_250", 17)))
    charuco: {columns: 7, rows: 5, square_m: 0.1, marker_m: 0.075, dictionary: DICT_4X4_250, first_id: 17}
    """
    if isinstance(target, CharucoBoard):
        return (
            f"charuco: {{columns: {target.columns}, rows: {target.rows}, square_m: {target.square:g},"
            f" marker_m: {target.marker:g}, dictionary: {target.dictionary}, first_id: {target.first_id}}}"
        )
    if isinstance(target, AprilGrid):
        return (
            f"aprilgrid: {{columns: {target.columns}, rows: {target.rows}, tag_m: {target.tag:g},"
            f" spacing: {target.spacing:g}, first_id: {target.first_id}, border_bits: {target.border}}}"
        )
    return f"tag: {{dictionary: {target.dictionary}, id: {target.id}, size_m: {target.size:g}}}"
