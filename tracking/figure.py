"""A picture of a run: single shots, filter and smoother of every track over time."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

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
from tracking.deviation import Deviations, TrackDeviations

MOST_BESIDE = 4
"""How many tracks stand side by side; the others follow below."""
_LEFT, _RIGHT, _HEAD, _GAP, _FOOT = 80, 18, 108, 26, 0  # in pixels
_TITLE, _HEIGHT, _BETWEEN, _AXIS = 46, 170, 12, 52
_SHOTS, _FILTER, _SMOOTHER = "#7c838d", SERIES[0], SERIES[1]
_ROWS = ((3, "yaw", "\N{DEGREE SIGN}", 180 / np.pi), (0, "depth", "mm", 1000.0), (1, "along", "mm", 1000.0))
"""Which deviation, its name, its unit, and how many of that in a metre or radian."""


def track_figure(tracks: Sequence[TrackDeviations], name: str) -> Figure:
    """Draw how the poses of each track deviate over time.

    Parameters
    ----------
    tracks : sequence of TrackDeviations
        One column for each.
    name : str
        Of the recording, for the title.

    Returns
    -------
    Figure
        Yaw, depth (across the pallet's front) and place along the front, minus the truth; where there is none, minus
        the end of the track, carried back by odometry. Dots with bars are the measurements of single shots, lines
        with bands the filter and the smoother. Bars and bands reach two standard deviations to either side.
    """
    blocks = [tracks[first : first + MOST_BESIDE] for first in range(0, len(tracks), MOST_BESIDE)]
    block_height = _TITLE + len(_ROWS) * (_HEIGHT + _BETWEEN) + _AXIS
    figure = new_figure(_HEAD + max(len(blocks), 1) * block_height + _FOOT)
    add_text(figure, _LEFT, 14, f"{name}: tracks over the approach", size=13, bold=True)
    add_text(figure, _LEFT, 40, f"Pose minus {_held(tracks)}. Bars and bands: two standard deviations", size=10.5)
    if not tracks:
        add_text(figure, _LEFT, _HEAD, "No track was confirmed.", size=11)
        return figure
    limits = [_limit(tracks, axis, scale) for axis, _, _, scale in _ROWS]
    first_axes: Axes | None = None
    for number, block in enumerate(blocks):
        drawn = _draw_block(figure, _HEAD + number * block_height, block, min(len(tracks), MOST_BESIDE), limits)
        first_axes = first_axes or drawn
    if first_axes is not None:
        add_legend(figure, _HEAD - LEGEND_ROW_PX - 16, first_axes)
    return figure


def _held(tracks: Sequence[TrackDeviations]) -> str:
    """Say what the tracks are held against."""
    end = "the track's end, which odometry carries back with its drift"
    if not any(one.against for one in tracks):
        return end
    return "true pose" if all(one.against for one in tracks) else f"true pose; without a pallet, minus {end}"


def _draw_block(
    figure: Figure, top: float, tracks: Sequence[TrackDeviations], columns: int, limits: Sequence[float]
) -> Axes:
    """Draw the tracks of one block; return axes that have every key."""
    width = (WIDTH_PX - _LEFT - _RIGHT - (columns - 1) * _GAP) / columns
    ends = [one.filtered.times[[0, -1]] for one in tracks if len(one.filtered.times)]
    span = (min(end[0] for end in ends), max(end[1] for end in ends)) if ends else (0.0, 1.0)
    margin = 0.03 * (span[1] - span[0]) + 0.05
    for column, track in enumerate(tracks):
        left = _LEFT + column * (width + _GAP)
        name = f"track {track.track}" + (f": pallet {track.against}" if track.against else "")
        add_text(figure, left, top + 2, name, size=10.5, bold=True)
        first, last = track.ranges
        add_text(figure, left, top + 22, f"{track.model}, from {first:.1f} m away to {last:.1f} m", size=9.5)
        for row, (axis, label, unit, scale) in enumerate(_ROWS):
            axes = add_axes(figure, left, top + _TITLE + row * (_HEIGHT + _BETWEEN), width, _HEIGHT)
            _draw(axes, track, axis, scale)
            axes.set(xlim=(span[0] - margin, span[1] + margin), ylim=(-limits[row], limits[row]))
            axes.yaxis.set_major_locator(MaxNLocator(5))
            if column == 0:
                axes.set_ylabel(f"{label} ({unit})")
            else:
                axes.set_yticklabels([])
            if row < len(_ROWS) - 1:
                axes.set_xticklabels([])
        axes.set_xlabel("time (s)")
    return axes


def _draw(axes: Axes, track: TrackDeviations, axis: int, scale: float) -> None:
    axes.axhline(0.0, color=INK, linewidth=1.0)
    axes.grid(color=GRID, linewidth=0.6)
    axes.set_axisbelow(True)
    one = track.shots
    bars = 2 * one.sigmas[:, axis] * scale
    axes.errorbar(
        one.times,
        one.offsets[:, axis] * scale,
        bars,
        fmt="o",
        color=_SHOTS,
        ecolor=(_SHOTS, 0.45),
        elinewidth=1.6,
        markersize=4.5,
        label="single shots",
        zorder=2,
    )
    _draw_line(axes, track.filtered, axis, scale, _FILTER, "-", "filter: by what was known then")
    if track.smoothed is not None:
        _draw_line(axes, track.smoothed, axis, scale, _SMOOTHER, (0, (5, 2)), "smoother: by all shots")


def _draw_line(
    axes: Axes,
    one: Deviations,
    axis: int,
    scale: float,
    color: str,
    line: str | tuple[float, tuple[float, ...]],
    label: str,
) -> None:
    values, wide = one.offsets[:, axis] * scale, 2 * one.sigmas[:, axis] * scale
    axes.fill_between(one.times, values - wide, values + wide, color=color, alpha=0.16, linewidth=0)
    axes.plot(one.times, values, color=color, linestyle=line, linewidth=1.9, label=label, zorder=3)


def _limit(tracks: Sequence[TrackDeviations], axis: int, scale: float) -> float:
    """Return up to where to draw: nearly all values and most of their bars; a single wide bar leaves the picture."""
    all_of = [one for track in tracks for one in (track.shots, track.filtered)]
    values = np.abs(np.concatenate([one.offsets[:, axis] for one in all_of])) * scale
    ends = values + 2 * np.concatenate([one.sigmas[:, axis] for one in all_of]) * scale
    if not len(values):
        return 1.0
    return 1.1 * max(float(np.quantile(values, 0.97)), float(np.quantile(ends, 0.8)), 1e-3)
