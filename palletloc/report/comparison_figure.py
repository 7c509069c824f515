"""Which of several runs has the smaller errors, and how sure that is."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from palletloc.drawing.canvas import GRID, INK, SERIES, WIDTH_PX, add_axes, add_text, new_figure
from palletloc.evaluation.pose_error import COMPONENTS
from palletloc.evaluation.run import ComparedRuns
from palletloc.report.source_style import QUANTITIES, STYLES

_LEFT, _RIGHT, _HEAD, _GAP, _ROW, _FOOT = 230, 24, 76, 26, 34, 60  # in pixels


def comparison_figure(compared: Sequence[ComparedRuns]) -> Figure:
    """Draw the mean differences of the absolute errors with their intervals.

    Parameters
    ----------
    compared : sequence of ComparedRuns
        At least one.

    Returns
    -------
    Figure
        One panel for each quantity, one row for each comparison; left of the line the later run is better.
    """
    height = _ROW * (len(compared) + 0.6)
    figure = new_figure(_HEAD + height + _FOOT)
    title = f"Compared with {compared[0].first}"
    add_text(figure, 76, 14, title, size=13, bold=True)
    told = "Mean change of the absolute error with its bootstrap interval. Left of the line: smaller than before"
    add_text(figure, 76, 40, told, size=10.5)
    width = (WIDTH_PX - _LEFT - _RIGHT - 3 * _GAP) / 4
    for number, quantity in enumerate(QUANTITIES):
        axes = add_axes(figure, _LEFT + number * (width + _GAP), _HEAD, width, height)
        axes.grid(color=GRID, linewidth=0.6)
        axes.set_axisbelow(True)
        axes.axvline(0.0, color=INK, linewidth=1.0)
        for row, one in enumerate(compared):
            difference = one.comparison.differences.get(COMPONENTS[quantity.column])
            if difference is None:
                continue
            color, scale = SERIES[row % len(SERIES)], quantity.scale
            ends = np.array([difference.low, difference.high]) * scale
            if np.isfinite(ends).all():
                axes.plot(ends, [row, row], color=color, linewidth=2.4, alpha=0.6)
            axes.plot(difference.mean * scale, row, "o", color=color, markersize=7)
        reach = 1.1 * float(np.abs(axes.get_xlim()).max())
        axes.set(ylim=(len(compared) - 0.3, -0.7), xlim=(-reach, reach), yticks=range(len(compared)))
        axes.set_xlabel(f"{quantity.label} ({quantity.unit})")
        labels = [f"{one.second}: {STYLES[one.source].label}" for one in compared] if number == 0 else []
        for label in axes.set_yticklabels(labels or [""] * len(compared)):
            label.set_parse_math(False)
    return figure
