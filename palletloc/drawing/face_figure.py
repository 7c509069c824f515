"""The front face before and after: the model's outline, and the edges that were measured."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke

from palletloc.candidate import Candidate, ShotView
from palletloc.drawing.canvas import (
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
from palletloc.drawing.outline import face_outline, stretches_of
from palletloc.face_view import view_face
from palletloc.geometry import FloatArray, LevelPose
from palletloc.measurement import Reason
from palletloc.pallet import PalletModel
from palletloc.plane import PlaneView
from palletloc.refinement.edges import MeasuredEdge
from palletloc.refinement.system import USED_WEIGHT

_RESOLUTION = 0.002  # metres per pixel
_HALO = withStroke(linewidth=3.0, foreground="#101214")
_LEFT, _RIGHT, _HEAD, _TITLE, _AXIS, _FOOT = 84, 20, 46, 26, 34, 48  # in pixels


def face_figure(name: str, candidate: Candidate, shot: ShotView) -> Figure:
    """Draw a candidate's front face at its start and at the measured pose.

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
        The outline of the model on views of the vertical plane; at the measured pose, where there is one,
        with the measured edges.
    """
    panels = [("at the start", candidate.start, STARTED)]
    if candidate.pose is not None:
        panels.append(("at the measured pose", candidate.pose, MEASURED))
    views = [_view(shot, pose, candidate.model) for _, pose, _ in panels]
    width = WIDTH_PX - _LEFT - _RIGHT
    heights = [80.0 if view is None else width * view.grid.rows / view.grid.columns for view in views]
    figure = new_figure(_HEAD + sum(heights) + len(panels) * (_TITLE + _AXIS) + _FOOT)
    title = f"{name}: front face of {candidate.model.name}, seen from the aisle"
    add_text(figure, _LEFT, 14, title, size=13, bold=True)
    top = float(_HEAD)
    for (where, _, color), view, height in zip(panels, views, heights, strict=True):
        axes = add_axes(figure, _LEFT, top + _TITLE, width, height)
        result = _draw_panel(axes, view, candidate, where, color)
        add_text(figure, _LEFT, top + 6, f"{where.capitalize()}{result}", size=10.5)
        top += _TITLE + height + _AXIS
    axes.set_xlabel("to the right of the face's middle (m)")
    add_legend(figure, top + 16, *figure.axes)
    return figure


def _view(shot: ShotView, pose: LevelPose, model: PalletModel) -> PlaneView | None:
    seen = view_face(shot.projector, shot.image, shot.camera_from_forklift, pose, model, _RESOLUTION)
    return None if isinstance(seen, Reason) else seen


def _draw_panel(axes: Axes, view: PlaneView | None, candidate: Candidate, where: str, color: str) -> str:
    """Draw the outline and, where it was measured, the edges; return what is to be said of them."""
    if view is None:
        axes.text(0.5, 0.5, "not wholly seen by the camera", ha="center", va="center")
        axes.set(xticks=[], yticks=[])
        return ""
    show_view(axes, view)
    axes.set_ylabel("up (m)")
    for line in face_outline(candidate.model):
        axes.plot(*line.T, color=color, linewidth=1.5, path_effects=[_HALO], label=f"model {where}")
    return _draw_edges(axes, candidate) if color == MEASURED else ""


def _draw_edges(axes: Axes, candidate: Candidate) -> str:
    """Draw the measured edges, and return how many were used."""
    if candidate.face is None:
        return ""
    used = candidate.face.weights > USED_WEIGHT
    for one, good in zip(candidate.face.seen.edges, used, strict=True):
        for ends in edge_stretches(one, candidate.model):
            axes.plot(
                *ends.T,
                color="white" if good else REFUSED,
                linewidth=1.2,
                linestyle=(0, (3, 2)),
                path_effects=[_HALO],
                label="measured edge" if good else "measured edge, not used",
            )
    agree = f"{int(used.sum())} of {len(used)} measured edges agree"
    return f": {agree}; a camera sees rounded edges beside the drawn ones"


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
