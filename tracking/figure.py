"""A picture of a run: how single shots, filter and smoother deviate from where each pallet is, over time."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

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
from palletloc.evaluation.run_match import PAIRING_DISTANCE
from palletloc.geometry import FloatArray, LevelPose, level_pose, wrap_angle
from palletloc.io.tracks import TrackRow
from palletloc.io.truth import TruePallet, Truth
from palletloc.measurement import PalletMeasurement
from palletloc.track_status import Status
from palletloc.trajectory import TrajectoryError
from tracking.recording import TrackedRecording, odometry_at

MOST_BESIDE = 4
"""How many tracks stand side by side; the others follow below."""
_LEFT, _RIGHT, _HEAD, _GAP, _TITLE, _HEIGHT, _BETWEEN, _AXIS = 80, 18, 108, 26, 46, 170, 12, 52
"""Margins of the picture, its head and the gap between columns; a block's title, the height of its charts, the space
between them and that of the axis below: in pixels."""
_SHOTS, _FILTER, _SMOOTHER = "#7c838d", SERIES[0], SERIES[1]
"""Colours of the lines."""
_ROWS = ((3, "yaw", "\N{DEGREE SIGN}", 180 / np.pi), (0, "depth", "mm", 1000.0), (1, "along", "mm", 1000.0))
"""Which deviation, its name, its unit, and how many of that in a metre or radian."""


_Reference = Callable[[float], LevelPose | None]
"""Where a pallet is held to be at a time: ``forklift_from_pallet``, or None where that is not known."""


@dataclass(frozen=True, slots=True, eq=False)
class Deviations:
    """Poses of one pallet over time against where it is held to be."""

    times: FloatArray
    """(n,) in seconds."""
    offsets: FloatArray
    """(n, 4) into the pallet, along its front to its left, up, in metres, and yaw in radians."""
    sigmas: FloatArray
    """(n, 4) standard deviations that the poses state of them."""


@dataclass(frozen=True, slots=True, eq=False)
class TrackDeviations:
    """One confirmed track."""

    track: int
    """Its number."""
    model: str
    """Name of the pallet model."""
    against: str
    """Name of the true pallet; empty where the track is held against its own end."""
    ranges: tuple[float, float]
    """Distance on the floor from the forklift at its first and last shot, in metres."""
    shots: Deviations
    """The measurements near it."""
    filtered: Deviations
    """The track from shot to shot."""
    smoothed: Deviations | None
    """The same with all that is known at the end."""


def track_deviations(run: TrackedRecording, truth: Truth | None = None) -> tuple[TrackDeviations, ...]:
    """Hold each confirmed track against the true pallet in its place, or else against its own end.

    Parameters
    ----------
    run : TrackedRecording
        The tracks.
    truth : Truth, optional
        Of the recording.

    Returns
    -------
    tuple of TrackDeviations
        In the order of their numbers.
    """
    rows, later = _by_track(run.rows), _by_track(run.smoothed_rows)
    near = _measured_by_track(run)
    confirmed = (number for number in sorted(rows) if any(row.status is not Status.TENTATIVE for row in rows[number]))
    return tuple(
        _deviations(run, truth, rows[number], later.get(number, []), near.get(number, [])) for number in confirmed
    )


def _by_track(rows: Iterable[TrackRow]) -> dict[int, list[TrackRow]]:
    by_track: dict[int, list[TrackRow]] = {}
    for row in rows:
        by_track.setdefault(row.track, []).append(row)
    return by_track


def _measured_by_track(run: TrackedRecording) -> dict[int, list[PalletMeasurement]]:
    """Return the measurements of each shot by the track that they are nearest to."""
    rows = {tracks.shot.time: tracks.rows for tracks in run.shots}
    by_track: dict[int, list[PalletMeasurement]] = {}
    for measurement in run.measured:
        pose = measurement.forklift_from_pallet
        distances = {row.track: _distance(row.pose, pose) for row in rows.get(measurement.time, ())}
        nearest = min(distances, key=lambda number: distances[number], default=None)
        if nearest is not None and distances[nearest] < PAIRING_DISTANCE:
            by_track.setdefault(nearest, []).append(measurement)
    return by_track


def _deviations(
    run: TrackedRecording,
    truth: Truth | None,
    rows: Sequence[TrackRow],
    later: Sequence[TrackRow],
    near: Sequence[PalletMeasurement],
) -> TrackDeviations:
    pallet = None if truth is None else _true_pallet(rows, truth)
    if truth is not None and pallet is not None:
        name, reference = pallet.id, _by_truth(truth, pallet)
    else:
        name, reference = "", _by_end((later or rows)[-1], run)
    first, last = (math.hypot(row.pose.x, row.pose.y) for row in (rows[0], rows[-1]))
    return TrackDeviations(
        rows[-1].track,
        rows[-1].model,
        name,
        (first, last),
        _against(reference, [(shot.time, shot.forklift_from_pallet, shot.covariance) for shot in near]),
        _against(reference, [(row.time, row.pose, row.covariance) for row in rows]),
        _against(reference, [(row.time, row.pose, row.covariance) for row in later]) if later else None,
    )


def _true_pallet(rows: Iterable[TrackRow], truth: Truth) -> TruePallet | None:
    """Return the true pallet that most rows of a track are nearest to."""
    votes: Counter[str] = Counter()
    pallets = {pallet.id: pallet for pallet in truth.pallets}
    for row in rows:
        poses = {name: _by_truth(truth, pallet)(row.time) for name, pallet in pallets.items()}
        distances = {name: _distance(pose, row.pose) for name, pose in poses.items() if pose is not None}
        nearest = min(distances, key=lambda name: distances[name], default=None)
        if nearest is not None and distances[nearest] < PAIRING_DISTANCE:
            votes[nearest] += 1
    return pallets[votes.most_common(1)[0][0]] if votes else None


def _by_truth(truth: Truth, pallet: TruePallet) -> _Reference:
    def at(time: float) -> LevelPose | None:
        try:
            world_from_forklift = truth.forklift.pose_at(time)
        except TrajectoryError:
            return None
        return level_pose(world_from_forklift.transform().inv() * pallet.world_from_pallet.transform())

    return at


def _by_end(end: TrackRow, run: TrackedRecording) -> _Reference:
    """Return where odometry carries the end of a track back to."""
    last = odometry_at(run.recording, end.time)

    def at(time: float) -> LevelPose | None:
        pose = odometry_at(run.recording, time)
        if last is None or pose is None:
            return None
        return level_pose(pose.transform().inv() * last.transform() * end.pose.transform())

    return at


def _distance(pose: LevelPose, other: LevelPose) -> float:
    return math.dist((pose.x, pose.y, pose.z), (other.x, other.y, other.z))


def _against(reference: _Reference, poses: Sequence[tuple[float, LevelPose, FloatArray]]) -> Deviations:
    times, offsets, sigmas = [], [], []
    for time, pose, covariance in poses:
        held = reference(time)
        if held is None:
            continue
        cos, sin = math.cos(held.yaw), math.sin(held.yaw)
        turn = np.array([[cos, sin, 0, 0], [-sin, cos, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1.0]])
        offset = turn @ (pose.as_array() - held.as_array())
        offset[3] = wrap_angle(float(pose.yaw - held.yaw))
        times.append(time)
        offsets.append(offset)
        sigmas.append(np.sqrt(np.maximum(np.diag(turn @ covariance @ turn.T), 0.0)))
    return Deviations(np.array(times), np.array(offsets).reshape(-1, 4), np.array(sigmas).reshape(-1, 4))


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
    figure = new_figure(_HEAD + max(len(blocks), 1) * block_height)
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
    if not any(track.against for track in tracks):
        return end
    return "true pose" if all(track.against for track in tracks) else f"true pose; without a pallet, minus {end}"


def _draw_block(
    figure: Figure, top: float, tracks: Sequence[TrackDeviations], columns: int, limits: Sequence[float]
) -> Axes:
    """Draw the tracks of one block; return axes that have every key."""
    width = (WIDTH_PX - _LEFT - _RIGHT - (columns - 1) * _GAP) / columns
    ends = [track.filtered.times[[0, -1]] for track in tracks if len(track.filtered.times)]
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
    shots = track.shots
    bars = 2 * shots.sigmas[:, axis] * scale
    axes.errorbar(
        shots.times,
        shots.offsets[:, axis] * scale,
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
    deviations: Deviations,
    axis: int,
    scale: float,
    color: str,
    line: str | tuple[float, tuple[float, ...]],
    label: str,
) -> None:
    values, wide = deviations.offsets[:, axis] * scale, 2 * deviations.sigmas[:, axis] * scale
    axes.fill_between(deviations.times, values - wide, values + wide, color=color, alpha=0.16, linewidth=0)
    axes.plot(deviations.times, values, color=color, linestyle=line, linewidth=1.9, label=label, zorder=3)


def _limit(tracks: Sequence[TrackDeviations], axis: int, scale: float) -> float:
    """Return up to where to draw: nearly all values and most of their bars; a single wide bar leaves the picture."""
    drawn = [deviations for track in tracks for deviations in (track.shots, track.filtered)]
    values = np.abs(np.concatenate([deviations.offsets[:, axis] for deviations in drawn])) * scale
    ends = values + 2 * np.concatenate([deviations.sigmas[:, axis] for deviations in drawn]) * scale
    if not len(values):
        return 1.0
    return 1.1 * max(float(np.quantile(values, 0.97)), float(np.quantile(ends, 0.8)), 1e-3)
