"""The errors of many recordings, one row for each."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from palletloc.drawing.canvas import (
    GRID,
    INK,
    LEGEND_ROW_PX,
    SERIES,
    WIDTH_PX,
    add_axes,
    add_legend,
    add_text,
    new_figure,
)
from palletloc.evaluation.batch import BatchResult, SourceTotals
from palletloc.evaluation.requirement import Requirement
from palletloc.report.source_style import QUANTITIES, STYLES, Quantity

_LEFT, _RIGHT, _HEAD, _GAP, _ROW, _FOOT = 190, 24, 104, 26, 26, 56  # in pixels
_DOTTED = (0, (1, 2))


def batch_figure(results: Sequence[BatchResult], requirement: Requirement) -> Figure:
    """Draw median and 95 % of the absolute errors of each recording.

    Parameters
    ----------
    results : sequence of BatchResult
        In the order of the rows; those without results are left out.
    requirement : Requirement
        Whose limits are drawn.

    Returns
    -------
    Figure
        One panel for each quantity, and in each row one mark for each run and source.
    """
    shown = [result for result in results if result.totals]
    height = _ROW * (len(shown) + 0.4)
    figure = new_figure(_HEAD + height + _FOOT)
    add_text(figure, 76, 14, "Errors of each recording", size=13, bold=True)
    told = "Marks: median of the absolute errors; lines: up to 95 % of them. Dotted: the requirement"
    add_text(figure, 76, 40, told, size=10.5)
    width = (WIDTH_PX - _LEFT - _RIGHT - 3 * _GAP) / 4
    for number, quantity in enumerate(QUANTITIES):
        axes = add_axes(figure, _LEFT + number * (width + _GAP), _HEAD, width, height)
        axes.grid(color=GRID, linewidth=0.6)
        axes.set_axisbelow(True)
        _draw(axes, shown, quantity)
        axes.axvline(quantity.limit(requirement), color=INK, linewidth=1.0, linestyle=_DOTTED)
        axes.set(ylim=(len(shown) - 0.3, -0.7), yticks=range(len(shown)))
        axes.set_xlim(left=0.0)
        axes.set_xlabel(f"{quantity.label} ({quantity.unit})")
        labels = [result.name for result in shown] if number == 0 else [""] * len(shown)
        for label in axes.set_yticklabels(labels):
            label.set_parse_math(False)
    add_legend(figure, _HEAD - LEGEND_ROW_PX - 12, axes)
    return figure


def _draw(axes: Axes, shown: Sequence[BatchResult], quantity: Quantity) -> None:
    keys = list(dict.fromkeys((one.run, one.source) for result in shown for one in result.totals))
    for row, result in enumerate(shown):
        for one in result.totals:
            place = keys.index((one.run, one.source))
            shift = 0.6 * ((place + 0.5) / len(keys) - 0.5)
            _mark(axes, one, quantity, (row + shift, SERIES[place % len(SERIES)]))
    for place, (run, source) in enumerate(keys):
        style = STYLES[source]
        axes.plot([], [], style.mark, color=SERIES[place % len(SERIES)], label=f"{run}: {style.label}")


def _mark(axes: Axes, one: SourceTotals, quantity: Quantity, how: tuple[float, str]) -> None:
    row, color = how
    sizes = np.abs(one.offsets[:, quantity.column]) * quantity.scale
    if len(sizes):
        median, most = float(np.median(sizes)), float(np.percentile(sizes, 95))
        axes.plot([median, most], [row, row], color=color, linewidth=2.0, alpha=0.5)
        axes.plot(median, row, STYLES[one.source].mark, color=color, markersize=5)
