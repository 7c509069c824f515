"""The front face before and after: the model's outline, what became of each edge, and the numbers of all of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from palletloc.candidate import Fit, Refusal
from palletloc.drawing import canvas
from palletloc.drawing.outline import face_outline, stretches_of
from palletloc.explained import EdgeAccount, EdgeFate, account_edges, given_up
from palletloc.geometry import FloatArray, LevelPose
from palletloc.pallet import PalletModel
from palletloc.plane import PlaneView
from palletloc.refinement.edges import MeasuredEdge
from palletloc.shot import MIN_DISTANCE, Shot

_AROUND = 0.06
"""What a view shows beyond the face, in metres."""
_RESOLUTION = 0.002
"""Of the views, in metres per pixel: a face of 1.1 m is half as wide as the page."""
_HALO = canvas.halo(3.6)
"""Around lines and numbers on the views."""
_BESIDE = 0.017
"""Distance of an edge's number from it, in metres."""
_LEFT, _RIGHT, _HEAD, _TITLE, _AXIS, _FOOT = 84, 20, 46, 26, 34, 48
"""Borders of the page, room for a view's title and axis, and for the keys, in pixels."""
_ROW, _TABLE_HEAD, _TABLE_FOOT, _CHART = 22, 34, 50, 760
"""Of the table: height of a row, room above and below the rows, left border of the offsets' chart, in pixels."""
_COLUMNS = (
    ("", 22, "right"),
    ("edge", 34, "left"),
    ("", 260, "left"),
    ("offset mm", 404, "right"),
    (f"{canvas.SIGMA} mm", 464, "right"),
    ("weight", 530, "right"),
    ("seen %", 600, "right"),
)
"""Title, place in pixels from the left, alignment."""
_MM = 1000.0
"""Millimetres per metre."""
_LEAST_MM = 4.0
"""Least half width of the offsets' chart, in millimetres: below it, noise would look like a fault."""


@dataclass(frozen=True, slots=True)
class _FateStyle:
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


_FATE_STYLES = {
    EdgeFate.USED: _FateStyle("used", "#5cc8ff", "#0b6bcb", "-", "o"),
    EdgeFate.REJECTED: _FateStyle("rejected", "#ffa02e", "#c2410c", (0, (5, 2)), "X"),
    EdgeFate.NOT_SEEN: _FateStyle("not seen", "#ffffff", canvas.FAINT, (0, (1, 1.6)), ""),
    EdgeFate.HIDDEN: _FateStyle("hidden", "#e3b3ff", "#7e22ce", (0, (6, 2, 1, 2)), "s"),
}
"""How the fates of edges look: every one differs from the others in colour and in line."""


def _table_height(edges: Sequence[EdgeAccount]) -> float:
    """Return how much of a page the table of edges takes, in pixels."""
    return float(_TABLE_HEAD + _ROW * len(edges) + _TABLE_FOOT)


def _draw_table(figure: Figure, top: float, edges: Sequence[EdgeAccount]) -> None:
    """Draw the table of a face and, on the same rows, the offsets with two standard deviations."""
    height = _ROW * len(edges)
    caption = f"offset outwards from where the fit looked for it (mm); bars: 2{canvas.SIGMA}"
    canvas.add_text(figure, _CHART, top + 11, caption, size=9.5)
    rows = canvas.add_axes(figure, _LEFT, top + _TABLE_HEAD, canvas.WIDTH_PX - _LEFT - _RIGHT, height)
    rows.set(xlim=(0, canvas.WIDTH_PX - _LEFT - _RIGHT), ylim=(len(edges) - 0.5, -0.5), facecolor="none")
    rows.set_axis_off()
    rows.axhline(-0.5, color=canvas.GRID, linewidth=1.2)
    for text, at, align in _COLUMNS:
        rows.text(at, -1.0, text, ha=align, va="center", size=9.5, color=canvas.FAINT)
    for row, edge in enumerate(edges):
        _write_row(rows, row, edge)
    chart = canvas.add_axes(figure, _CHART, top + _TABLE_HEAD, canvas.WIDTH_PX - _CHART - _RIGHT, height)
    _draw_offsets(chart, edges)


def _write_row(axes: Axes, row: int, edge: EdgeAccount) -> None:
    if row % 2:
        axes.axhspan(row - 0.5, row + 0.5, xmax=0.53, color=canvas.GRID, alpha=0.35, linewidth=0)
    style = _FATE_STYLES[edge.fate]
    load = " (load above)" if edge.loaded else ""
    cells = [str(edge.number), edge.name + load, style.label, "", "", "", ""]
    if edge.measured is not None:
        fit = edge.measured.fit
        offset = f"{round(_MM * fit.offset, 1) + 0.0:+.1f}".replace("-", canvas.MINUS)
        cells[3:] = [offset, f"{_MM * edge.sigma:.1f}", f"{edge.weight:.2f}", f"{100 * fit.coverage:.0f}"]
    for i, (cell, (_, at, align)) in enumerate(zip(cells, _COLUMNS, strict=True)):
        text = axes.text(at, row, cell, ha=align, va="center", size=9.5)
        text.set(color=style.paper if i in (0, 2) else canvas.INK, weight="bold" if i in (0, 2) else "normal")


def _draw_offsets(axes: Axes, edges: Sequence[EdgeAccount]) -> None:
    axes.set(ylim=(len(edges) - 0.5, -0.5), yticks=range(len(edges)))
    axes.set_yticklabels([str(edge.number) for edge in edges])
    axes.grid(axis="x", color=canvas.GRID, linewidth=0.6)
    axes.set_axisbelow(True)
    axes.axvline(0.0, color=canvas.INK, linewidth=1.0)
    drawn = [(row, edge, edge.measured) for row, edge in enumerate(edges) if edge.measured is not None]
    ends = [
        _MM * (abs(measured.fit.offset) + (2 * edge.sigma if edge.weight > 0 else 0)) for _, edge, measured in drawn
    ]
    limit = 1.08 * float(np.max([_LEAST_MM, *ends]))
    axes.set_xlim(-limit, limit)
    for row, edge, measured in drawn:
        style = _FATE_STYLES[edge.fate]
        axes.errorbar(
            _MM * measured.fit.offset,
            row,
            xerr=2 * _MM * edge.sigma,
            fmt=style.mark,
            color=style.paper,
            markersize=7,
            elinewidth=2.6,
            ecolor=(style.paper, 0.45),
        )
    axes.set_xlabel("mm")


def face_figure(name: str, outcome: Fit | Refusal, shot: Shot) -> Figure:
    """Draw a candidate's front face at its start and at the measured pose, and list its edges.

    Parameters
    ----------
    name : str
        Of the candidate.
    outcome : Fit or Refusal
        What became of it.
    shot : Shot
        Where it was measured.

    Returns
    -------
    Figure
        The outline of the model on views of the vertical plane; at the measured pose, where there is one, with
        every edge of the face by what became of it, numbered as in the table below.
    """
    candidate, fit = outcome.candidate, outcome.fit
    panels = [("at the start", candidate.start, canvas.STARTED)]
    if fit is not None:
        measured = ("at the measured pose", fit.pose, canvas.MEASURED)
        refused = ("at the pose that was given up", fit.pose, canvas.REFUSED)
        panels.append(measured if isinstance(outcome, Fit) else refused)
    views = [_view(shot, pose, candidate.model) for _, pose, _ in panels]
    width = canvas.WIDTH_PX - _LEFT - _RIGHT
    heights = [80.0 if view is None else width * view.grid.rows / view.grid.columns for view in views]
    face = None if fit is None else fit.face
    edges = () if face is None else account_edges(face, candidate.model)
    keys = canvas.LEGEND_ROW_PX if edges else 0
    table = _table_height(edges) if edges else 0.0
    figure = canvas.new_figure(_HEAD + sum(heights) + len(panels) * (_TITLE + _AXIS) + _FOOT + keys + table)
    title = f"{name}: front face of {candidate.model.name}, seen from the aisle{given_up(outcome)}"
    canvas.add_text(figure, _LEFT, 14, title, size=13, bold=True)
    top = float(_HEAD)
    for i, ((where, _, color), view, height) in enumerate(zip(panels, views, heights, strict=True)):
        axes = canvas.add_axes(figure, _LEFT, top + _TITLE, width, height)
        shown = edges if i > 0 else ()
        _draw_panel(axes, view, candidate.model, shown, where, color)
        if shown and face is not None and view is not None:
            _shade_hidden(axes, face.seen.hidden)
        canvas.add_text(figure, _LEFT, top + 6, where.capitalize() + _counts(shown), size=10.5)
        top += _TITLE + height + _AXIS
    axes.set_xlabel("to the right of the face's middle (m)")
    canvas.add_legend(figure, top + 16, *figure.axes, columns=6)
    if edges:
        _draw_table(figure, top + _FOOT + keys - 8, edges)
    return figure


def _view(shot: Shot, pose: LevelPose, model: PalletModel) -> PlaneView | None:
    """Return the plane of a face; None where the face is not wholly seen."""
    if shot.camera_in(pose)[2] < MIN_DISTANCE:
        return None
    half = model.width / 2 + _AROUND
    view = shot.vertical_view(pose, (-half, half, -_AROUND, model.height + _AROUND), _RESOLUTION)
    return view if view.valid.all() else None


def _counts(edges: Sequence[EdgeAccount]) -> str:
    """Return how many edges the fit used, rejected and did not see."""
    if not edges:
        return ""
    counts = {fate: sum(edge.fate is fate for edge in edges) for fate in _FATE_STYLES}
    counted = ", ".join(f"{count} {_FATE_STYLES[fate].label}" for fate, count in counts.items() if count)
    return f": of {len(edges)} lines of the face {counted}; a camera sees rounded edges beside the drawn ones"


def _draw_panel(
    axes: Axes, view: PlaneView | None, model: PalletModel, edges: Sequence[EdgeAccount], where: str, color: str
) -> None:
    """Draw the outline and what became of the edges."""
    if view is None:
        axes.text(0.5, 0.5, "not wholly seen by the camera", ha="center", va="center")
        axes.set(xticks=[], yticks=[])
        return
    canvas.show_view(axes, view)
    axes.set_ylabel("up (m)")
    for line in face_outline(model):
        axes.plot(*line.T, color=color, linewidth=0.9 if edges else 1.5, label=f"model {where}")
        if not edges:
            axes.lines[-1].set_path_effects([_HALO])
    for edge in edges:
        _draw_edge(axes, edge, model)


def _shade_hidden(axes: Axes, spans: Sequence[tuple[float, float]]) -> None:
    """Hatch what something stands before."""
    style = _FATE_STYLES[EdgeFate.HIDDEN]
    for left, right in spans:
        axes.axvspan(left, right, facecolor=(style.color, 0.12), edgecolor=style.color, hatch="//", linewidth=0.8)
        axes.patches[-1].set_label("something stands before the face")


def _draw_edge(axes: Axes, edge: EdgeAccount, model: PalletModel) -> None:
    """Draw an edge where it was measured, or where the model has it, with its number beside it."""
    style = _FATE_STYLES[edge.fate]
    measured = edge.measured
    ends = stretches_of(model, edge.edge) if measured is None else edge_stretches(measured, model)
    for stretch in ends:
        axes.plot(*stretch.T, color=style.color, linewidth=2.2, linestyle=style.line, label=style.label)
        axes.lines[-1].set_path_effects([_HALO])
        middle = stretch.mean(axis=0) + _BESIDE * np.array(edge.edge.outward)
        text = axes.text(float(middle[0]), float(middle[1]), str(edge.number), ha="center", va="center_baseline")
        text.set(size=9.5, weight="bold", color=style.color, path_effects=[_HALO])


def edge_stretches(measured: MeasuredEdge, model: PalletModel) -> FloatArray:
    """Return where a line of the face was measured, (n, 2, 2): ends of its stretches, in metres."""
    ends = stretches_of(model, measured.edge)
    outward = np.array(measured.edge.outward)
    along = (ends - np.array(measured.edge.middle)) @ np.abs(outward[::-1])
    across = measured.shift.mean + measured.fit.offset + measured.fit.slope * along
    return np.asarray(ends + across[..., None] * outward)
