"""A run over the approach: errors pallet by pallet, and the aisle from above."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Polygon
from matplotlib.ticker import MaxNLocator

from palletloc.drawing.canvas import FAINT, INK, LEGEND_ROW_PX, WIDTH_PX, add_axes, add_legend, add_text
from palletloc.evaluation.pose_error import PalletEstimate, PoseError, TrueFace
from palletloc.evaluation.requirement import Requirement
from palletloc.evaluation.run import SHOTS_SOURCE, TRACKS_SOURCE, EvaluatedRun
from palletloc.evaluation.run_match import ShotMatch
from palletloc.evaluation.truth import RecordingTruth
from palletloc.geometry import FloatArray, LevelPose
from palletloc.pallet import PalletModel
from palletloc.report.source_style import DEPTH, STOP_STYLE, STYLES, YAW, Quantity, add_grid, titled_figure

MOST_PALLETS = 12
"""How many pallets are drawn: those with the most errors."""
_Pallet = tuple[str, str, LevelPose]
"""Name, model and pose of a true pallet."""
_Carried = Mapping[float, LevelPose]
"""The forklift's pose at each shot's time."""
_ROWS = (YAW, DEPTH)
"""The quantities that are drawn over time, one below the other."""
_BESIDE = 3
"""How many pallets are drawn side by side: each stays wide enough to read its times."""
_LEFT, _RIGHT, _HEAD, _GAP = 76, 18, 112, 26
"""Borders of the page and the gap between columns, in pixels."""
_TITLE, _HEIGHT, _BETWEEN, _AXIS = 30, 190, 14, 56
"""Heights of a pallet's title, of a panel, of the gap below it, and of the time axis, in pixels."""
_FAR = (-1e12, 1e12)
"""Ends of lines that reach over any time of a shot, in seconds, without changing the axes."""
_MAP_LEFT, _MAP_RIGHT, _MAP_HEAD, _MAP_FOOT = 70, 20, 72, 92
"""Borders of the map, in pixels."""
_LEAST_PX, _MOST_PX = 300, 640
"""Least and most height of the map, in pixels: an aisle is much longer than wide."""
_AROUND = 0.5
"""Margin of the map around everything that is drawn, in metres."""
_FALSE = "#c81e4a"
"""Colour of estimates where no pallet stands."""


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

    Dots with bars are single shots, lines with bands tracks, diamonds single shots against the survey with the
    uncertainty of both; bars and bands reach two standard deviations to either side.
    """
    panels = _panels(run)
    rows = [panels[first : first + _BESIDE] for first in range(0, len(panels), _BESIDE)]
    block = _TITLE + len(_ROWS) * (_HEIGHT + _BETWEEN) + _AXIS
    explained = "Measured minus true. Bars and bands: two standard deviations. Dotted: the requirement"
    title = f"{run.files.name}: errors over the approach"
    figure = titled_figure(_HEAD + max(len(rows), 1) * block, title, explained)
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
    single = [error for shot in shots.shots for error in (*shot.errors, *shot.beyond)] if shots else []
    followed = [error for shot in tracks.shots for error in (*shot.errors, *shot.beyond)] if tracks else []
    stops = [error for stop in shots.stops for error in stop.errors] if shots else []
    names = sorted({error.face.id for error in (*single, *followed)})
    panels = []
    for name in names:
        of_track: dict[str, list[PoseError]] = {}
        for error in _of(followed, name):
            of_track.setdefault(error.estimate.track, []).append(error)
        panels.append(_Panel(name, _of(single, name), of_track, _of(stops, name)))
    kept = sorted(panels, key=lambda panel: -sum(map(len, panel.groups)))[:MOST_PALLETS]
    return [panel for panel in panels if panel in kept]


def _of(errors: Sequence[PoseError], pallet: str) -> list[PoseError]:
    return [error for error in errors if error.face.id == pallet]


def _draw_panel(
    figure: Figure,
    place: tuple[float, float, float],
    panel: _Panel,
    panels: Sequence[_Panel],
    requirement: Requirement,
) -> list[Axes]:
    left, top, width = place
    ranges = [error.face.range for group in panel.groups for error in group]
    add_text(figure, left, top, f"pallet {panel.pallet}", size=10.5, bold=True)
    add_text(figure, left + 110, top + 1, f"{max(ranges):.1f} m to {min(ranges):.1f} m away", size=9.5)
    times = [error.time for each in panels for group in each.groups for error in group]
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
    axes.axhline(0.0, color=INK, linewidth=1.0)
    add_grid(axes)
    limit = quantity.limit(requirement)
    axes.hlines((-limit, limit), *_FAR, color="#9aa1ab", linewidth=1.1, linestyle=(0, (1, 2)))
    for number, errors in enumerate(panel.tracks.values()):
        _draw_track(axes, errors, quantity, STYLES[TRACKS_SOURCE].label if number == 0 else "")
    _draw_points(axes, panel.shots, quantity, stop=False)
    _draw_points(axes, panel.stops, quantity, stop=True)


def _draw_track(axes: Axes, errors: Sequence[PoseError], quantity: Quantity, label: str) -> None:
    times = [error.time for error in errors]
    values, wide = quantity.values(errors), 2 * quantity.sigmas(errors)
    color = STYLES[TRACKS_SOURCE].color
    axes.fill_between(times, values - wide, values + wide, color=color, alpha=0.16, linewidth=0)
    axes.plot(times, values, color=color, linewidth=1.9, label=label or None, zorder=3)


def _draw_points(axes: Axes, errors: Sequence[PoseError], quantity: Quantity, *, stop: bool) -> None:
    if not errors:
        return
    style = STOP_STYLE if stop else STYLES[SHOTS_SOURCE]
    axes.errorbar(
        [error.time for error in errors],
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
    values = np.abs(_of_all(groups, quantity.values))
    ends = values + 2 * _of_all(groups, quantity.sigmas)
    return 1.1 * max(float(values.max()), float(np.quantile(ends, 0.8)), 1e-3)


def _of_all(groups: Sequence[Sequence[PoseError]], values: Callable[[Sequence[PoseError]], FloatArray]) -> FloatArray:
    """Return a value for each error of all groups, (n,)."""
    parts = [values(group) for group in groups if group]
    return np.concatenate(parts) if parts else np.zeros(0)


def aisle_figure(truth: RecordingTruth, run: EvaluatedRun) -> Figure:
    """Draw a map in the world frame; without a path of the forklift, in its frame at the first stop.

    True pallets are outlines with thick fronts, estimates marks, false ones crosses, the path a line.
    """
    models = {model.name: model for model in truth.recording.models}
    pallets, path, carried = _world(truth, run)
    drawn = [_corners(models[model], pose) for _, model, pose in pallets]
    places = np.concatenate([path, *drawn])
    low, high = places.min(axis=0) - _AROUND, places.max(axis=0) + _AROUND
    width = WIDTH_PX - _MAP_LEFT - _MAP_RIGHT
    size = high - low
    scale = min(width / size[0], _MOST_PX / size[1])
    height = max(float(size[1] * scale), _LEAST_PX)
    spare = (np.array([width, height]) / scale - size) / 2
    title, explained = (
        f"{run.files.name}: the aisle from above",
        "Outlines: true pallets, thick at the front. Marks: estimates",
    )
    figure = titled_figure(_MAP_HEAD + height + _MAP_FOOT, title, explained, _MAP_LEFT)
    axes = add_axes(figure, _MAP_LEFT, _MAP_HEAD, width, height)
    axes.set(xlim=(low[0] - spare[0], high[0] + spare[0]), ylim=(low[1] - spare[1], high[1] + spare[1]))
    frame = "the forklift's frame at the first shot" if truth.path is None else "the frame of the truth"
    axes.set(xlabel=f"x in {frame} (m)", ylabel="y (m)")
    add_grid(axes)
    for (name, _, pose), corners in zip(pallets, drawn, strict=True):
        axes.add_patch(Polygon(corners, facecolor="#eef1f4", edgecolor=FAINT, linewidth=0.9))
        axes.plot(*corners[:2].T, color=INK, linewidth=3.0, solid_capstyle="butt")
        middle = corners.mean(axis=0)
        label = f"{name}, {round(pose.z, 2) + 0.0:.2f} m up"
        axes.text(middle[0], middle[1], label, ha="center", va="center", size=9, parse_math=False)
    axes.plot(*path.T, color=INK, linewidth=1.2, marker=".", markersize=5, label="forklift, true")
    _draw_estimates(axes, run, carried)
    add_legend(figure, _MAP_HEAD + height + 52, axes)
    return figure


def _world(truth: RecordingTruth, run: EvaluatedRun) -> tuple[list[_Pallet], FloatArray, _Carried]:
    """Return the pallets, the forklift's places, (n, 2), and its pose at each shot's time."""
    shots = next(iter(run.sources.values())).shots
    if truth.path is not None:
        poses = {shot.time: truth.path.pose_at(shot.time) for shot in shots}
        pallets = [(pallet.id, pallet.model, pallet.world_from_pallet) for pallet in truth.pallets]
        return pallets, np.array([[pose.x, pose.y] for pose in poses.values()]), poses
    here = LevelPose(0.0, 0.0, 0.0, 0.0)
    first = shots[0]
    faces = {face.id: face for face in _faces(first)}
    pallets = [(face.id, face.model, face.forklift_from_pallet) for face in faces.values()]
    return pallets, np.zeros((1, 2)), {first.time: here}


def _faces(shot: ShotMatch) -> list[TrueFace]:
    return [*(error.face for error in (*shot.errors, *shot.beyond)), *shot.missed]


def _corners(model: PalletModel, pose: LevelPose) -> FloatArray:
    """Return the four corners from above, the front's first, (4, 2)."""
    half = model.width / 2
    corners = np.array([[0, half, 0], [0, -half, 0], [model.depth, -half, 0], [model.depth, half, 0]])
    return np.asarray(pose.transform().apply(corners)[:, :2])


def _draw_estimates(axes: Axes, run: EvaluatedRun, carried: _Carried) -> None:
    for name, source in run.sources.items():
        style = STYLES[name]
        found: list[FloatArray] = []
        false: list[FloatArray] = []
        for shot in source.shots:
            if shot.time not in carried:
                continue
            world_from_forklift = carried[shot.time].transform()
            placed = [error.estimate for error in (*shot.errors, *shot.beyond)]
            found += [world_from_forklift.apply(_place(estimate))[:2] for estimate in placed]
            false += [world_from_forklift.apply(_place(estimate))[:2] for estimate in shot.false]
        if found:
            axes.plot(*np.array(found).T, style.mark, color=style.color, markersize=4, alpha=0.6, label=style.label)
        if false:
            label = f"{style.label}: where no pallet stands"
            axes.plot(*np.array(false).T, "x", color=_FALSE, markersize=7, markeredgewidth=1.6, label=label)


def _place(estimate: PalletEstimate) -> FloatArray:
    return estimate.forklift_from_pallet.as_array()[:3]
