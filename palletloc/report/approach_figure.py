"""Errors over an approach, pallet by pallet: single shots, tracks and surveyed stops."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from palletloc.drawing.canvas import LEGEND_ROW_PX, WIDTH_PX, add_axes, add_legend, add_text, new_figure
from palletloc.evaluation.pose_error import PoseError
from palletloc.evaluation.requirement import Requirement
from palletloc.evaluation.run import SHOTS_SOURCE, TRACKS_SOURCE, EvaluatedRun
from palletloc.report.source_style import DEPTH, STOP_STYLE, STYLES, YAW, Quantity, prepare, reach

MOST_PALLETS = 12
"""How many pallets are drawn: those with the most errors."""
_BESIDE = 3
_LEFT, _RIGHT, _HEAD, _GAP = 76, 18, 112, 26  # in pixels
_TITLE, _HEIGHT, _BETWEEN, _AXIS = 30, 190, 14, 56
_ROWS = (YAW, DEPTH)


@dataclass(frozen=True, slots=True, eq=False)
class _Panel:
    """What is known of one pallet."""

    pallet: str
    shots: Sequence[PoseError]
    tracks: Mapping[str, Sequence[PoseError]]
    stops: Sequence[PoseError]

    @property
    def groups(self) -> list[Sequence[PoseError]]:
        return [self.shots, self.stops, *self.tracks.values()]


def approach_figure(run: EvaluatedRun, requirement: Requirement) -> Figure:
    """Draw the errors of yaw and depth over time, one column for each pallet.

    Parameters
    ----------
    run : EvaluatedRun
        The run.
    requirement : Requirement
        Whose limits are drawn.

    Returns
    -------
    Figure
        Dots with bars are single shots, lines with bands tracks, diamonds single shots against the survey with the
        uncertainty of both; bars and bands reach two standard deviations to either side.
    """
    panels = _panels(run)
    rows = [panels[first : first + _BESIDE] for first in range(0, len(panels), _BESIDE)]
    block = _TITLE + len(_ROWS) * (_HEIGHT + _BETWEEN) + _AXIS
    figure = new_figure(_HEAD + max(len(rows), 1) * block)
    add_text(figure, _LEFT, 14, f"{run.files.name}: errors over the approach", size=13, bold=True)
    told = "Measured minus true. Bars and bands: two standard deviations. Dotted: the requirement"
    add_text(figure, _LEFT, 40, told, size=10.5)
    if not panels:
        add_text(figure, _LEFT, _HEAD, "No pallet was found.", size=11)
        return figure
    columns = min(_BESIDE, len(panels))
    width = (WIDTH_PX - _LEFT - _RIGHT - (columns - 1) * _GAP) / columns
    drawn: list[Axes] = []
    for number, panel in enumerate(panels):
        row, column = divmod(number, _BESIDE)
        left, top = _LEFT + column * (width + _GAP), _HEAD + row * block
        drawn += _draw_panel(figure, (left, top, width), panel, panels, requirement)
    add_legend(figure, _HEAD - LEGEND_ROW_PX - 16, *drawn)
    return figure


def _panels(run: EvaluatedRun) -> list[_Panel]:
    shots, tracks = run.sources.get(SHOTS_SOURCE), run.sources.get(TRACKS_SOURCE)
    single = [one for shot in shots.shots for one in (*shot.errors, *shot.beyond)] if shots else []
    followed = [one for shot in tracks.shots for one in (*shot.errors, *shot.beyond)] if tracks else []
    stops = [one for stop in shots.stops for one in stop.errors] if shots else []
    names = sorted({one.face.id for one in (*single, *followed)})
    panels = []
    for name in names:
        of_track: dict[str, list[PoseError]] = {}
        for one in _of(followed, name):
            of_track.setdefault(one.estimate.track, []).append(one)
        panels.append(_Panel(name, _of(single, name), of_track, _of(stops, name)))
    kept = sorted(panels, key=lambda one: -sum(map(len, one.groups)))[:MOST_PALLETS]
    return [panel for panel in panels if panel in kept]


def _of(errors: Sequence[PoseError], pallet: str) -> list[PoseError]:
    return [one for one in errors if one.face.id == pallet]


def _draw_panel(
    figure: Figure,
    place: tuple[float, float, float],
    panel: _Panel,
    panels: Sequence[_Panel],
    requirement: Requirement,
) -> list[Axes]:
    left, top, width = place
    ranges = [one.face.range for group in panel.groups for one in group]
    add_text(figure, left, top, f"pallet {panel.pallet}", size=10.5, bold=True)
    add_text(figure, left + 110, top + 1, f"{max(ranges):.1f} m to {min(ranges):.1f} m away", size=9.5)
    times = [one.time for each in panels for group in each.groups for one in group]
    margin = 0.03 * (max(times) - min(times)) + 0.05
    drawn = []
    for row, quantity in enumerate(_ROWS):
        axes = add_axes(figure, left, top + _TITLE + row * (_HEIGHT + _BETWEEN), width, _HEIGHT)
        _draw(axes, panel, quantity, requirement)
        limit = _limit(panels, quantity)
        axes.set(xlim=(min(times) - margin, max(times) + margin), ylim=(-limit, limit))
        axes.yaxis.set_major_locator(MaxNLocator(5))
        if left == _LEFT:
            axes.set_ylabel(f"{quantity.label} error ({quantity.unit})")
        else:
            axes.set_yticklabels([])
        if row < len(_ROWS) - 1:
            axes.set_xticklabels([])
        drawn.append(axes)
    drawn[-1].set_xlabel("time of the shot (s)")
    return drawn


def _draw(axes: Axes, panel: _Panel, quantity: Quantity, requirement: Requirement) -> None:
    prepare(axes)
    limit = quantity.limit(requirement)
    axes.hlines((-limit, limit), *_FAR, color="#9aa1ab", linewidth=1.1, linestyle=(0, (1, 2)))
    for number, errors in enumerate(panel.tracks.values()):
        _draw_track(axes, errors, quantity, STYLES[TRACKS_SOURCE].label if number == 0 else "")
    _draw_points(axes, panel.shots, quantity, stop=False)
    _draw_points(axes, panel.stops, quantity, stop=True)


_FAR = (-1e12, 1e12)


def _draw_track(axes: Axes, errors: Sequence[PoseError], quantity: Quantity, label: str) -> None:
    times = [one.time for one in errors]
    values, wide = quantity.values(errors), 2 * quantity.sigmas(errors)
    color = STYLES[TRACKS_SOURCE].color
    axes.fill_between(times, values - wide, values + wide, color=color, alpha=0.16, linewidth=0)
    axes.plot(times, values, color=color, linewidth=1.9, label=label or None, zorder=3)


def _draw_points(axes: Axes, errors: Sequence[PoseError], quantity: Quantity, *, stop: bool) -> None:
    if not errors:
        return
    style = STOP_STYLE if stop else STYLES[SHOTS_SOURCE]
    axes.errorbar(
        [one.time for one in errors],
        quantity.values(errors),
        2 * quantity.sigmas(errors),
        fmt=style.mark,
        color=style.color,
        ecolor=(style.color, 0.6 if stop else 0.45),
        elinewidth=1.6,
        capsize=4 if stop else 0,
        markersize=6 if stop else 4.5,
        label=style.label,
        zorder=4 if stop else 2,
    )


def _limit(panels: Sequence[_Panel], quantity: Quantity) -> float:
    """Return up to where to draw: all values and most of their bars; a single wide bar leaves the picture."""
    groups = [group for panel in panels for group in panel.groups]
    values = np.abs(reach(groups, quantity.values))
    ends = values + 2 * reach(groups, quantity.sigmas)
    return 1.1 * max(float(values.max()), float(np.quantile(ends, 0.8)), 1e-3)
