"""A whole recording through the tracker: its measurements in, tracks over all shots out."""

from __future__ import annotations

from bisect import bisect
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from palletloc.errors import PalletLocError, nearest_name, seconds
from palletloc.geometry import LevelPose, level_pose
from palletloc.io.atomic import write_bytes
from palletloc.io.measurements import NoPose, read_measurements
from palletloc.io.recording import Recording, ShotFile
from palletloc.io.starts import TIME_TOLERANCE
from palletloc.io.tracks import TRACKS, TrackRow, write_tracks
from palletloc.measurement import PalletMeasurement
from palletloc.track_status import Status
from palletloc.trajectory import TrajectoryError
from tracking.config import TrackerConfig
from tracking.driven_path import DrivenPath
from tracking.events import Event, EventKind
from tracking.files import (
    EVENTS,
    FIGURE,
    PATHS,
    SMOOTHED_PATHS,
    SMOOTHED_TRACKS,
    PathPoint,
    remove_run,
    track_row,
    write_events,
    write_paths,
)
from tracking.observation import ShotTaken
from tracking.odometry import Odometry, samples_of
from tracking.smoother import SmoothedState, smoothed, smoothed_at
from tracking.streaming import RecordingSource
from tracking.tracker import PalletTracker


class UnknownShotError(PalletLocError):
    """Measurements that are not of the recording; names the file, the time and what was expected."""


class UselessInputError(PalletLocError):
    """A recording or measurements of which nothing can be used; names the folder and the first reason."""


@dataclass(frozen=True, slots=True, eq=False)
class ShotTracks:
    """What was known right after a shot, from all that had arrived until then."""

    shot: ShotFile
    """The shot."""
    rows: tuple[TrackRow, ...]
    """The live tracks at its time, in the order of their numbers."""
    odom_from_forklift: LevelPose | None
    """Where the forklift was by its odometry; None where that does not reach."""


def read_measured(path: Path, recording: Recording) -> tuple[PalletMeasurement, ...]:
    """Read the measurements of a recording's shots.

    Parameters
    ----------
    path : Path
        A measurements.csv.
    recording : Recording
        Gives the shots and the models.

    Returns
    -------
    tuple of PalletMeasurement
        With the times of the shots; rows without a pose are left out.

    Raises
    ------
    PalletLocError
        If the file cannot be read, a row is wrong, its time is that of no shot, or its model is not one of the
        recording's.
    """
    known = [model.name for model in recording.models]
    times = [shot.time for shot in recording.shots]
    measured = []
    for row in read_measurements(path):
        if row.model not in known:
            hint = nearest_name(row.model, known)
            raise UnknownShotError(f"{path}: at {row.time:.6g} s: unknown model {row.model!r}{hint}")
        after = bisect(times, row.time)
        nearest = min(times[max(after - 1, 0) : after + 1], key=lambda time: abs(time - row.time))
        if abs(nearest - row.time) > TIME_TOLERANCE:
            at, there = seconds(row.time, nearest)
            said = f"no shot at {at} s; the nearest is at {there} s"
            raise UnknownShotError(f"{path}: {said}; expected measurements of {recording.folder}")
        if not isinstance(row, NoPose):
            measured.append(replace(row, time=nearest))
    return tuple(measured)


@dataclass(frozen=True, slots=True, eq=False)
class TrackedRecording:
    """A recording with its tracks."""

    recording: Recording
    """The recording."""
    measured: tuple[PalletMeasurement, ...]
    """What they are made of."""
    shots: tuple[ShotTracks, ...]
    """The tracks shot by shot."""
    events: tuple[Event, ...]
    """What became of every measurement and track."""
    later: tuple[SmoothedState, ...] | None = None
    """What the smoother knows of the shots; None where it was not asked."""

    @property
    def rows(self) -> tuple[TrackRow, ...]:
        """The rows of tracks.csv."""
        return tuple(row for tracks in self.shots for row in tracks.rows)

    @property
    def smoothed_rows(self) -> tuple[TrackRow, ...]:
        """The rows of tracks_smoothed.csv: as every shot is known at the end, a track is believed from its begin."""
        if self.later is None:
            return ()
        believed = {state.number for state in self.later if state.track.confirmed}
        return tuple(_smoothed_row(state, state.number in believed) for state in self.later)

    @property
    def paths(self) -> tuple[PathPoint, ...]:
        """``odom_from_pallet`` of every row."""
        poses = {tracks.shot.time: tracks.odom_from_forklift for tracks in self.shots}
        return _points(self.rows, poses)

    @property
    def smoothed_paths(self) -> tuple[PathPoint, ...]:
        """``odom_from_pallet`` of every smoothed row."""
        poses = {tracks.shot.time: odometry_at(self.recording, tracks.shot.time) for tracks in self.shots}
        return _points(self.smoothed_rows, poses)


def track_recording(
    recording: Recording,
    measured: Sequence[PalletMeasurement],
    config: TrackerConfig | None = None,
    unread: Iterable[float] = (),
    *,
    smooth: bool = False,
    follow: Callable[[ShotTracks], object] | None = None,
) -> TrackedRecording:
    """Give a recording's odometry and measurements to a tracker in the order of time.

    Parameters
    ----------
    recording : Recording
        Gives shots, odometry and models; no image is read.
    measured : sequence of PalletMeasurement
        With the times of the shots.
    config : TrackerConfig, optional
        Parameters.
    unread : iterable of float
        Times of shots that could not be used, in seconds: their tracks count no miss.
    smooth : bool
        Whether to go back through it with all that is known at the end.
    follow : callable, optional
        Called after each shot.

    Returns
    -------
    TrackedRecording
        The tracks at each shot by what was known then, and by all that is known at the end.
    """
    tracker = PalletTracker(config, recording.models, keep_history=smooth)
    by_shot: dict[float, list[PalletMeasurement]] = {}
    for measurement in measured:
        by_shot.setdefault(measurement.time, []).append(measurement)
    skipped = set(unread)
    events: list[Event] = []
    shots: list[ShotTracks] = []
    for given in RecordingSource(recording):
        if isinstance(given, Odometry):
            events += _telling(tracker.push(given))
            continue
        time = given.time
        if time not in skipped:
            events += _telling(tracker.push([ShotTaken(time), *by_shot.get(time, ())]))
        rows = tuple(track_row(state) for state in tracker.tracks(time))
        shots.append(ShotTracks(ShotFile(time, given.file), rows, tracker.odom_from_forklift(time)))
        if follow is not None:
            follow(shots[-1])
    later = _later(recording, tracker) if smooth else None
    return TrackedRecording(recording, tuple(measured), tuple(shots), tuple(events), later)


def check_used(run: TrackedRecording) -> None:
    """Check that something of what a run was given could be used.

    Raises
    ------
    UselessInputError
        If no measurement began a track, or no odometry could be used; gives the first reason.
    """
    useless = (EventKind.REJECTED, EventKind.GATED, EventKind.TOO_LATE, EventKind.TIME_JUMP)
    reasons = [event.reason for event in run.events if event.kind in useless]
    used = any(event.kind is EventKind.ACCEPTED and event.track is not None for event in run.events)
    samples = len(run.recording.odometry.times)
    if run.measured and not used:
        what = f"none of {len(run.measured)} measurements"
    elif len(reasons) >= samples + len(run.measured):
        what = f"none of {samples} rows of odometry"
    else:
        return
    first = next(filter(None, reasons), "no odometry at its time")
    raise UselessInputError(f"{run.recording.folder}: {what} can be used; the first: {first}{_clocks(run.recording)}")


def _clocks(recording: Recording) -> str:
    """Return how far the times of shots and odometry are apart; nothing where they overlap."""
    shots, span = (recording.shots[0].time, recording.shots[-1].time), recording.odometry.span
    apart = max(span[0] - shots[1], shots[0] - span[1])
    if apart <= recording.odometry.margin:
        return ""
    first, last, begin, end = seconds(*shots, *span)
    return f"; shots are from {first} s to {last} s, odometry from {begin} s to {end} s: {apart:.12g} s apart"


def _telling(events: Iterable[Event]) -> Iterator[Event]:
    """Leave out that odometry and shots were taken, which goes without saying."""
    return (event for event in events if event.kind is not EventKind.ACCEPTED or event.track is not None)


def _later(recording: Recording, tracker: PalletTracker) -> tuple[SmoothedState, ...]:
    """Return the tracks at each shot by all that is known at the end."""
    config = tracker.config
    path = DrivenPath(config.odometry, config.path)
    for sample in samples_of(recording.odometry):
        path.put(sample)
    times = [shot.time for shot in recording.shots]
    return smoothed_at(times, smoothed(tracker.history()), path, config)


def _smoothed_row(smooth: SmoothedState, believed: bool) -> TrackRow:
    track = smooth.track
    status = Status.TENTATIVE
    if believed:
        status = Status.COASTING if track.misses else Status.CONFIRMED
    return TrackRow(
        smooth.time,
        smooth.number,
        track.model,
        status,
        smooth.pose,
        smooth.covariance,
        smooth.time - track.seen,
        track.hits,
    )


def odometry_at(recording: Recording, time: float) -> LevelPose | None:
    """Return ``odom_from_forklift`` by all of a recording's odometry; None where it does not reach."""
    try:
        return recording.odometry.pose_at(time)
    except TrajectoryError:
        return None


def _points(rows: Iterable[TrackRow], poses: Mapping[float, LevelPose | None]) -> tuple[PathPoint, ...]:
    points = []
    for row in rows:
        pose = poses.get(row.time)
        if pose is not None:
            placed = level_pose(pose.transform() * row.pose.transform())
            points.append(PathPoint(row.track, row.time, placed))
    return tuple(points)


def write_run(folder: Path, run: TrackedRecording, picture: bytes) -> None:
    """Write the tables, the paths and the picture of a run; those of an earlier run are removed first.

    Parameters
    ----------
    folder : Path
        Made if missing.
    run : TrackedRecording
        The tracks.
    picture : bytes
        Content of the PNG file.

    Raises
    ------
    OutputError
        If a file cannot be written. Each is whole or not there; tracks.csv comes last.
    """
    remove_run(folder)
    write_paths(folder / PATHS, run.paths)
    write_events(folder / EVENTS, run.events)
    write_bytes(folder / FIGURE, picture)
    if run.later is not None:
        write_paths(folder / SMOOTHED_PATHS, run.smoothed_paths)
        write_tracks(folder / SMOOTHED_TRACKS, run.smoothed_rows)
    write_tracks(folder / TRACKS, run.rows)
