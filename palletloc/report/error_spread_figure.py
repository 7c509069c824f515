"""How errors are spread, and how they grow with distance."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter

from palletloc.drawing.canvas import GRID, INK, LEGEND_ROW_PX, WIDTH_PX, add_axes, add_legend, add_text, new_figure
from palletloc.evaluation.breakdown import by_distance, distance_edges
from palletloc.evaluation.requirement import Requirement
from palletloc.evaluation.run import EvaluatedRun, EvaluatedSource, Settings
from palletloc.geometry import FloatArray
from palletloc.report.source_style import DEPTH, QUANTITIES, STYLES, YAW, Quantity

_LEFT, _RIGHT, _HEAD, _GAP, _HEIGHT, _FOOT = 76, 18, 112, 40, 220, 60  # in pixels
_BINS = 25
_LEAST = {"\N{DEGREE SIGN}": 0.003, "mm": 0.1}
_DOTTED = (0, (1, 2))


def histogram_figure(run: EvaluatedRun, requirement: Requirement) -> Figure:
    """Draw histograms of the errors of yaw, depth, along and height, sources on top of one another.

    Parameters
    ----------
    run : EvaluatedRun
        The run.
    requirement : Requirement
        Whose limits are drawn.

    Returns
    -------
    Figure
        Each bar is the part of a source's errors in its bin; what lies outside the axes is told.
    """
    figure = new_figure(_HEAD + _HEIGHT + _FOOT)
    add_text(figure, _LEFT, 14, f"{run.files.name}: how the errors are spread", size=13, bold=True)
    add_text(
        figure, _LEFT, 40, "Part of the errors of each source. Dotted: the requirement, where it is near", size=10.5
    )
    width = (WIDTH_PX - _LEFT - _RIGHT - 3 * _GAP) / 4
    for number, quantity in enumerate(QUANTITIES):
        axes = add_axes(figure, _LEFT + number * (width + _GAP), _HEAD, width, _HEIGHT)
        axes.grid(color=GRID, linewidth=0.6)
        axes.set_axisbelow(True)
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
            axes.axvline(side, color=INK, linewidth=1.2, linestyle=_DOTTED)
    outside = sum(int((np.abs(some) > limit).sum()) for some in values.values())
    if outside:
        told = axes.text(0.98, 0.96, f"{outside} farther out", transform=axes.transAxes, ha="right", va="top")
        told.set(size=8.5, color=INK)


def distance_figure(run: EvaluatedRun, settings: Settings) -> Figure:
    """Draw absolute errors of yaw and depth against the pallets' true distance from the camera.

    Parameters
    ----------
    run : EvaluatedRun
        The run.
    settings : Settings
        Gives the bins and the limits of the requirement.

    Returns
    -------
    Figure
        A mark for each error, a line through the medians of the bins; logarithmic scales.
    """
    figure = new_figure(_HEAD + _HEIGHT + 40 + _FOOT)
    add_text(figure, _LEFT, 14, f"{run.files.name}: errors against distance", size=13, bold=True)
    told = "Absolute errors; lines: median of each half metre; dotted: the requirement; logarithmic scales"
    add_text(figure, _LEFT, 40, told.replace("half metre", _width(settings.bin_width)), size=10.5)
    width = (WIDTH_PX - _LEFT - _RIGHT - 2 * _GAP) / 2
    for number, quantity in enumerate((YAW, DEPTH)):
        axes = add_axes(figure, _LEFT + number * (width + 2 * _GAP), _HEAD, width, _HEIGHT + 40)
        axes.set_yscale("log")
        axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axes.grid(color=GRID, linewidth=0.6)
        axes.set_axisbelow(True)
        axes.axhline(quantity.limit(settings.requirement), color=INK, linewidth=1.2, linestyle=_DOTTED)
        for name, source in run.sources.items():
            _draw_source(axes, source, name, quantity, settings)
        axes.set(xlabel="distance from the camera (m)", ylabel=f"{quantity.label} error ({quantity.unit})")
    add_legend(figure, _HEAD - LEGEND_ROW_PX - 16, axes)
    return figure


def _width(metres: float) -> str:
    return "half metre" if metres == 0.5 else f"{metres:g} m"


def _draw_source(axes: Axes, source: EvaluatedSource, name: str, quantity: Quantity, settings: Settings) -> None:
    style, least = STYLES[name], _LEAST[quantity.unit]
    ranges = [one.face.range for one in source.errors]
    axes.plot(
        ranges,
        np.maximum(_sizes(quantity.values(source.errors)), least),
        style.mark,
        color=style.color,
        markersize=4,
        alpha=0.45,
        markeredgewidth=0,
    )
    bins = [one for one in by_distance(source.shots, _edges(settings)) if one.errors]
    middles = [float(np.mean([one.face.range for one in part.errors])) for part in bins]
    medians = [max(float(np.median(_sizes(quantity.values(part.errors)))), least) for part in bins]
    axes.plot(middles, medians, marker=style.mark, color=style.color, linewidth=1.9, markersize=6, label=style.label)


def _edges(settings: Settings) -> Sequence[float]:
    return distance_edges(settings.bin_width, settings.visibility.max_range)


def _sizes(values: FloatArray) -> FloatArray:
    return np.abs(values)
