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
from palletloc.report.comparison import MeasuredError

_LEFT, _RIGHT, _HEAD, _HEIGHT, _GAP, _FOOT = 74, 20, 72, 210, 40, 44  # in pixels
_ROWS = ((3, "yaw error (\N{DEGREE SIGN})", float(np.degrees(1.0))), (0, "depth error (mm)", 1000.0))
_BESIDE = 0.06  # seconds


def error_figure(errors: Sequence[MeasuredError]) -> Figure:
    """Draw the errors of yaw and depth over time, one series for each pallet.

    Parameters
    ----------
    errors : sequence of MeasuredError
        At least one.

    Returns
    -------
    Figure
        A point for each measurement, with a bar of two standard deviations to either side.
    """
    figure = new_figure(_HEAD + len(_ROWS) * (_HEIGHT + _GAP) + _FOOT)
    add_text(figure, _LEFT, 14, "Error of each measurement over the approach", size=13, bold=True)
    line = "Bars: two standard deviations, as the measurement itself states them; about 95 in 100 should reach zero"
    add_text(figure, _LEFT, 40, line, size=10.5)
    names = sorted({error.error.face.id for error in errors})
    for row, (axis, label, scale) in enumerate(_ROWS):
        top = _HEAD + row * (_HEIGHT + _GAP)
        axes = add_axes(figure, _LEFT, top, WIDTH_PX - _LEFT - _RIGHT, _HEIGHT)
        axes.axhline(0.0, color=INK, linewidth=1.0)
        axes.grid(color=GRID, linewidth=0.6)
        axes.set_axisbelow(True)
        axes.set_ylabel(label)
        limit = _limit(errors, axis, scale)
        axes.set_ylim(-limit, limit)
        for i, name in enumerate(names):
            chosen = [error for error in errors if error.error.face.id == name]
            _draw_series(axes, chosen, axis, scale, (i, len(names)))
    axes.set_xlabel("time of the shot (s)")
    add_legend(figure, top + _HEIGHT + 50, axes)
    return figure


def _limit(errors: Sequence[MeasuredError], axis: int, scale: float) -> float:
    """Return up to where to draw: all errors and nearly all bars; a single wide bar leaves the picture."""
    values = np.array([abs(error.offset[axis]) for error in errors]) * scale
    ends = values + 2 * np.array([error.sigma[axis] for error in errors]) * scale
    return 1.1 * float(max(1.2 * values.max(), np.quantile(ends, 0.85)))


def _draw_series(
    axes: Axes, errors: Sequence[MeasuredError], axis: int, scale: float, place: tuple[int, int]
) -> None:
    """Draw one pallet's errors; pallets of one shot stand side by side."""
    index, count = place
    times = np.array([error.measured.time for error in errors]) + (index - (count - 1) / 2) * _BESIDE
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
        label=f"pallet {errors[0].error.face.id}",
    )
