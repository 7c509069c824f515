"""Simulated drives past pallets, with the errors that the tracker's parameters state."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import pytest

from palletloc.geometry import FloatArray, LevelPose, wrap_angle
from palletloc.measurement import PalletMeasurement, YawSource
from tracking import Odometry
from tracking.config import MeasurementErrors, TrackerConfig
from tracking.motion import Twist

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
