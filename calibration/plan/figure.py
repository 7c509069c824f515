"""The picture of a planned layout: from above, and what the camera will see."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from calibration.plan.prediction import PlannedSight, Prediction
from palletloc.drawing.canvas import FAINT, GRID, INK, SERIES, WIDTH_PX, add_axes, add_text, new_figure
from palletloc.geometry import FloatArray

_LEFT, _RIGHT, _HEAD = 74, 24, 72


def layout_figure(prediction: Prediction) -> Figure:
    """Draw a layout.

    Parameters
    ----------
    prediction : Prediction
        With the sights of all targets.
    """
    figure = new_figure(560)
    add_text(figure, _LEFT, 14, "The layout", size=13, bold=True)
    line = (
        "From above, with the camera's lines of sight; and all directions as the camera sees them. Gray is not found"
    )
    add_text(figure, _LEFT, 40, line, size=10.5)
    wide = WIDTH_PX - _LEFT - _RIGHT
    above = add_axes(figure, _LEFT, _HEAD, 440, 430)
    around = add_axes(figure, _LEFT + 520, _HEAD, wide - 520, 430)
    for i, one in enumerate(prediction.sights):
        color = SERIES[i % len(SERIES)] if one.found else FAINT
        _draw_above(above, one, color, prediction.layout.forklift_from_camera.translation)
        _draw_around(around, one, color)
    _draw_forklift(above, prediction.layout.forklift_from_camera.translation)
    above.set_aspect("equal", adjustable="datalim")
    above.set(xlabel="to the left (m)", ylabel="forward (m)")
    above.invert_xaxis()
    degree = "\N{DEGREE SIGN}"
    around.set(xlim=(180, -180), ylim=(-90, 90), xlabel=f"longitude ({degree})", ylabel=f"latitude ({degree})")
    around.set_xticks(range(-180, 181, 90))
    around.set_yticks(range(-90, 91, 30))
    for axes in (above, around):
        axes.grid(color=GRID, linewidth=0.6)
        axes.set_axisbelow(True)
    return figure


def _draw_forklift(axes: Axes, eye: FloatArray) -> None:
    """Draw the forklift frame and the camera; up is forward."""
    axes.annotate("", (0, 0.6), (0, 0), arrowprops={"arrowstyle": "->", "color": INK})
    axes.plot(0, 0, "+", color=INK, markersize=9)
    axes.plot(eye[1], eye[0], "o", color=INK, markersize=6)


def _draw_above(axes: Axes, one: PlannedSight, color: str, eye: FloatArray) -> None:
    left, right, lower = one.planned.survey.points
    ring = np.array([left, right, right + lower - left, lower, left])
    axes.plot(ring[:, 1], ring[:, 0], color=color, linewidth=2.5, solid_capstyle="butt")
    middle = ring[:4].mean(0)
    axes.plot([eye[1], middle[1]], [eye[0], middle[0]], color=color, linewidth=0.6, alpha=0.6)
    axes.annotate(
        one.planned.survey.name, (middle[1], middle[0]), (4, 6), textcoords="offset points", color=INK, size=10
    )


def _draw_around(axes: Axes, one: PlannedSight, color: str) -> None:
    x, y, z = one.sight.bearings.T
    if not len(x):
        return
    lon, lat = np.degrees(np.arctan2(y, x)), np.degrees(np.arctan2(z, np.hypot(x, y)))
    axes.plot(lon, lat, "o", color=color, markersize=2.5)
    axes.annotate(
        one.planned.survey.name, (float(np.median(lon)), float(lat.max()) + 4), color=INK, size=10, ha="center"
    )
