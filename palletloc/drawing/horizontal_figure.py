"""Yaw: the horizontal plane through an edge of the face, as first placed and after the correction."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke

from palletloc.boundary import BoundaryLine
from palletloc.candidate import Candidate
from palletloc.drawing.canvas import (
    MEASURED,
    REFUSED,
    STARTED,
    WIDTH_PX,
    add_axes,
    add_text,
    legend_below,
    new_figure,
    show_view,
)
from palletloc.drawing.outline import seen_on_plane
from palletloc.face import EdgeKind, edge_shift
from palletloc.geometry import FloatArray
from palletloc.measurement import YawSource
from palletloc.pallet import PalletModel
from palletloc.pipeline import nearest_line
from palletloc.yaw import HorizontalView, YawVote

EDGE_NAMES = {
    EdgeKind.BOTTOM: "lower edge",
    EdgeKind.TOP: "upper edge",
    EdgeKind.SIDE: "side",
    EdgeKind.OPENING_TOP: "openings' upper edges",
    EdgeKind.OPENING_BOTTOM: "openings' lower edges",
    EdgeKind.OPENING_SIDE: "opening's side",
}
"""What people call the parts of a face."""
_EDGE_COLORS = {
    EdgeKind.BOTTOM: MEASURED,
    EdgeKind.TOP: "#38d3ff",
    EdgeKind.OPENING_TOP: "#ff9f43",
    EdgeKind.OPENING_BOTTOM: "#d9a5ff",
}
_PLANES = {YawSource.BOTTOM: "lower", YawSource.TOP: "upper"}
_HALO = withStroke(linewidth=3.0, foreground="#101214")
_LEFT, _RIGHT, _HEAD, _TITLE, _FOOT, _AXIS = 66, 20, 46, 26, 62, 34  # in pixels
_HIGHEST = 420


def horizontal_figure(name: str, candidate: Candidate) -> Figure:
    """Draw the lines that give the yaw of a candidate.

    Parameters
    ----------
    name : str
        Of the candidate.
    candidate : Candidate
        With at least one horizontal view.

    Returns
    -------
    Figure
        The first view with the lines that the Hough transform found; below it, where the yaw was measured,
        the last view with the lines along the face's level edges.

    Raises
    ------
    ValueError
        Where the candidate has no horizontal view.
    """
    if not candidate.horizontal:
        raise ValueError(f"candidate {name} has no horizontal view to draw")
    first, last = candidate.horizontal[0], candidate.horizontal[-1]
    # without votes, the lines are those of the last view
    only_lines = candidate.yaw is None
    views = [last] if only_lines else [first, last]
    sizes = [_size(seen) for seen in views]
    figure = new_figure(_HEAD + sum(height + _TITLE + _AXIS for _, height in sizes) + _FOOT)
    title = f"{name}: horizontal plane through the {_PLANES[first.source]} edge of the face, seen from above"
    add_text(figure, _LEFT, 14, title, size=13, bold=True)
    top = float(_HEAD)
    for i, (seen, (width, height)) in enumerate(zip(views, sizes, strict=True)):
        axes = add_axes(figure, _LEFT, top + _TITLE, width, height)
        show_view(axes, seen.view)
        if only_lines or i == 0:
            text = _draw_found(axes, candidate.lines)
        else:
            text = _draw_votes(axes, seen, candidate)
        add_text(figure, _LEFT, top + 6, text, size=10.5)
        axes.set_ylabel("into the shelf (m)")
        top += _TITLE + height + _AXIS
    axes.set_xlabel("to the right of the face's middle (m)")
    legend_below(figure, *figure.axes)
    return figure


def _size(seen: HorizontalView) -> tuple[float, float]:
    """Return width and height of a view on the page, in pixels."""
    aspect = seen.view.grid.columns / seen.view.grid.rows
    width = min(WIDTH_PX - _LEFT - _RIGHT, _HIGHEST * aspect)
    return width, width / aspect


def _draw_found(axes: Axes, lines: Sequence[BoundaryLine]) -> str:
    """Draw what the Hough transform found, and return what that means."""
    axes.axhline(0.0, color="white", linewidth=1.0, linestyle=(0, (6, 5)), label="expected edge")
    chosen = nearest_line(list(lines))
    ends = np.array(axes.get_xlim())
    for line in lines:
        best = line is chosen
        axes.plot(
            ends,
            line.up + np.tan(line.turn) * ends,
            color=STARTED,
            linewidth=2.2 if best else 1.0,
            linestyle="-" if best else ":",
            path_effects=[_HALO] if best else [],
            label="line nearest to it" if best else "other lines of the Hough transform",
        )
    if chosen is None:
        return "As first placed: the Hough transform found no line"
    return (
        f"As first placed: {len(lines)} lines found; the nearest long one is turned by"
        f" {np.degrees(chosen.turn):+.2f}\N{DEGREE SIGN} against the view's centre line"
    )


def _draw_votes(axes: Axes, seen: HorizontalView, candidate: Candidate) -> str:
    """Draw the measured lines, and return what that means."""
    if candidate.yaw is None:
        return ""
    for vote in candidate.yaw.votes:
        color = _EDGE_COLORS.get(vote.edge.kind, MEASURED) if vote.used else REFUSED
        state = "" if vote.used else ", not used"
        axes.plot(
            *vote_line(seen, vote, candidate.model).T,
            color=color,
            linewidth=2.2 if vote.used else 1.6,
            linestyle="-" if vote.used else "--",
            path_effects=[_HALO] if vote.used else [],
            label=f"{EDGE_NAMES[vote.edge.kind]}: {_degrees(vote.turn, vote.sigma, sign='+')}{state}",
        )
    return (
        f"After the correction: yaw {_degrees(candidate.yaw.yaw, candidate.yaw.sigma)};"
        " what the lines along the level edges still turn is in the key"
    )


def vote_line(seen: HorizontalView, vote: YawVote, model: PalletModel) -> FloatArray:
    """Return the ends of a voter's line on its view, (2, 2), in metres.

    Parameters
    ----------
    seen : HorizontalView
        The view.
    vote : YawVote
        The line.
    model : PalletModel
        Of the candidate.
    """
    camera = seen.plane_from_camera
    face_from_camera = np.array([camera[0], camera[2] + seen.height, -camera[1]])
    shift = edge_shift(vote.edge, face_from_camera, model).mean * np.array(vote.edge.outward)
    right, up = (np.array([vote.edge.start, vote.edge.end]) + shift).T
    ends = seen_on_plane(np.column_stack([right, np.zeros(2), up - seen.height]), camera)
    along = ends[:, 0] - ends[:, 0].mean()
    return ends + np.column_stack([np.zeros(2), vote.fit.offset + vote.fit.slope * along])


def _degrees(angle: float, sigma: float, sign: str = "") -> str:
    turn, spread = np.degrees(angle), np.degrees(sigma)
    return f"{turn:{sign}.2f}\N{DEGREE SIGN} \N{PLUS-MINUS SIGN} {spread:.2f}\N{DEGREE SIGN}"
