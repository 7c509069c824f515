"""The paper's own steps: yaw on the horizontal plane through an edge of the face, and position by the plane sweep."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from palletloc.baselines import nearest_line
from palletloc.candidate import Fit, Refusal, last_step, steps_of
from palletloc.drawing import canvas
from palletloc.drawing.outline import seen_on_plane, stretches_of
from palletloc.face import EdgeKind, edge_shift
from palletloc.geometry import FloatArray, LevelPose
from palletloc.measurement import YawSource
from palletloc.pallet import PalletModel
from palletloc.paper.boundary import BoundaryLine
from palletloc.paper.horizontal_view import HorizontalView
from palletloc.paper.joint_search import JointSearch
from palletloc.paper.position import Sweep
from palletloc.paper.yaw import YawEstimate, YawVote

_EDGE_NAMES = {
    EdgeKind.BOTTOM: "lower edge",
    EdgeKind.TOP: "upper edge",
    EdgeKind.SIDE: "side",
    EdgeKind.OPENING_TOP: "openings' upper edges",
    EdgeKind.OPENING_BOTTOM: "openings' lower edges",
    EdgeKind.OPENING_SIDE: "opening's side",
}
"""What people call the parts of a face."""
_EDGE_COLORS = {
    EdgeKind.BOTTOM: canvas.MEASURED,
    EdgeKind.TOP: "#38d3ff",
    EdgeKind.OPENING_TOP: "#ff9f43",
    EdgeKind.OPENING_BOTTOM: "#d9a5ff",
}
"""Colours of the level edges on photographs."""
_PLANES = {YawSource.BOTTOM: "lower", YawSource.TOP: "upper"}
"""Which edge of the face a plane goes through."""
_HALO = canvas.halo(3.0)
"""Around lines on the views."""
_LEFT, _RIGHT, _HEAD, _TITLE, _AXIS, _KEYS = 84, 20, 46, 26, 46, 2 * canvas.LEGEND_ROW_PX + 4
"""Of the yaw's figure: borders, room for a view's title, axis and keys, in pixels."""
_HIGHEST = 420
"""Most height of a view, in pixels: two fit on a screen."""
_SWEEP_LEFT, _HEIGHT, _FOOT = 66, 320, 84
"""Of the sweep's figure: left border, height of the chart, room below it, in pixels."""
_MM = 1000.0
"""Millimetres per metre."""


def horizontal_figure(name: str, outcome: Fit | Refusal) -> Figure:
    """Draw the lines that give the yaw of a candidate.

    Parameters
    ----------
    name : str
        Of the candidate.
    outcome : Fit or Refusal
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
    horizontal, estimate = steps_of(outcome, HorizontalView), last_step(outcome, YawEstimate)
    if not horizontal:
        raise ValueError(f"candidate {name} has no horizontal view to draw")
    first, last = horizontal[0], horizontal[-1]
    # without votes, the lines belong to the last view
    only_lines = estimate is None
    views = [last] if only_lines else [first, last]
    sizes = [_size(seen) for seen in views]
    figure = canvas.new_figure(_HEAD + sum(height + _TITLE + _AXIS + _KEYS for _, height in sizes))
    title = f"{name}: horizontal plane through the {_PLANES[first.source]} edge of the face, seen from above"
    canvas.add_text(figure, _LEFT, 14, title, size=13, bold=True)
    top = float(_HEAD)
    for i, (seen, (width, height)) in enumerate(zip(views, sizes, strict=True)):
        axes = canvas.add_axes(figure, _LEFT, top + _TITLE, width, height)
        canvas.show_view(axes, seen.view)
        placed = "first" if seen is first else "last"
        if estimate is None or i == 0:
            text = _draw_found(axes, steps_of(outcome, BoundaryLine), placed)
        else:
            text = _draw_votes(axes, seen, estimate, outcome.candidate.model)
        canvas.add_text(figure, _LEFT, top + 6, text, size=10.5)
        axes.set(ylabel="into the shelf (m)", xlabel="to the right of the face's middle (m)")
        canvas.add_legend(figure, top + _TITLE + height + _AXIS, axes, columns=4)
        top += _TITLE + height + _AXIS + _KEYS
    return figure


def _size(seen: HorizontalView) -> tuple[float, float]:
    """Return width and height of a view on the page, in pixels."""
    aspect = seen.view.grid.columns / seen.view.grid.rows
    width = min(canvas.WIDTH_PX - _LEFT - _RIGHT, _HIGHEST * aspect)
    return width, width / aspect


def _draw_found(axes: Axes, lines: Sequence[BoundaryLine], placed: str) -> str:
    """Draw what the Hough transform found, and return what that means."""
    axes.axhline(
        0.0, color="white", linewidth=1.0, linestyle=(0, (6, 5)), path_effects=[_HALO], label="expected edge"
    )
    chosen = nearest_line(list(lines))
    ends = np.array(axes.get_xlim())
    for line in lines:
        best = line is chosen
        axes.plot(
            ends,
            line.up + np.tan(line.turn) * ends,
            color=canvas.STARTED,
            linewidth=2.2 if best else 1.0,
            linestyle="-" if best else ":",
            path_effects=[_HALO],
            label="line nearest to it" if best else "other lines of the Hough transform",
        )
    if chosen is None:
        return f"As {placed} placed: the Hough transform found no line"
    turn = np.degrees(chosen.turn).round(2) + 0.0
    return (
        f"As {placed} placed: the long line that is nearest to the expected edge is turned against it by"
        f" {turn:+.2f}{canvas.DEGREE} (Hough transform)"
    )


def _draw_votes(axes: Axes, seen: HorizontalView, estimate: YawEstimate, model: PalletModel) -> str:
    """Draw the measured lines, and return what that means."""
    for vote in estimate.votes:
        color = _EDGE_COLORS.get(vote.edge.kind, canvas.MEASURED) if vote.used else canvas.REFUSED
        state = "" if vote.used else ", not used"
        for ends in vote_stretches(seen, vote, model):
            axes.plot(
                *ends.T,
                color=color,
                linewidth=2.2 if vote.used else 1.6,
                linestyle="-" if vote.used else "--",
                path_effects=[_HALO],
                label=f"{_EDGE_NAMES[vote.edge.kind]} {_degrees(vote.turn, vote.sigma, sign='+')}{state}",
            )
    return (
        f"After the correction: yaw {_degrees(estimate.yaw, estimate.sigma)};"
        " below: what each line along the level edges still turns"
    )


def vote_stretches(seen: HorizontalView, vote: YawVote, model: PalletModel) -> FloatArray:
    """Return where a line of the face was measured on a horizontal view, (n, 2, 2): ends of its stretches."""
    camera = seen.plane_from_camera
    face_from_camera = np.array([camera[0], camera[2] + seen.height, -camera[1]])
    shift = edge_shift(vote.edge, face_from_camera, model).mean
    drawn = stretches_of(model, vote.edge) + shift * np.array(vote.edge.outward)
    on_face = np.stack([drawn[..., 0], np.zeros_like(drawn[..., 0]), drawn[..., 1] - seen.height], axis=-1)
    ends = seen_on_plane(on_face, camera)
    ends[..., 1] += vote.fit.offset + vote.fit.slope * ends[..., 0]
    return ends


def _degrees(angle: float, sigma: float, sign: str = "") -> str:
    turn, spread = np.degrees(angle).round(2) + 0.0, np.degrees(sigma)  # no sign before a zero
    return f"{turn:{sign}.2f}{canvas.DEGREE} {canvas.PLUS_MINUS} {spread:.2f}{canvas.DEGREE}"


def sweep_figure(name: str, outcome: Fit | Refusal) -> Figure:
    """Draw the score of a candidate's sweep.

    Parameters
    ----------
    name : str
        Of the candidate.
    outcome : Fit or Refusal
        With a sweep or a joint search.

    Returns
    -------
    Figure
        Score over depth; for a joint search, over depth and yaw.

    Raises
    ------
    ValueError
        Where nothing was searched.
    """
    figure = canvas.new_figure(_HEAD + _HEIGHT + _FOOT)
    axes = canvas.add_axes(figure, _SWEEP_LEFT, _HEAD, canvas.WIDTH_PX - _SWEEP_LEFT - _RIGHT, _HEIGHT)
    axes.set_xlabel("distance of the plane against the start (mm); positive is farther away")
    swept, joint = last_step(outcome, Sweep), last_step(outcome, JointSearch)
    if swept is not None:
        title = _draw_sweep(axes, outcome, swept)
        axes.grid(color=canvas.GRID, linewidth=0.6)
    elif joint is not None:
        title = _draw_joint(figure, axes, joint)
    else:
        raise ValueError(f"candidate {name} was not searched: there is no score to draw")
    canvas.add_text(figure, _SWEEP_LEFT, 14, f"{name}: {title}", size=13, bold=True)
    canvas.add_legend(figure, _HEAD + _HEIGHT + 46, axes)
    return figure


def _draw_sweep(axes: Axes, outcome: Fit | Refusal, swept: Sweep) -> str:
    start = outcome.candidate.start
    depth = swept.depth * _MM
    axes.plot(depth, swept.score, color=canvas.SERIES[0], linewidth=1.8, label="best score at each distance")
    axes.plot(depth, swept.score, ".", color=canvas.SERIES[0], markersize=5)
    axes.set_ylabel("agreement of edges and template")
    axes.set_xlim(depth[0], depth[-1])
    for i, peak in enumerate(swept.peaks):
        axes.axvline(
            _depth(start, peak) * _MM,
            color=canvas.SERIES[1],
            linewidth=1.6 if i == 0 else 0.9,
            linestyle="--" if i == 0 else ":",
            label="the sweep's best place" if i == 0 else "its next best places",
        )
    _mark_measured(axes, outcome)
    best = _depth(start, swept.peaks[0]) * _MM
    return f"the swept plane fits best at {best:+.0f} mm, score {swept.best:.2f}"


def _draw_joint(figure: Figure, axes: Axes, found: JointSearch) -> str:
    turns = np.degrees(found.turns)
    colors = axes.pcolormesh(found.depths * _MM, turns, found.score, cmap="cividis", shading="nearest")
    axes.set_ylabel(f"turn of the plane ({canvas.DEGREE})")
    wide, high = axes.get_position().size
    axes.set_position((_SWEEP_LEFT / canvas.WIDTH_PX, axes.get_position().y0, wide - 0.07, high))
    scale = canvas.add_axes(figure, canvas.WIDTH_PX - 80, _HEAD, 16, _HEIGHT)
    figure.colorbar(colors, cax=scale, label="agreement of edges and template")
    row, column = np.unravel_index(int(found.score.argmax()), found.score.shape)
    depth, turn = float(found.depths[column]) * _MM, float(turns[row])
    axes.plot(depth, turn, "+", color="white", markersize=16, markeredgewidth=2.5)
    axes.plot(depth, turn, "+", color=canvas.SERIES[1], markersize=14, markeredgewidth=1.5, label="best place")
    place = f"{depth:+.0f} mm and {turn:+.2f}{canvas.DEGREE}"
    return f"the joint search fits best at {place}, score {found.best:.2f}"


def _mark_measured(axes: Axes, outcome: Fit | Refusal) -> None:
    if outcome.fit is not None and outcome.fit.face is not None:
        measured = _depth(outcome.candidate.start, outcome.fit.pose) * _MM
        label = f"measured by the edges: {measured:+.1f} mm"
        axes.axvline(measured, color=canvas.SERIES[2], linewidth=1.8, label=label)


def _depth(start: LevelPose, pose: LevelPose) -> float:
    """Return how far a pose lies behind the start, in metres."""
    return float((pose.x - start.x) * np.cos(start.yaw) + (pose.y - start.y) * np.sin(start.yaw))
