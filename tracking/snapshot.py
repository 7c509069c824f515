"""A tracker's memory as plain values that JSON knows, for a restart without loss.

Kept is what was believed before the window and every input inside it; the steps in between are done again. The frozen
values themselves are walked by their annotations, so their fields are the form of a snapshot.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from palletloc.measurement import PalletMeasurement
from palletloc.track_status import Status
from tracking.belief import Belief, UpdateModel
from tracking.config import TrackerConfig
from tracking.event_log import EventLog, Outcome, TrackNumbers
from tracking.latency import TRIALS, LatencyWatch
from tracking.observation import Observation, PartialMeasurement, ShotTaken, observe
from tracking.odometry import Odometry, check_odometry
from tracking.plain_values import SnapshotError, fault, plain_values, shown, value_of
from tracking.shot_stack import LatencyShot
from tracking.state import OWN, Gaussian, Key, TrackGroup, size_of
from tracking.track import RECALL, Track
from tracking.validation import BadInputError
from tracking.window import Clock, Window

VERSION = 4
"""Of the form; another one is refused."""
LEAST_CORRELATION = -1e-6
"""Smallest eigenvalue of the correlations of a state: rounding leaves less than that below zero."""

Measured = PalletMeasurement | PartialMeasurement
"""A measurement."""
Ready = Odometry | Observation | ShotTaken
"""An input that was checked."""


@dataclass(frozen=True, slots=True, eq=False)
class Memory:
    """All that a tracker remembers."""

    version: int
    """Of this form."""
    config: TrackerConfig
    """Parameters."""
    newest: float | None
    """Newest time, in seconds; None before any input."""
    elsewhere: tuple[float, ...]
    """Times of the last inputs that were not in time."""
    time: float | None
    """Of what is believed before the window, in seconds."""
    tracks: tuple[Track, ...]
    """The tracks then."""
    groups: tuple[TrackGroup, ...]
    """What was known of them together."""
    ended: tuple[tuple[Key, str], ...]
    """Tracks that had ended then, and why."""
    odometry: tuple[Odometry, ...]
    """Samples of the window, in the order of their times."""
    shots: tuple[tuple[float, tuple[Measured, ...]], ...]
    """Times and measurements of its shots."""
    held: tuple[Odometry | PalletMeasurement | PartialMeasurement | ShotTaken, ...]
    """Inputs from another time."""
    numbers: tuple[tuple[Key, int], ...]
    """Numbers of tracks."""
    following: int
    """The next number."""
    dispositions: tuple[tuple[tuple[float, str], Outcome], ...]
    """What was reported of the measurements."""
    statuses: tuple[tuple[int, Status], ...]
    """What was reported of the tracks."""
    renewed: tuple[tuple[float, int], ...]
    """Tracks that were reported to begin anew."""
    latency_since: int
    """Shots since the last estimate of the latency."""
    latency_reported: float | None
    """The latency that was reported last, in seconds."""
    latency_shots: tuple[LatencyShot, ...]
    """Shots for its estimate."""


class Parts(NamedTuple):
    """What a tracker consists of."""

    clock: Clock
    """Its time."""
    window: Window
    """Inputs and beliefs."""
    log: EventLog
    """What it has reported."""
    latency: LatencyWatch
    """What it knows of the camera's latency."""
    held: list[Ready]
    """Checked inputs from another time."""


def written(config: TrackerConfig, parts: Parts) -> dict[str, Any]:
    """Return a tracker's memory as plain values."""
    clock, window, log, latency, held = parts
    base = window.base
    memory = Memory(
        version=VERSION,
        config=config,
        newest=clock.newest if math.isfinite(clock.newest) else None,
        elsewhere=tuple(clock.elsewhere),
        time=base.time,
        tracks=base.tracks,
        groups=tuple(TrackGroup(group.keys, group.state) for group in base.groups),
        ended=base.ended,
        odometry=tuple(window.path),
        shots=tuple((shot.time, tuple(each.source for each in shot.observations)) for shot in window.shots),
        held=tuple(each.source if isinstance(each, Observation) else each for each in held),
        numbers=tuple(log.numbering.numbers.items()),
        following=log.numbering.following,
        dispositions=tuple(log.dispositions.items()),
        statuses=tuple(log.statuses.items()),
        renewed=tuple(sorted(log.renewed)),
        latency_since=latency.since,
        latency_reported=latency.reported,
        latency_shots=tuple(latency.shots),
    )
    plain: dict[str, Any] = plain_values(memory)
    return plain


def restored(memory: Memory, model: UpdateModel) -> Parts:
    """Return the parts of a tracker with what an earlier one remembered; the steps of the window are done again.

    Raises
    ------
    SnapshotError
        If an input in it cannot be used, or a track has no number.
    """
    clock, log, latency = Clock(model.config.window), EventLog(model.config.life), LatencyWatch(model.config)
    clock.newest = -math.inf if memory.newest is None else memory.newest
    clock.elsewhere = list(memory.elsewhere)
    window = Window(model, Belief(memory.time, memory.tracks, memory.groups, ended=memory.ended))
    try:
        for sample in memory.odometry:
            window.path.put(check_odometry(sample))
        for time, measurements in memory.shots:
            window.place(time)
            for observation in _observations(measurements, model.config):
                window.place(time, observation)
        held = [_ready(given, model.config) for given in memory.held]
        window.run()
    except BadInputError as error:
        raise fault("", str(error)) from None
    except (ArithmeticError, ValueError) as error:  # parameters or numbers that are beyond reason together
        raise fault("shots", f"their steps cannot be done again: {error}") from None
    log.numbering = TrackNumbers(dict(memory.numbers), memory.following)
    log.dispositions, log.statuses = dict(memory.dispositions), dict(memory.statuses)
    log.renewed = set(memory.renewed)
    latency.since, latency.reported, latency.shots = (
        memory.latency_since,
        memory.latency_reported,
        list(memory.latency_shots),
    )
    believed = {track.key for belief in (window.base, *window.beliefs) for track in belief.tracks}
    if not believed <= log.numbering.numbers.keys():
        raise fault("numbers", "expected a number for every track")
    return Parts(clock, window, log, latency, held)


def _observations(measurements: Sequence[Measured], config: TrackerConfig) -> tuple[Observation, ...]:
    """Return measurements ready for the filter, in their order."""
    found = observe(measurements, config.errors)
    for each in found:
        if isinstance(each, BadInputError):
            raise each
    ready = [each for each in found if isinstance(each, Observation)]
    return tuple(sorted(ready, key=lambda observation: observation.order))


def _ready(given: Odometry | Measured | ShotTaken, config: TrackerConfig) -> Ready:
    if isinstance(given, Odometry):
        return check_odometry(given)
    return given if isinstance(given, ShotTaken) else _observations([given], config)[0]


def read_memory(snapshot: Mapping[str, Any]) -> Memory:
    """Return the memory that a snapshot holds.

    Raises
    ------
    SnapshotError
        If it is malformed, of another version, has other parameters than this one knows, or states what no tracker
        can have believed; names the place.
    """
    try:
        plain = dict(snapshot)
    except (TypeError, ValueError):
        raise SnapshotError(f"snapshot: expected a mapping, got {type(snapshot).__name__}") from None
    version = plain.get("version")
    if type(version) is not int or version != VERSION:
        raise SnapshotError(f"snapshot: version: expected {VERSION}, got {shown(version)}")
    memory: Memory = value_of(Memory, plain, "")
    _check_unique(memory)
    _check_belief(memory)
    _check_times(memory)
    for i, shot in enumerate(memory.latency_shots):
        _check_latency_shot(shot, f"latency_shots.{i}")
    return memory


def _check_belief(memory: Memory) -> None:
    """Raise where what was believed before the window does not fit together."""
    keys = [key for group in memory.groups for key in group.keys]
    if sorted(keys) != sorted(track.key for track in memory.tracks):
        raise fault("groups", "expected every track in one of them")
    known: dict[Key, Gaussian] = {}
    for i, group in enumerate(memory.groups):
        if not group.keys:
            raise fault(f"groups.{i}.keys", "expected at least one track")
        _check_state(group.state, len(group.keys), f"groups.{i}.state")
        if group.predicted is not None or group.carried:
            raise fault(f"groups.{i}.predicted", "expected none, for the prediction is past")
        known |= group.members
    for i, track in enumerate(memory.tracks):
        _check_state(track.state, 1, f"tracks.{i}.state")
        if not _own_part_agrees(track.state, known[track.key]):
            raise fault(f"tracks.{i}.state", "expected what its group knows of the pallet")
        _check_counts(track, memory.time, f"tracks.{i}")
        for j, series in enumerate(track.rejected):
            _check_state(series.state, 1, f"tracks.{i}.rejected.{j}.state")


def _check_counts(track: Track, time: float | None, place: str) -> None:
    """Raise where a track has counts or times that no track can have."""
    if min(track.hits, *(series.hits for series in track.rejected), track.hits) < 1:
        raise fault(f"{place}.hits", "expected at least one measurement")
    for j, series in enumerate(track.rejected):
        if not (
            0 <= series.row <= series.hits and series.idle >= 0 and -RECALL <= series.lead <= series.hits + RECALL
        ):
            raise fault(f"{place}.rejected.{j}", "expected counts that belong together")
    if track.misses < 0:
        raise fault(f"{place}.misses", f"expected none or more, got {track.misses}")
    if time is not None and track.seen > time:
        raise fault(
            f"{place}.seen", f"expected a time up to that of the belief, {time:.6g} s, got {track.seen:.6g} s"
        )
    if not track.model:
        raise fault(f"{place}.model", "expected the name of a pallet model")
    for name, values in (("nis", () if track.nis is None else (track.nis,)), ("ratios", track.ratios)):
        if min(values, default=0.0) < 0:
            raise fault(f"{place}.{name}", "expected squares, which are not negative")


def _check_unique(memory: Memory) -> None:
    """Raise where something is named twice that is there once."""
    numbers = dict(memory.numbers)  # a late first measurement renames a track: the former key keeps its number, too
    named: dict[str, list[object]] = {
        "tracks": [track.key for track in memory.tracks],
        "numbers": [key for key, _ in memory.numbers],
        "numbers of tracks": [numbers[track.key] for track in memory.tracks if track.key in numbers],
        "ended": [key for key, _ in memory.ended],
        "statuses": [number for number, _ in memory.statuses],
        "dispositions": [key for key, _ in memory.dispositions],
    }
    for name, values in named.items():
        if len(set(values)) < len(values):
            raise fault(name, "expected each one once")


def _check_times(memory: Memory) -> None:
    """Raise where times do not fit to each other, or numbers of tracks to the next one."""
    horizon = -math.inf if memory.newest is None else memory.newest - memory.config.window.window_s
    if memory.tracks and memory.time is None:
        raise fault("time", "expected a time, for there are tracks")
    if memory.time is not None and not memory.time <= horizon:
        raise fault("time", f"expected one before the window, which begins at {horizon:.6g} s, got {memory.time:.6g}")
    shots, samples = [time for time, _ in memory.shots], [sample.time for sample in memory.odometry]
    for name, times in (("shots", shots), ("odometry", samples)):
        if any(not earlier < later for earlier, later in pairwise(times)):
            raise fault(name, "expected them in the order of their times")
        if times and (memory.newest is None or times[-1] > memory.newest):
            raise fault(name, f"expected none after the newest time, {memory.newest}")
    if shots and memory.time is not None and shots[0] <= memory.time:
        raise fault("shots", f"expected them after what is believed before them, at {memory.time:.6g} s")
    if memory.latency_since < 0:
        raise fault("latency_since", f"expected none or more shots, got {memory.latency_since}")
    numbers = [number for _, number in memory.numbers]
    if min(numbers, default=1) < 1 or memory.following <= max(numbers, default=0):
        raise fault("following", f"expected more than all numbers, which are positive, got {memory.following}")


def _own_part_agrees(state: Gaussian, member: Gaussian) -> bool:
    """Tell whether two states agree in all but the odometry's constants: those a new track gets from its group."""
    own = np.ix_(OWN, OWN)
    means_agree = np.array_equal(state.mean[OWN], member.mean[OWN])
    return means_agree and np.array_equal(state.covariance[own], member.covariance[own])


def _check_state(state: Gaussian, count: int, place: str) -> None:
    """Raise where a state is not one of so many pallets, or its covariance is none."""
    size = size_of(count)
    if state.mean.shape != (size,) or state.covariance.shape != (size, size):
        raise fault(place, f"expected {size} numbers and their covariance for {count} tracks")
    variances = state.covariance.diagonal()
    scale = np.sqrt(np.where(variances > 0, variances, 1.0))
    correlations = state.covariance / scale / scale[:, None]
    if not np.array_equal(state.covariance, state.covariance.T):
        raise fault(f"{place}.covariance", "expected a symmetric matrix")
    if variances.min() < 0 or np.linalg.eigvalsh(correlations)[0] < LEAST_CORRELATION:
        raise fault(f"{place}.covariance", "expected a positive semidefinite matrix")


def _check_latency_shot(shot: LatencyShot, place: str) -> None:
    """Raise where arrays have other shapes than the estimate of the latency takes."""
    motion = shot.motion
    shapes = [(motion.increment, (3,)), (motion.covariance, (3, 3)), (motion.constants, (3, 2))]
    shapes += [(shot.around, (TRIALS, 3)), (shot.jitter, (3, 3))]
    for sighting in (*shot.sightings, *shot.rejected):
        shapes += [(sighting.pose, (3,)), (sighting.own, (3, 3)), (sighting.common, (3, 4))]
    for array, shape in shapes:
        if array.shape != shape:
            raise fault(place, f"expected an array of shape {shape}, got {array.shape}")
