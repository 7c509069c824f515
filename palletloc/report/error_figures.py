"""Figures of errors: how they are spread and grow with distance, runs side by side, and many recordings."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter

from palletloc.drawing.canvas import DEGREE, INK, LEGEND_ROW_PX, SERIES, WIDTH_PX, add_axes, add_legend
from palletloc.evaluation.batch import BatchResult, SourceTotals
from palletloc.evaluation.breakdown import by_distance, distance_edges
from palletloc.evaluation.pose_error import COMPONENTS
from palletloc.evaluation.requirement import Requirement
from palletloc.evaluation.run import ComparedRuns, EvaluatedRun, EvaluatedSource, Settings
from palletloc.report.source_style import DEPTH, DOTTED, QUANTITIES, STYLES, YAW, Quantity, add_grid, titled_figure

_LEFT, _RIGHT, _HEAD, _GAP, _HEIGHT, _FOOT = 76, 18, 112, 40, 220, 60
"""Borders, gap and height of the panels of one run, in pixels."""
_ROWS_LEFT, _ROWS_RIGHT, _ROWS_GAP = (230, 190), 24, 26
"""Left borders with names of runs and of recordings, right border and gap of panels of rows, in pixels."""
_BINS = 25
"""Of a histogram: fine enough to show a second peak, coarse enough for some hundred errors."""
_LEAST = {DEGREE: 0.003, "mm": 0.1}
"""Errors that are drawn at the lower border of a logarithmic scale, by unit."""


def histogram_figure(run: EvaluatedRun, requirement: Requirement) -> Figure:
    """Draw histograms of the errors of yaw, depth, along and height, sources on top of one another.

    Each bar is the part of a source's errors in its bin; how many lie outside the axes is written there.
    """
    explained = "Part of the errors of each source. Dotted: the requirement, where it is near"
    figure = titled_figure(_HEAD + _HEIGHT + _FOOT, f"{run.files.name}: how the errors are spread", explained)
    width = (WIDTH_PX - _LEFT - _RIGHT - 3 * _GAP) / 4
    for number, quantity in enumerate(QUANTITIES):
        axes = add_axes(figure, _LEFT + number * (width + _GAP), _HEAD, width, _HEIGHT)
        add_grid(axes)
        axes.axvline(0.0, color=INK, linewidth=1.0)
        _draw_histograms(axes, run, quantity, requirement)
        axes.set_xlabel(f"{quantity.label} error ({quantity.unit})")
        if number == 0:
            axes.set_ylabel("part of the errors")
    add_legend(figure, _HEAD - LEGEND_ROW_PX - 16, axes)
    return figure


def _draw_histograms(axes: Axes, run: EvaluatedRun, quantity: Quantity, requirement: Requirement) -> None:
    values = {name: quantity.values(source.errors) for name, source in run.sources.items()}
    everything = np.abs(np.concatenate([np.zeros(1), *values.values()]))
    limit = 1.05 * max(float(np.quantile(everything, 0.99)), 1e-6)
    edges = np.linspace(-limit, limit, _BINS + 1).tolist()
    for name, some in values.items():
        style = STYLES[name]
        weights = np.full(len(some), 1 / max(len(some), 1))
        axes.hist(some, edges, weights=weights, color=style.color, alpha=0.35, label=style.label)
        axes.hist(some, edges, weights=weights, histtype="step", color=style.color, linewidth=1.5)
    allowed = quantity.limit(requirement)
    axes.set_xlim(-limit, limit)
    if allowed <= limit:
        for side in (-allowed, allowed):
            axes.axvline(side, color=INK, linewidth=1.2, linestyle=DOTTED)
    outside = sum(int((np.abs(some) > limit).sum()) for some in values.values())
    if outside:
        text = axes.text(0.98, 0.96, f"{outside} farther out", transform=axes.transAxes, ha="right", va="top")
        text.set(size=8.5, color=INK)


def distance_figure(run: EvaluatedRun, settings: Settings) -> Figure:
    """Draw absolute errors of yaw and depth against the pallets' true distance from the camera.

    A mark stands for each error, a line goes through the medians of the bins; the scales are logarithmic.
    """
    each = "half metre" if settings.bin_width == 0.5 else f"{settings.bin_width:g} m"
    explained = f"Absolute errors; lines: median of each {each}; dotted: the requirement; logarithmic scales"
    title = f"{run.files.name}: errors against distance"
    figure = titled_figure(_HEAD + _HEIGHT + 40 + _FOOT, title, explained)
    width = (WIDTH_PX - _LEFT - _RIGHT - 2 * _GAP) / 2
    for number, quantity in enumerate((YAW, DEPTH)):
        axes = add_axes(figure, _LEFT + number * (width + 2 * _GAP), _HEAD, width, _HEIGHT + 40)
        axes.set_yscale("log")
        axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        add_grid(axes)
        axes.axhline(quantity.limit(settings.requirement), color=INK, linewidth=1.2, linestyle=DOTTED)
        for name, source in run.sources.items():
            _draw_source(axes, source, name, quantity, settings)
        axes.set(xlabel="distance from the camera (m)", ylabel=f"{quantity.label} error ({quantity.unit})")
    add_legend(figure, _HEAD - LEGEND_ROW_PX - 16, axes)
    return figure


def _draw_source(axes: Axes, source: EvaluatedSource, name: str, quantity: Quantity, settings: Settings) -> None:
    style, least = STYLES[name], _LEAST[quantity.unit]
    ranges = [error.face.range for error in source.errors]
    axes.plot(
        ranges,
        np.maximum(np.abs(quantity.values(source.errors)), least),
        style.mark,
        color=style.color,
        markersize=4,
        alpha=0.45,
        markeredgewidth=0,
    )
    edges = distance_edges(settings.bin_width, settings.visibility.max_range)
    bins = [part for part in by_distance(source.shots, edges) if part.errors]
    middles = [float(np.mean([error.face.range for error in part.errors])) for part in bins]
    medians = [max(float(np.median(np.abs(quantity.values(part.errors)))), least) for part in bins]
    axes.plot(middles, medians, marker=style.mark, color=style.color, linewidth=1.9, markersize=6, label=style.label)


def comparison_figure(compared: Sequence[ComparedRuns]) -> Figure:
    """Draw the mean differences of the absolute errors, of one comparison at least, with their intervals.

    Each quantity has a panel, each comparison a row; left of the line the later run is better.
    """
    head, row_px, foot = 76, 34, 60
    height = row_px * (len(compared) + 0.6)
    explained = "Mean change of the absolute error with its bootstrap interval. Left of the line: smaller than before"
    figure = titled_figure(head + height + foot, f"Compared with {compared[0].first}", explained)
    for number, quantity in enumerate(QUANTITIES):
        axes = _panel(figure, number, _ROWS_LEFT[0], head, height)
        axes.axvline(0.0, color=INK, linewidth=1.0)
        for row, runs in enumerate(compared):
            difference = runs.comparison.differences.get(COMPONENTS[quantity.column])
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
        labels = [f"{runs.second}: {STYLES[runs.source].label}" for runs in compared] if number == 0 else []
        for label in axes.set_yticklabels(labels or [""] * len(compared)):
            label.set_parse_math(False)
    return figure


def batch_figure(results: Sequence[BatchResult], requirement: Requirement) -> Figure:
    """Draw median and 95 % of the absolute errors of each recording that has results, in their order.

    Each quantity has a panel, and in each row each run and source a mark.
    """
    shown = [result for result in results if result.totals]
    head, row_px, foot = 104, 26, 56
    height = row_px * (len(shown) + 0.4)
    explained = "Marks: median of the absolute errors; lines: up to 95 % of them. Dotted: the requirement"
    figure = titled_figure(head + height + foot, "Errors of each recording", explained)
    for number, quantity in enumerate(QUANTITIES):
        axes = _panel(figure, number, _ROWS_LEFT[1], head, height)
        _draw_totals(axes, shown, quantity)
        axes.axvline(quantity.limit(requirement), color=INK, linewidth=1.0, linestyle=DOTTED)
        axes.set(ylim=(len(shown) - 0.3, -0.7), yticks=range(len(shown)))
        axes.set_xlim(left=0.0)
        axes.set_xlabel(f"{quantity.label} ({quantity.unit})")
        labels = [result.name for result in shown] if number == 0 else [""] * len(shown)
        for label in axes.set_yticklabels(labels):
            label.set_parse_math(False)
    add_legend(figure, head - LEGEND_ROW_PX - 12, axes)
    return figure


def _draw_totals(axes: Axes, shown: Sequence[BatchResult], quantity: Quantity) -> None:
    keys = list(dict.fromkeys((totals.run, totals.source) for result in shown for totals in result.totals))
    for row, result in enumerate(shown):
        for totals in result.totals:
            place = keys.index((totals.run, totals.source))
            shift = 0.6 * ((place + 0.5) / len(keys) - 0.5)
            _mark(axes, totals, quantity, (row + shift, SERIES[place % len(SERIES)]))
    for place, (run, source) in enumerate(keys):
        style = STYLES[source]
        axes.plot([], [], style.mark, color=SERIES[place % len(SERIES)], label=f"{run}: {style.label}")


def _mark(axes: Axes, totals: SourceTotals, quantity: Quantity, how: tuple[float, str]) -> None:
    row, color = how
    sizes = np.abs(totals.offsets[:, quantity.column]) * quantity.scale
    if len(sizes):
        median, most = float(np.median(sizes)), float(np.percentile(sizes, 95))
        axes.plot([median, most], [row, row], color=color, linewidth=2.0, alpha=0.5)
        axes.plot(median, row, STYLES[totals.source].mark, color=color, markersize=5)


def _panel(figure: Figure, number: int, left: float, top: float, height: float) -> Axes:
    """Return the axes of one of four panels of rows, with a grid."""
    width = (WIDTH_PX - left - _ROWS_RIGHT - 3 * _ROWS_GAP) / 4
    axes = add_axes(figure, left + number * (width + _ROWS_GAP), top, width, height)
    add_grid(axes)
    return axes
