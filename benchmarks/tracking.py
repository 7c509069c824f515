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
from tracking.belief import Belief, Rules
from tracking.config import TrackerConfig
from tracking.filter import PalletFilter
from tracking.footprint import Footprints
from tracking.joint import regrouped
from tracking.joint_filter import JointFilter, Seen
from tracking.motion import Motion, Twist
from tracking.observation import Observation, observe
from tracking.odometry import Odometry, OdometryNoise
from tracking.replay import Look, Replay
from tracking.track import Key
from tracking.tracker import PalletTracker

REPEATS = 100
"""How many steps a filter does in one turn."""
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
            "step": _steps(1),
            "steps": _steps(PALLETS),
            "joint": _joint_steps(PALLETS),
            "replay": _replay(),
            "together": _fleet(rounds + 1, together=True),
            "alone": _fleet(rounds + 1, together=False),
        },
        rounds,
    )
    rows = (
        ("predict, gate and update a track alone", 1e6 * timings.median("step") / REPEATS, "us per track", 60.0),
        (f"the same of {PALLETS} at once", 1e6 * timings.median("steps") / REPEATS / PALLETS, "us per track", 60.0),
        (
            f"the same of {PALLETS}, which share estimates",
            1e6 * timings.median("joint") / REPEATS / PALLETS,
            "us per track",
            60.0,
        ),
        ("replay of 2 s: 100 samples of odometry, 20 shots", 1e3 * timings.median("replay"), "ms", 3.0),
        (f"{PALLETS} tracks at {SHOTS} Hz, shot by shot", 100 * timings.median("together"), "% of a core", 15.0),
        (f"{PALLETS} tracks at {SHOTS} Hz, one by one", 100 * timings.median("alone"), "% of a core", None),
    )
    return [Section("Tracking", _COLUMNS, rows, f"CPU time in one thread; medians of {rounds} rounds.")]


def _steps(tracks: int) -> Callable[[], object]:
    """Return steps of a filter's tracks, one after the other: a motion, the gate, and an update each."""
    engine, motion, one = PalletFilter(TrackerConfig()), _motion(), _observation()
    seen, ones = [one] * tracks, [1.0] * tracks

    def once() -> object:
        states = [engine.begin(one)] * tracks
        for _ in range(REPEATS):
            states = [it.state for it in engine.predicted(states, motion)]
            engine.innovations(states, seen, ones)
            states = engine.updates(states, seen, ones, ones)
        return states

    return once


def _joint_steps(tracks: int) -> Callable[[], object]:
    """Return the same of tracks that share estimates."""
    config = TrackerConfig()
    engine, motion, one = PalletFilter(config), _motion(), _observation()
    together = JointFilter(engine)
    began = [(Key(0.0, str(number)), engine.begin(one)) for number in range(tracks)]
    start = regrouped((), began, {key for key, _ in began}, config.tracks_together)
    seen = [[Seen(member, one) for member in range(len(joint.keys))] for joint in start]
    every, ones = [one] * tracks, [1.0] * tracks

    def once() -> object:
        joints = start
        for _ in range(REPEATS):
            joints = together.predicted(joints, motion)
            engine.innovations([state for joint in joints for state in joint.members], every, ones)
            joints = together.updated(joints, seen)
        return joints

    return once


def _motion() -> Motion:
    return OdometryNoise().moved(Twist(0.5, 0.0, 0.1), 0.033)


def _observation() -> Observation:
    (one,) = observe([_measurement(0.0, np.array([3.0, 2.0, 0.0, 1.5]))], TrackerConfig().errors)
    if not isinstance(one, Observation):
        raise one
    return one


def _replay() -> Callable[[], object]:
    """Return doing the steps of 2 s again after the oldest sample of odometry has changed."""
    config = TrackerConfig()
    drive = Drive(duration=1.99, speed=0.5, rate=50, shot_every=5)
    approach = simulate(np.random.default_rng(0), config, drive)
    replay = Replay(Rules(config, PalletFilter(config), Footprints()), Belief())
    for sample in approach.odometry:
        replay.path.put(sample)
    for one in observe(approach.measurements, config.errors):
        if isinstance(one, Observation):
            replay.place(Look(one.time, (one,)))
    replay.run()

    def once() -> object:
        replay.path.put(approach.odometry[0])
        return replay.run(-1.0)

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
                for one in batch:
                    tracker.push(one)
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
        yield [batch for _, batch in sorted(found, key=lambda one: one[0])]


def _place(number: int, time: float) -> np.ndarray:
    return np.array([number % 10 * 1.3 - 0.3 * time, 2.0, number // 10 * 1.5, 1.57])


def _measurement(time: float, values: np.ndarray) -> PalletMeasurement:
    pose = LevelPose(*values.tolist())
    return PalletMeasurement(time, MODEL, pose, np.diag(SIGMAS**2), 0.9, YawSource.FACE)
