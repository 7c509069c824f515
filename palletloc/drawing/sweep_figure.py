"""Position: how well the face's template fits over the distance of the swept plane."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from palletloc.candidate import Candidate
from palletloc.drawing.canvas import GRID, SERIES, WIDTH_PX, add_axes, add_legend, add_text, new_figure
from palletloc.geometry import LevelPose

_LEFT, _RIGHT, _HEAD, _HEIGHT, _FOOT = 66, 20, 46, 320, 84  # in pixels
_MM = 1000.0


def sweep_figure(name: str, candidate: Candidate) -> Figure:
    """Draw the score of a candidate's sweep.

    Parameters
    ----------
    name : str
        Of the candidate.
    candidate : Candidate
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
    figure = new_figure(_HEAD + _HEIGHT + _FOOT)
    axes = add_axes(figure, _LEFT, _HEAD, WIDTH_PX - _LEFT - _RIGHT, _HEIGHT)
    axes.set_xlabel("distance of the plane against the start (mm); positive is farther away")
    if candidate.sweep is not None:
        title = _draw_sweep(axes, candidate)
        axes.grid(color=GRID, linewidth=0.6)
    elif candidate.joint is not None:
        title = _draw_joint(figure, axes, candidate)
    else:
        raise ValueError(f"candidate {name} was not searched: there is no score to draw")
    add_text(figure, _LEFT, 14, f"{name}: {title}", size=13, bold=True)
    add_legend(figure, _HEAD + _HEIGHT + 46, axes)
    return figure


def _draw_sweep(axes: Axes, candidate: Candidate) -> str:
    swept = candidate.sweep
    if swept is None:
        return ""
    depth = swept.depth * _MM
    axes.plot(depth, swept.score, color=SERIES[0], linewidth=1.8, label="best score at each distance")
    axes.plot(depth, swept.score, ".", color=SERIES[0], markersize=5)
    axes.set_ylabel("agreement of edges and template")
    axes.set_xlim(depth[0], depth[-1])
    for i, peak in enumerate(swept.peaks):
        axes.axvline(
            _depth(candidate.start, peak) * _MM,
            color=SERIES[1],
            linewidth=1.6 if i == 0 else 0.9,
            linestyle="--" if i == 0 else ":",
            label="the sweep's best place" if i == 0 else "its next best places",
        )
    _mark_measured(axes, candidate)
    best = _depth(candidate.start, swept.peaks[0]) * _MM
    return f"the swept plane fits best at {best:+.0f} mm, score {swept.best:.2f}"


def _draw_joint(figure: Figure, axes: Axes, candidate: Candidate) -> str:
    found = candidate.joint
    if found is None:
        return ""
    turns = np.degrees(found.turns)
    colors = axes.pcolormesh(found.depths * _MM, turns, found.score, cmap="cividis", shading="nearest")
    axes.set_ylabel("turn of the plane (\N{DEGREE SIGN})")
    wide, high = axes.get_position().size
    axes.set_position((_LEFT / WIDTH_PX, axes.get_position().y0, wide - 0.07, high))
    scale = add_axes(figure, WIDTH_PX - 80, _HEAD, 16, _HEIGHT)
    figure.colorbar(colors, cax=scale, label="agreement of edges and template")
    row, column = np.unravel_index(int(found.score.argmax()), found.score.shape)
    depth, turn = float(found.depths[column]) * _MM, float(turns[row])
    axes.plot(depth, turn, "+", color="white", markersize=16, markeredgewidth=2.5)
    axes.plot(depth, turn, "+", color=SERIES[1], markersize=14, markeredgewidth=1.5, label="best place")
    place = f"{depth:+.0f} mm and {turn:+.2f}\N{DEGREE SIGN}"
    return f"the joint search fits best at {place}, score {found.best:.2f}"


def _mark_measured(axes: Axes, candidate: Candidate) -> None:
    if candidate.pose is not None and candidate.face is not None:
        measured = _depth(candidate.start, candidate.pose) * _MM
        label = f"measured by the edges: {measured:+.1f} mm"
        axes.axvline(measured, color=SERIES[2], linewidth=1.8, label=label)


def _depth(start: LevelPose, pose: LevelPose) -> float:
    """Return how far a pose lies behind the start, in metres."""
    return float((pose.x - start.x) * np.cos(start.yaw) + (pose.y - start.y) * np.sin(start.yaw))
