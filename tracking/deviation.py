"""How single shots, filter and smoother stray from where a pallet is, over time: what the picture of a run shows."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from palletloc.evaluation.run_match import PAIRING_DISTANCE
from palletloc.geometry import FloatArray, LevelPose, level_pose, wrap_angle
from palletloc.io.tracks import TrackRow
from palletloc.io.truth import TruePallet, Truth
from palletloc.measurement import PalletMeasurement
from palletloc.track_status import Status
from palletloc.trajectory import TrajectoryError
from tracking.offline import TrackedRecording, odometry_at

Reference = Callable[[float], LevelPose | None]
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
    confirmed = (number for number in sorted(rows) if any(one.status is not Status.TENTATIVE for one in rows[number]))
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
    rows = {one.shot.time: one.rows for one in run.shots}
    by_track: dict[int, list[PalletMeasurement]] = {}
    for one in run.measured:
        apart = {row.track: _apart(row.pose, one.forklift_from_pallet) for row in rows.get(one.time, ())}
        nearest = min(apart, key=lambda number: apart[number], default=None)
        if nearest is not None and apart[nearest] < PAIRING_DISTANCE:
            by_track.setdefault(nearest, []).append(one)
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
        _against(reference, [(one.time, one.forklift_from_pallet, one.covariance) for one in near]),
        _against(reference, [(row.time, row.pose, row.covariance) for row in rows]),
        _against(reference, [(row.time, row.pose, row.covariance) for row in later]) if later else None,
    )


def _true_pallet(rows: Iterable[TrackRow], truth: Truth) -> TruePallet | None:
    """Return the true pallet that most rows of a track are nearest to."""
    votes: Counter[str] = Counter()
    pallets = {pallet.id: pallet for pallet in truth.pallets}
    for row in rows:
        poses = {name: _by_truth(truth, pallet)(row.time) for name, pallet in pallets.items()}
        apart = {name: _apart(pose, row.pose) for name, pose in poses.items() if pose is not None}
        nearest = min(apart, key=lambda name: apart[name], default=None)
        if nearest is not None and apart[nearest] < PAIRING_DISTANCE:
            votes[nearest] += 1
    return pallets[votes.most_common(1)[0][0]] if votes else None


def _by_truth(truth: Truth, pallet: TruePallet) -> Reference:
    def at(time: float) -> LevelPose | None:
        try:
            world_from_forklift = truth.forklift.pose_at(time)
        except TrajectoryError:
            return None
        return level_pose(world_from_forklift.transform().inv() * pallet.world_from_pallet.transform())

    return at


def _by_end(end: TrackRow, run: TrackedRecording) -> Reference:
    """Return where odometry carries the end of a track back to."""
    last = odometry_at(run.recording, end.time)

    def at(time: float) -> LevelPose | None:
        pose = odometry_at(run.recording, time)
        if last is None or pose is None:
            return None
        return level_pose(pose.transform().inv() * last.transform() * end.pose.transform())

    return at


def _apart(one: LevelPose, other: LevelPose) -> float:
    return math.dist((one.x, one.y, one.z), (other.x, other.y, other.z))


def _against(reference: Reference, poses: Sequence[tuple[float, LevelPose, FloatArray]]) -> Deviations:
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
