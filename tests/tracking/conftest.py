from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import pytest

from benchmarks.approaches import MODEL, composed, seen_after
from palletloc.geometry import FloatArray, LevelPose, wrap_angle
from palletloc.measurement import PalletMeasurement, YawSource
from tracking import Odometry, PalletTracker, PartialMeasurement, ShotTaken, TrackState
from tracking.config import MeasurementErrors, TrackerConfig
from tracking.motion import Twist
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
FINE = 2


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
    numbers: list[int]
    """Which pallet each measurement is of."""


Rates = Callable[[float], tuple[float, float]]


def true_poses(rates: Rates, times: FloatArray) -> FloatArray:
    poses = np.zeros((len(times), 3))
    for i in range(1, len(times)):
        step = times[i] - times[i - 1]
        speed, turn = rates(times[i - 1] + step / 2)
        dx, dy, angle = Twist(speed, 0.0, turn).after(step)
        x, y, yaw = poses[i - 1]
        cos, sin = math.cos(yaw), math.sin(yaw)
        poses[i] = [x + cos * dx - sin * dy, y + sin * dx + cos * dy, yaw + angle]
    return poses


def sampled_odometry(
    config: TrackerConfig, times: FloatArray, poses: FloatArray, constants: FloatArray, rng: np.random.Generator
) -> list[Odometry]:
    noise, measured = config.odometry, np.zeros(3)
    samples = [Odometry(float(times[0]), LevelPose(0.0, 0.0, 0.0, 0.0))]
    for (x0, y0, a0), (x, y, a), step in zip(poses[:-1], poses[1:], np.diff(times), strict=True):
        cos, sin = math.cos(a0), math.sin(a0)
        way = np.array([cos * (x - x0) + sin * (y - y0), cos * (y - y0) - sin * (x - x0), a - a0])
        path = math.hypot(way[0], way[1])
        sigmas = np.sqrt(
            [
                (1e-3 * noise.distance_mm_per_sqrt_m) ** 2 * path + (1e-3 * noise.speed_mm_per_sqrt_s) ** 2 * step,
                (1e-3 * noise.slip_mm_per_sqrt_m) ** 2 * path,
                math.radians(noise.gyro_random_walk_deg_per_sqrt_s) ** 2 * step
                + math.radians(noise.turn_deg_per_sqrt_turn) ** 2 * abs(way[2]) / (2 * math.pi),
            ]
        )
        way[:2] /= 1 + constants[0]
        way[2] -= constants[1] * step
        way += sigmas * rng.standard_normal(3) * (path > 0)
        cos, sin = math.cos(measured[2]), math.sin(measured[2])
        measured = measured + np.array([cos * way[0] - sin * way[1], sin * way[0] + cos * way[1], way[2]])
        time = float(times[len(samples)])
        samples.append(Odometry(time, LevelPose(measured[0], measured[1], 0.0, wrap_angle(float(measured[2])))))
    return samples


@dataclass
class _Sighted:
    place: LevelPose
    path: float = -math.inf
    shared: FloatArray | None = None


def _error(
    covariance: FloatArray,
    pallet: _Sighted,
    path: float,
    yaw: float,
    errors: MeasurementErrors,
    rng: np.random.Generator,
) -> FloatArray:
    """Draw an error of a diagonal covariance, alike in x and y; a part of it stays along the pallet's axes."""
    variances = np.diag(covariance)
    limits = np.array([errors.common_position_m] * 3 + [math.radians(errors.common_yaw_deg)]) ** 2
    common = np.minimum(limits, errors.max_common_share * variances)
    fresh = rng.standard_normal(4)
    stays = 0.0 if pallet.shared is None else math.exp((pallet.path - path) / errors.common_path_m)
    before = np.zeros(4) if pallet.shared is None else pallet.shared
    pallet.shared, pallet.path = stays * before + math.sqrt(1 - stays**2) * fresh, path
    along = np.sqrt(common) * pallet.shared
    cos, sin = math.cos(yaw), math.sin(yaw)
    along[:2] = cos * along[0] - sin * along[1], sin * along[0] + cos * along[1]
    return np.asarray(along + np.sqrt(variances - common) * rng.standard_normal(4))


def drive(
    seed: int,
    rates: Rates,
    places: Sequence[LevelPose],
    duration: float = 20.0,
    every: float = 0.25,
    latency: float = 0.0,
    config: TrackerConfig | None = None,
    factor: float = 1.0,
) -> Drive:
    """Draw a drive; `factor` is how many times the stated covariance the true one of the measurements is."""
    config = config or TrackerConfig()
    rng = np.random.default_rng(seed)
    constants = config.odometry.constants * rng.standard_normal(2)
    fine = np.arange(round(duration * ODOMETRY_RATE) * FINE + 1) / (ODOMETRY_RATE * FINE)
    poses = true_poses(rates, fine)
    odometry = sampled_odometry(config, fine[::FINE], poses[::FINE], constants, rng)
    paths = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(poses[:, :2], axis=0).T))])
    pallets = [_Sighted(place) for place in places]
    covariance = np.diag([0.006, 0.006, 0.004, math.radians(0.25)]) ** 2
    measurements, truth, numbers = [], [], []
    for exposed in np.arange(0.5, duration - 0.5, every):
        x, y, yaw = (float(np.interp(exposed, fine, column)) for column in poses.T)
        path = float(np.interp(exposed, fine, paths))
        for number, pallet in enumerate(pallets):
            cos, sin = math.cos(yaw), math.sin(yaw)
            away = pallet.place.x - x, pallet.place.y - y
            true = np.array(
                [
                    cos * away[0] + sin * away[1],
                    cos * away[1] - sin * away[0],
                    pallet.place.z,
                    wrap_angle(pallet.place.yaw - yaw),
                ]
            )
            error = _error(factor * covariance, pallet, path, float(true[3]), config.errors, rng)
            px, py, pz, heading = true + error
            pose = LevelPose(float(px), float(py), float(pz), wrap_angle(float(heading)))
            stamp = float(exposed + latency)
            stated = PalletMeasurement(stamp, "epal1-1200", pose, covariance, 0.9, YawSource.FACE)
            measurements.append(stated)
            truth.append(true)
            numbers.append(number)
    return Drive(odometry, measurements, np.array(truth), float(constants[0]), float(constants[1]), numbers)


@pytest.fixture(scope="session")
def draw_drive() -> Callable[..., Drive]:
    return drive
