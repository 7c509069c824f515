"""Errors over the shots of an approach, with what the measurements say of themselves."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from palletloc.drawing.canvas import (
    GRID,
    INK,
    SERIES,
    WIDTH_PX,
    add_axes,
    add_legend,
    add_text,
    new_figure,
)
from palletloc.report.comparison import PoseError

_LEFT, _RIGHT, _HEAD, _HEIGHT, _GAP, _FOOT = 74, 20, 72, 210, 40, 80  # in pixels
_ROWS = ((3, "yaw error (\N{DEGREE SIGN})", float(np.degrees(1.0))), (0, "depth error (mm)", 1000.0))
_BESIDE = 0.06  # seconds


def error_figure(errors: Sequence[PoseError]) -> Figure:
    """Draw the errors of yaw and depth over time, one series for each pallet.

    Parameters
    ----------
    errors : sequence of PoseError
        At least one.

    Returns
    -------
    Figure
        A point for each measurement, with a bar of two standard deviations to either side.
    """
    figure = new_figure(_HEAD + len(_ROWS) * (_HEIGHT + _GAP) + _FOOT)
    add_text(figure, _LEFT, 14, "Error of each measurement over the approach", size=13, bold=True)
    line = "Bars: two standard deviations, as the measurement itself states them; about 95 % should reach zero"
    add_text(figure, _LEFT, 40, line, size=10.5)
    names = sorted({error.pallet for error in errors})
    for row, (axis, label, scale) in enumerate(_ROWS):
        top = _HEAD + row * (_HEIGHT + _GAP)
        axes = add_axes(figure, _LEFT, top, WIDTH_PX - _LEFT - _RIGHT, _HEIGHT)
        axes.axhline(0.0, color=INK, linewidth=1.0)
        axes.grid(color=GRID, linewidth=0.6)
        axes.set_axisbelow(True)
        axes.set_ylabel(label)
        for i, name in enumerate(names):
            chosen = [error for error in errors if error.pallet == name]
            _draw_series(axes, chosen, axis, scale, (i, len(names)))
    axes.set_xlabel("time of the shot (s)")
    add_legend(figure, top + _HEIGHT + 50, axes)
    return figure


def _draw_series(axes: Axes, errors: Sequence[PoseError], axis: int, scale: float, place: tuple[int, int]) -> None:
    """Draw one pallet's errors; pallets of one shot stand side by side."""
    index, count = place
    times = np.array([error.time for error in errors]) + (index - (count - 1) / 2) * _BESIDE
    values = np.array([error.offset[axis] for error in errors]) * scale
    bars = 2 * np.array([error.sigma[axis] for error in errors]) * scale
    axes.errorbar(
        times,
        values,
        bars,
        fmt="o",
        color=SERIES[index % len(SERIES)],
        markersize=6,
        elinewidth=3.0,
        ecolor=(SERIES[index % len(SERIES)], 0.4),
        label=f"pallet {errors[0].pallet}",
    )
