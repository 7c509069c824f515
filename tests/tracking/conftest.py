import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pytest

from benchmarks.approaches import MODEL, composed, seen_after
from palletloc.geometry import FloatArray, LevelPose, level_pose, wrap_angle
from palletloc.measurement import PalletMeasurement, YawSource
from tracking import Odometry, PalletTracker, PartialMeasurement, ShotTaken, TrackState
from tracking.config import TrackerConfig
from tracking.motion import Twist
from tracking.observation import Observation, observe
from tracking.tracker import Input

Stream = list[Input]
SIGMAS = np.array([0.01, 0.015, 0.005, 0.008])
ROW = (LevelPose(3.0, 2.0, 0.1, 1.5), LevelPose(4.3, 2.1, 0.1, 1.5), LevelPose(3.2, 2.0, 1.6, 1.6))


class Site:
    """Pallets in a row, a forklift that drives past them, and all that may happen to inputs."""

    def __init__(self, seed: int, pallets: Sequence[LevelPose] = ROW) -> None:
        self.rng = np.random.default_rng(seed)
        self.pallets = list(pallets)
        self.twist = Twist(0.5, 0.0, float(self.rng.uniform(-0.1, 0.1)))

    def forklift(self, time: float) -> LevelPose:
        """Return ``odom_from_forklift``."""
        return composed(LevelPose(0.0, 0.0, 0.0, 0.0), self.twist.after(time))

    def odometry(self, time: float) -> Odometry:
        """Return a sample without error."""
        return Odometry(time, self.forklift(time), self.twist)

    def truth(self, number: int, time: float) -> LevelPose:
        """Return ``forklift_from_pallet``."""
        return seen_after(self.pallets[number], self.twist.after(time))

    def measured(self, number: int, time: float, off: Sequence[float] = (0.0, 0.0, 0.0, 0.0)) -> PalletMeasurement:
        """Return a measurement with noise, and maybe off."""
        values = self.truth(number, time).as_array() + self.rng.normal(size=4) * SIGMAS + np.array(off)
        return measurement(time, LevelPose(*values.tolist()))

    def partly(self, number: int, time: float) -> PartialMeasurement:
        """Return the yaw alone, or the place alone."""
        whole = self.measured(number, time)
        names, picked = ((("yaw",), [3]), (("x", "y", "z"), [0, 1, 2]))[int(self.rng.integers(2))]
        return PartialMeasurement(
            time,
            MODEL,
            names,
            whole.forklift_from_pallet.as_array()[picked],
            whole.covariance[np.ix_(picked, picked)],
            whole.forklift_from_pallet,
        )

    def stream(self, duration: float, rate: int = 20, shots: float = 5.0) -> Stream:
        """Return inputs in the order of their times, with everything in them that the window has to put right."""
        rng = self.rng
        gap = rng.uniform(1.0, 2.0)
        inputs: Stream = [
            self.odometry(k / rate) for k in range(round(duration * rate)) if not gap < k / rate < gap + 0.45
        ]
        moved = rng.uniform(0.3, 0.7) * duration
        for k in range(round(duration * shots)):
            time = (k + rng.uniform(0.0, 0.5)) / shots
            inputs.append(ShotTaken(time))
            for number in range(len(self.pallets)):
                off = (0.3, 0.0, 0.0, 0.1) if number == 0 and time > moved else (0.0,) * 4
                kind = rng.choice(["whole", "part", "missed", "twice", "outlier"], p=[0.7, 0.12, 0.1, 0.04, 0.04])
                if kind == "part":
                    inputs.append(self.partly(number, time))
                elif kind != "missed":
                    off = tuple(np.add(off, 0.25 * rng.normal(size=4)).tolist()) if kind == "outlier" else off
                    inputs += [self.measured(number, time, off) for _ in range(1 + (kind == "twice"))]
            if rng.uniform() < 0.1:
                place = LevelPose(*rng.uniform([1.0, -4.0, 0.0, -3.0], [6.0, -1.0, 2.0, 3.0]).tolist())
                inputs.append(measurement(time, place))
        return sorted(inputs, key=lambda given: given.time)

    def late(self, inputs: Sequence[Input], most: float = 1.9) -> Stream:
        """Return inputs as they may arrive, none of them later than some time."""
        arrival = [given.time + self.rng.uniform(0.0, most) for given in inputs]
        return [inputs[i] for i in np.argsort(arrival, kind="stable")]


def measurement(
    time: float, pose: LevelPose, covariance: FloatArray | None = None, model: str = MODEL
) -> PalletMeasurement:
    """Return a measurement of a pallet."""
    given = np.diag(SIGMAS**2) if covariance is None else covariance
    return PalletMeasurement(time, model, pose, given, 0.9, YawSource.FACE)


@pytest.fixture
def make_measurement() -> Callable[..., PalletMeasurement]:
    return measurement


@pytest.fixture
def make_site() -> Callable[..., Site]:
    return Site


def plain(states: Sequence[TrackState]) -> FloatArray:
    """Return states as numbers, whatever the tracks' numbers are."""
    rows = [
        [*state.pose.as_array(), *state.covariance.ravel(), state.age, state.hits, state.nis, hash(state.status) % 97]
        for state in states
    ]
    return np.array(sorted(rows)).reshape(len(rows), -1)


@pytest.fixture
def same_states() -> Callable[[PalletTracker, PalletTracker, Sequence[float]], None]:
    """Return a check that two trackers believe the same at some times."""

    def check(one: PalletTracker, other: PalletTracker, times: Sequence[float]) -> None:
        assert one.newest == other.newest
        for time in times:
            np.testing.assert_allclose(plain(one.tracks(time)), plain(other.tracks(time)), rtol=0, atol=1e-9)

    return check


@pytest.fixture
def is_sound() -> Callable[[PalletTracker], None]:
    """Return a check that every state is finite and every covariance positive semidefinite."""

    def check(tracker: PalletTracker) -> None:
        for state in tracker.tracks():
            assert np.isfinite(state.pose.as_array()).all()
            assert math.isclose(wrap_angle(state.pose.yaw), state.pose.yaw)
            covariance = state.covariance
            np.testing.assert_array_equal(covariance, covariance.T)
            scale = np.sqrt(np.diag(covariance))
            assert (scale > 0).all()
            assert np.linalg.eigvalsh(covariance / np.outer(scale, scale))[0] > -1e-9

    return check


ODOMETRY_RATE = 50.0


@dataclass(frozen=True)
class Drive:
    odometry: list[Odometry]
    measurements: list[PalletMeasurement]
    truth: FloatArray
    """(measurements, 4) true forklift_from_pallet at the true exposure."""
    scale: float
    """Truth: how much longer ways are than odometry says."""
    bias: float
    """Truth: how much faster it turns than odometry says, in rad/s."""


Rates = Callable[[float], tuple[float, float]]


def drive(
    seed: int,
    rates: Rates,
    places: Sequence[LevelPose],
    duration: float = 20.0,
    every: float = 0.25,
    latency: float = 0.0,
    factor: float = 1.0,
) -> Drive:
    """Draw a drive; `factor` is how many times the stated covariance the true one of the measurements is."""
    config, rng, step = TrackerConfig(), np.random.default_rng(seed), 1 / ODOMETRY_RATE
    constants = config.odometry.constants * rng.standard_normal(2)
    true, paths = [LevelPose(0.0, 0.0, 0.0, 0.0)], [0.0]
    odometry = [Odometry(0.0, true[0])]
    for k in range(round(duration * ODOMETRY_RATE)):
        speed, turn = rates((k + 0.5) * step)
        motion = config.odometry.moved(Twist(speed, 0.0, turn), step)
        error = motion.constants @ constants + np.linalg.cholesky(motion.covariance) @ rng.standard_normal(3)
        true.append(composed(true[-1], motion.increment + error))
        paths.append(paths[-1] + motion.path)
        pose = odometry[-1].pose
        assert pose is not None
        odometry.append(Odometry((k + 1) * step, composed(pose, motion.increment)))
    covariance = np.diag([0.006, 0.006, 0.004, math.radians(0.25)]) ** 2
    found = Drive(odometry, [], np.zeros((0, 4)), *constants.tolist())
    truth, shared, before = [], rng.standard_normal((len(places), 4)), 0.0
    for k in np.round(np.arange(0.5, duration - 0.5, every) * ODOMETRY_RATE).astype(int).tolist():
        stays = math.exp((before - paths[k]) / config.errors.common_path_m)
        shared = stays * shared + math.sqrt(1 - stays**2) * rng.standard_normal(shared.shape)
        before = paths[k]
        for number, place in enumerate(places):
            there = level_pose(true[k].transform().inv() * place.transform())
            (split,) = observe([measurement(0.0, there, factor * covariance)], config.errors)
            assert isinstance(split, Observation)
            error = split.common @ shared[number] + np.linalg.cholesky(split.own) @ rng.standard_normal(4)
            seen = LevelPose(*(there.as_array() + error).tolist())
            found.measurements.append(measurement(k * step + latency, seen, covariance))
            truth.append(there.as_array())
    return replace(found, truth=np.array(truth))


@pytest.fixture(scope="session")
def draw_drive() -> Callable[..., Drive]:
    return drive
