"""What tracking costs: CPU time of one thread."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import count

import numpy as np

from benchmarks.approaches import MODEL, Drive, simulate
from benchmarks.stopwatch import take_turns
from benchmarks.tables import Column, Section
from palletloc.geometry import LevelPose
from palletloc.measurement import PalletMeasurement, YawSource
from tracking import Odometry, OdometryNoise, PalletTracker, TrackerConfig, Twist
from tracking.filter import GroupFilter
from tracking.gating import Association
from tracking.observation import Observation, observe
from tracking.state import Key, members_of, regrouped

REPEATS = 100
"""How many steps a filter does in one turn."""
GROUP = TrackerConfig().tracks_together
"""Tracks of a group."""
PALLETS, SHOTS, SAMPLES = 50, 30, 50
"""Tracks, shots and samples of odometry per second."""
LATE = 0.1
"""How long a shot's measurements take, in seconds."""
SIGMAS = np.array([0.01, 0.01, 0.005, 0.01])
"""Standard deviations of their noise, in metres and radians."""

_COLUMNS = (Column("what"), Column("median", 2), Column("unit"), Column("goal", 0))


def measure_tracking(rounds: int) -> list[Section]:
    """Measure how long the tracker takes.

    Parameters
    ----------
    rounds : int
        How often everything is timed.

    Returns
    -------
    list of Section
        One table.
    """
    timings = take_turns(
        {
            "alone": _steps(1),
            "group": _steps(GROUP),
            "groups": _steps(PALLETS),
            "replay": _replay(),
            "shot by shot": _fleet(rounds + 1, together=True),
            "one by one": _fleet(rounds + 1, together=False),
        },
        rounds,
    )
    per_track = {name: 1e6 * timings.median(name) / REPEATS for name in ("alone", "group", "groups")}
    rows = (
        ("predict, gate and update a track alone", per_track["alone"], "us per track", 60.0),
        (f"the same of {GROUP} in a group", per_track["group"] / GROUP, "us per track", 60.0),
        (f"the same of {PALLETS} in groups", per_track["groups"] / PALLETS, "us per track", 60.0),
        ("replay of 2 s: 100 samples of odometry, 20 shots", 1e3 * timings.median("replay"), "ms", 3.0),
        (f"{PALLETS} tracks at {SHOTS} Hz, shot by shot", 100 * timings.median("shot by shot"), "% of a core", 15.0),
        (f"{PALLETS} tracks at {SHOTS} Hz, one by one", 100 * timings.median("one by one"), "% of a core", None),
    )
    return [Section("Tracking", _COLUMNS, rows, f"CPU time in one thread; medians of {rounds} rounds.")]


def _steps(tracks: int) -> Callable[[], object]:
    """Return steps of tracks in groups, one after the other: a motion, the gate, and an update each."""
    config = TrackerConfig()
    group_filter, motion, observation = (
        GroupFilter(config),
        OdometryNoise().moved(Twist(0.5, 0.0, 0.1), 0.033),
        _seen(),
    )
    began = [(Key(0.0, str(number)), group_filter.begin(observation)) for number in range(tracks)]
    groups = regrouped((), began, {key for key, _ in began}, config.tracks_together)
    hits = [[(member, Association(observation)) for member in range(len(group.keys))] for group in groups]

    def once() -> object:
        states = [group.state for group in groups]
        for _ in range(REPEATS):
            states = group_filter.predict(states, motion)
            for state in states:
                for member in members_of(state):
                    group_filter.innovation(member, observation)
            states = [group_filter.update(*pair) for pair in zip(states, hits, strict=True)]
        return states

    return once


def _seen() -> Observation:
    (found,) = observe([_measurement(0.0, np.array([3.0, 2.0, 0.0, 1.5]))], TrackerConfig().errors)
    if not isinstance(found, Observation):
        raise found
    return found


def _replay() -> Callable[[], object]:
    """Return doing the steps of 2 s again after the oldest sample of odometry has changed."""
    drive = Drive(duration=1.99, speed=0.5, rate=50, shot_every=5)
    approach = simulate(np.random.default_rng(0), TrackerConfig(), drive)
    tracker = PalletTracker()
    tracker.push([*approach.odometry, *approach.measurements])
    changes = count(1)

    def once() -> object:
        # of two samples of the same time the one that is ahead is kept
        return tracker.push(Odometry(approach.odometry[0].time, LevelPose(1e-9 * next(changes), 0.0, 0.0, 0.0)))

    return once


def _fleet(seconds: int, together: bool) -> Callable[[], object]:
    """Return following many pallets for a second, the next one at each call; the first ones are driven before."""
    stream = _arrivals(np.random.default_rng(0))
    tracker = PalletTracker()

    def drive(batches: list[list[Odometry | PalletMeasurement]]) -> object:
        for batch in batches:
            if together:
                tracker.push(batch)
            else:
                for given in batch:
                    tracker.push(given)
        return tracker.tracks()

    drive(next(stream))
    following = iter([next(stream) for _ in range(seconds)])
    return lambda: drive(next(following))


def _arrivals(rng: np.random.Generator) -> Iterator[list[list[Odometry | PalletMeasurement]]]:
    """Yield what arrives in each second: shelves full of pallets, passed at a walking pace."""
    for second in count():
        found: list[tuple[float, list[Odometry | PalletMeasurement]]] = []
        for k in range(SAMPLES):
            time = second + k / SAMPLES
            found.append((time, [Odometry(time, LevelPose(0.3 * time, 0.0, 0.0, 0.0))]))
        for k in range(SHOTS):
            time = second + (k + 0.1) / SHOTS
            found.append(
                (
                    time + LATE,
                    [_measurement(time, _place(i, time) + SIGMAS * rng.normal(size=4)) for i in range(PALLETS)],
                )
            )
        yield [batch for _, batch in sorted(found, key=lambda arrival: arrival[0])]


def _place(number: int, time: float) -> np.ndarray:
    return np.array([number % 10 * 1.3 - 0.3 * time, 2.0, number // 10 * 1.5, 1.57])


def _measurement(time: float, values: np.ndarray) -> PalletMeasurement:
    pose = LevelPose(*values.tolist())
    return PalletMeasurement(time, MODEL, pose, np.diag(SIGMAS**2), 0.9, YawSource.FACE)
