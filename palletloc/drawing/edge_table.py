"""The edges of a face as a table, with their offsets as a chart beside it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from palletloc.drawing.canvas import FAINT, GRID, INK, WIDTH_PX, add_axes, add_text
from palletloc.edge_account import EdgeAccount, EdgeFate

_LEFT, _RIGHT, _ROW, _HEAD, _FOOT = 84, 20, 22, 34, 50  # in pixels
_CHART = 760
_SIGMA = "\N{GREEK SMALL LETTER SIGMA}"
_COLUMNS = (
    ("", 22, "right"),
    ("edge", 34, "left"),
    ("", 260, "left"),
    ("offset mm", 404, "right"),
    (f"{_SIGMA} mm", 464, "right"),
    ("weight", 530, "right"),
    ("seen %", 600, "right"),
)
"""Title, place in pixels from the left, alignment."""
_MM = 1000.0
_LEAST_MM = 4.0


@dataclass(frozen=True, slots=True)
class FateStyle:
    """How an edge is drawn."""

    label: str
    """What became of it, for people."""
    color: str
    """On photographs."""
    paper: str
    """On paper."""
    line: str | tuple[int, tuple[float, ...]]
    """Matplotlib's line style: the second sign beside the colour."""
    mark: str
    """Matplotlib's marker."""


FATE_STYLES = {
    EdgeFate.USED: FateStyle("used", "#5cc8ff", "#0b6bcb", "-", "o"),
    EdgeFate.REJECTED: FateStyle("rejected", "#ffa02e", "#c2410c", (0, (5, 2)), "X"),
    EdgeFate.NOT_SEEN: FateStyle("not seen", "#ffffff", FAINT, (0, (1, 1.6)), ""),
    EdgeFate.HIDDEN: FateStyle("hidden", "#e3b3ff", "#7e22ce", (0, (6, 2, 1, 2)), "s"),
}
"""How the fates of edges look: every one differs from the others in colour and in line."""


def edge_table_height(edges: Sequence[EdgeAccount]) -> float:
    """Return how much of a page the table of edges takes, in pixels."""
    return float(_HEAD + _ROW * len(edges) + _FOOT)


def draw_edge_table(figure: Figure, top: float, edges: Sequence[EdgeAccount]) -> None:
    """Draw the table and, on the same rows, the offsets with two standard deviations.

    Parameters
    ----------
    figure : Figure
        The page.
    top : float
        Where the table begins, in pixels from the upper border.
    edges : sequence of EdgeAccount
        Of one face.
    """
    height = _ROW * len(edges)
    told = f"offset outwards from where the fit looked for it (mm); bars: 2{_SIGMA}"
    add_text(figure, _CHART, top + 11, told, size=9.5)
    rows = add_axes(figure, _LEFT, top + _HEAD, WIDTH_PX - _LEFT - _RIGHT, height)
    rows.set(xlim=(0, WIDTH_PX - _LEFT - _RIGHT), ylim=(len(edges) - 0.5, -0.5), facecolor="none")
    rows.set_axis_off()
    rows.axhline(-0.5, color=GRID, linewidth=1.2)
    for text, at, align in _COLUMNS:
        rows.text(at, -1.0, text, ha=align, va="center", size=9.5, color=FAINT)
    for row, one in enumerate(edges):
        _write_row(rows, row, one)
    chart = add_axes(figure, _CHART, top + _HEAD, WIDTH_PX - _CHART - _RIGHT, height)
    _draw_offsets(chart, edges)


def _write_row(axes: Axes, row: int, one: EdgeAccount) -> None:
    if row % 2:
        axes.axhspan(row - 0.5, row + 0.5, xmax=0.53, color=GRID, alpha=0.35, linewidth=0)
    style = FATE_STYLES[one.fate]
    load = " (load above)" if one.loaded else ""
    cells = [str(one.number), one.name + load, style.label, "", "", "", ""]
    if one.measured is not None:
        fit = one.measured.fit
        offset = f"{round(_MM * fit.offset, 1) + 0.0:+.1f}".replace("-", "\N{MINUS SIGN}")
        cells[3:] = [offset, f"{_MM * one.sigma:.1f}", f"{one.weight:.2f}", f"{100 * fit.coverage:.0f}"]
    for i, (cell, (_, at, align)) in enumerate(zip(cells, _COLUMNS, strict=True)):
        text = axes.text(at, row, cell, ha=align, va="center", size=9.5)
        text.set(color=style.paper if i in (0, 2) else INK, weight="bold" if i in (0, 2) else "normal")


def _draw_offsets(axes: Axes, edges: Sequence[EdgeAccount]) -> None:
    axes.set(ylim=(len(edges) - 0.5, -0.5), yticks=range(len(edges)))
    axes.set_yticklabels([str(one.number) for one in edges])
    axes.grid(axis="x", color=GRID, linewidth=0.6)
    axes.set_axisbelow(True)
    axes.axvline(0.0, color=INK, linewidth=1.0)
    drawn = [(row, one, one.measured) for row, one in enumerate(edges) if one.measured is not None]
    ends = [_MM * (abs(measured.fit.offset) + (2 * one.sigma if one.weight > 0 else 0)) for _, one, measured in drawn]
    limit = 1.08 * float(np.max([_LEAST_MM, *ends]))
    axes.set_xlim(-limit, limit)
    for row, one, measured in drawn:
        style = FATE_STYLES[one.fate]
        axes.errorbar(
            _MM * measured.fit.offset,
            row,
            xerr=2 * _MM * one.sigma,
            fmt=style.mark,
            color=style.paper,
            markersize=7,
            elinewidth=2.6,
            ecolor=(style.paper, 0.45),
        )
    axes.set_xlabel("mm")
