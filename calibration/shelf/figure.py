"""The shelf from above: the way of the camera, what was seen, and the plane."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from calibration.drive import compose
from calibration.shelf.survey import ShelfSurvey
from palletloc.drawing.canvas import FAINT, GRID, INK, SERIES, WIDTH_PX, add_axes, add_legend, add_text, new_figure
from palletloc.geometry import FloatArray

_LEFT, _RIGHT, _HEAD = 74, 24, 72
_TIMES = 10.0


def plan_figure(survey: ShelfSurvey) -> Figure:
    """Draw the plan, and below it the depths ten times as large.

    Parameters
    ----------
    survey : ShelfSurvey
        The result.
    """
    figure = new_figure(900)
    add_text(figure, _LEFT, 14, "The shelf's front from above", size=13, bold=True)
    line = (
        "Seen along the result: right is along the shelf, up is into it. Below: depths against the result, stretched"
    )
    add_text(figure, _LEFT, 40, line, size=10.5)
    wide = WIDTH_PX - _LEFT - _RIGHT
    plan = add_axes(figure, _LEFT, _HEAD, wide, 440)
    close = add_axes(figure, _LEFT, _HEAD + 480, wide, 260)
    _draw_plan(plan, survey)
    _draw_depths(close, survey)
    close.set_xlim(plan.get_xlim())
    add_legend(figure, 862, plan, close, columns=8)
    return figure


def _turned(survey: ShelfSurvey, points: FloatArray) -> FloatArray:
    """Return points, (n, 2) in odom, as places along the resulting plane and depths behind it."""
    turn, distance = (0.0, 0.0) if survey.fused is None else (survey.fused.turn, survey.fused.distance)
    right, depth = survey.foot.local(np.asarray(points).reshape(-1, 2)).T
    cos, sin = np.cos(turn), np.sin(turn)
    return np.stack([cos * right + sin * depth, cos * depth - sin * right - distance], axis=1)


def _draw_plan(axes: Axes, survey: ShelfSurvey) -> None:
    solution = survey.solution
    camera = np.array([*survey.recording.mounting.center[:2], 0.0])
    way = _turned(survey, compose(solution.poses, np.tile(camera, (len(solution.poses), 1)))[:, :2])
    axes.plot(*way.T, "-o", color=SERIES[0], markersize=3, linewidth=1, label="camera")
    for i, (pallet, model) in enumerate(zip(solution.pallets, survey.models, strict=True)):
        corners = np.array([[0, -0.5], [0, 0.5], [1, 0.5], [1, -0.5], [0, -0.5]]) * (model.depth, model.width)
        placed = compose(np.tile(pallet, (5, 1)), np.concatenate([corners, np.zeros((5, 1))], axis=1))[:, :2]
        axes.plot(*_turned(survey, placed).T, color=SERIES[4], linewidth=1, label="pallet" if i == 0 else None)
    chosen = survey.members > 0
    seen = _turned(survey, survey.edges.places)
    axes.plot(*seen[~chosen].T, "x", color=FAINT, markersize=5, label="other vertical edge")
    axes.plot(*seen[chosen].T, "o", color=SERIES[1], markersize=5, label="edge of the front")
    ends = np.array([way[:, 0].min() - 3, way[:, 0].max() + 3])
    if survey.fused is not None:
        axes.plot(ends, [0, 0], color=INK, linewidth=1.5, label="result")
        prior = survey.foot.described(survey.prior)
        slope = np.tan(prior[0] - survey.fused.turn)
        axes.plot(ends, prior[1] - survey.fused.distance + slope * ends, "--", color=FAINT, label="as given")
    axes.set_aspect("equal", adjustable="datalim")
    axes.set(ylabel="into the shelf (m)")
    axes.grid(color=GRID, linewidth=0.6)


def _draw_depths(axes: Axes, survey: ShelfSurvey) -> None:
    chosen = survey.members > 0
    seen = _turned(survey, survey.edges.places)
    axes.plot(seen[~chosen, 0], 1000 * seen[~chosen, 1], "x", color=FAINT, markersize=5)
    axes.plot(seen[chosen, 0], 1000 * seen[chosen, 1], "o", color=SERIES[1], markersize=5)
    fronts = _turned(survey, survey.solution.pallets[:, :2])
    axes.plot(fronts[:, 0], 1000 * fronts[:, 1], "s", color=SERIES[4], markersize=6, label="pallet's front")
    if survey.fused is not None:
        turn, distance = np.sqrt(np.diag(survey.fused.covariance))
        along = np.linspace(-5, 5, 101)
        band = 2000 * np.hypot(distance, turn * along)
        axes.fill_between(along, -band, band, color="#eef3f8", zorder=0, label="two sigma")
    axes.axhline(0.0, color=INK, linewidth=1.2)
    axes.set(ylim=(-150, 150), xlabel="along the shelf (m)", ylabel="behind the result (mm)")
    axes.grid(color=GRID, linewidth=0.6)
    axes.set_axisbelow(True)
