"""The front face before and after: the model's outline, what became of each edge, and the numbers of all of them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke

from palletloc.candidate import Candidate, ShotView
from palletloc.drawing.canvas import (
    LEGEND_ROW_PX,
    MEASURED,
    REFUSED,
    STARTED,
    WIDTH_PX,
    add_axes,
    add_legend,
    add_text,
    new_figure,
    show_view,
)
from palletloc.drawing.edge_table import FATE_STYLES, draw_edge_table, edge_table_height
from palletloc.drawing.naming import given_up
from palletloc.drawing.outline import face_outline, stretches_of
from palletloc.edge_account import EdgeAccount, EdgeFate, account_edges
from palletloc.face_view import view_face
from palletloc.geometry import FloatArray, LevelPose
from palletloc.measurement import Reason
from palletloc.pallet import PalletModel
from palletloc.plane import PlaneView
from palletloc.refinement.edges import MeasuredEdge

_RESOLUTION = 0.002  # metres per pixel
_HALO = withStroke(linewidth=3.6, foreground="#101214")
_LEFT, _RIGHT, _HEAD, _TITLE, _AXIS, _FOOT = 84, 20, 46, 26, 34, 48  # in pixels
_BESIDE = 0.017
"""Distance of an edge's number from it, in metres."""


def face_figure(name: str, candidate: Candidate, shot: ShotView) -> Figure:
    """Draw a candidate's front face at its start and at the measured pose, and list its edges.

    Parameters
    ----------
    name : str
        Of the candidate.
    candidate : Candidate
        The candidate.
    shot : ShotView
        Where it was measured.

    Returns
    -------
    Figure
        The outline of the model on views of the vertical plane; at the measured pose, where there is one, with
        every edge of the face by what became of it, numbered as in the table below.
    """
    panels = [("at the start", candidate.start, STARTED)]
    if candidate.pose is not None:
        measured = ("at the measured pose", candidate.pose, MEASURED)
        refused = ("at the pose that was given up", candidate.pose, REFUSED)
        panels.append(measured if candidate.refusal is None else refused)
    views = [_view(shot, pose, candidate.model) for _, pose, _ in panels]
    width = WIDTH_PX - _LEFT - _RIGHT
    heights = [80.0 if view is None else width * view.grid.rows / view.grid.columns for view in views]
    edges = account_edges(candidate.face, candidate.model) if candidate.face and candidate.pose else ()
    keys = LEGEND_ROW_PX if edges else 0
    table = edge_table_height(edges) if edges else 0.0
    figure = new_figure(_HEAD + sum(heights) + len(panels) * (_TITLE + _AXIS) + _FOOT + keys + table)
    title = f"{name}: front face of {candidate.model.name}, seen from the aisle{given_up(candidate)}"
    add_text(figure, _LEFT, 14, title, size=13, bold=True)
    top = float(_HEAD)
    for i, ((where, _, color), view, height) in enumerate(zip(panels, views, heights, strict=True)):
        axes = add_axes(figure, _LEFT, top + _TITLE, width, height)
        shown = edges if i > 0 else ()
        _draw_panel(axes, view, candidate.model, shown, where, color)
        if shown and candidate.face is not None and view is not None:
            _shade_hidden(axes, candidate.face.seen.hidden)
        add_text(figure, _LEFT, top + 6, where.capitalize() + _told(shown), size=10.5)
        top += _TITLE + height + _AXIS
    axes.set_xlabel("to the right of the face's middle (m)")
    add_legend(figure, top + 16, *figure.axes, columns=6)
    if edges:
        draw_edge_table(figure, top + _FOOT + keys - 8, edges)
    return figure


def _view(shot: ShotView, pose: LevelPose, model: PalletModel) -> PlaneView | None:
    seen = view_face(shot.projector, shot.image, shot.camera_from_forklift, pose, model, _RESOLUTION)
    return None if isinstance(seen, Reason) else seen


def _told(edges: Sequence[EdgeAccount]) -> str:
    """Return what is to be said of the edges."""
    if not edges:
        return ""
    counts = {fate: sum(one.fate is fate for one in edges) for fate in FATE_STYLES}
    told = ", ".join(f"{count} {FATE_STYLES[fate].label}" for fate, count in counts.items() if count)
    return f": of {len(edges)} lines of the face {told}; a camera sees rounded edges beside the drawn ones"


def _draw_panel(
    axes: Axes, view: PlaneView | None, model: PalletModel, edges: Sequence[EdgeAccount], where: str, color: str
) -> None:
    """Draw the outline and what became of the edges."""
    if view is None:
        axes.text(0.5, 0.5, "not wholly seen by the camera", ha="center", va="center")
        axes.set(xticks=[], yticks=[])
        return
    show_view(axes, view)
    axes.set_ylabel("up (m)")
    for line in face_outline(model):
        axes.plot(*line.T, color=color, linewidth=0.9 if edges else 1.5, label=f"model {where}")
        if not edges:
            axes.lines[-1].set_path_effects([_HALO])
    for one in edges:
        _draw_edge(axes, one, model)


def _shade_hidden(axes: Axes, spans: Sequence[tuple[float, float]]) -> None:
    """Hatch what something stands before."""
    style = FATE_STYLES[EdgeFate.HIDDEN]
    for left, right in spans:
        axes.axvspan(left, right, facecolor=(style.color, 0.12), edgecolor=style.color, hatch="//", linewidth=0.8)
        axes.patches[-1].set_label("something stands before the face")


def _draw_edge(axes: Axes, one: EdgeAccount, model: PalletModel) -> None:
    """Draw an edge where it was measured, or where the model has it, with its number beside it."""
    style = FATE_STYLES[one.fate]
    measured = one.measured
    ends = stretches_of(model, one.edge) if measured is None else edge_stretches(measured, model)
    for stretch in ends:
        axes.plot(*stretch.T, color=style.color, linewidth=2.2, linestyle=style.line, label=style.label)
        axes.lines[-1].set_path_effects([_HALO])
        middle = stretch.mean(axis=0) + _BESIDE * np.array(one.edge.outward)
        text = axes.text(float(middle[0]), float(middle[1]), str(one.number), ha="center", va="center_baseline")
        text.set(size=9.5, weight="bold", color=style.color, path_effects=[_HALO])


def edge_stretches(measured: MeasuredEdge, model: PalletModel) -> FloatArray:
    """Return where a line of the face was measured, (n, 2, 2): ends of its stretches, in metres.

    Parameters
    ----------
    measured : MeasuredEdge
        The line.
    model : PalletModel
        The pallet.
    """
    ends = stretches_of(model, measured.edge)
    outward = np.array(measured.edge.outward)
    along = (ends - np.array(measured.edge.middle)) @ np.abs(outward[::-1])
    across = measured.shift.mean + measured.fit.offset + measured.fit.slope * along
    return np.asarray(ends + across[..., None] * outward)
