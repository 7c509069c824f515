"""Simulated approaches: odometry and measurements that err just as the tracker's model says."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from palletloc.geometry import FloatArray, LevelPose, wrap_angle
from palletloc.measurement import PalletMeasurement, YawSource
from tracking.config import TrackerConfig
from tracking.motion import Twist
from tracking.observation import Observation, observe
from tracking.odometry import Odometry

MODEL = "epal1-1200"
"""Of all pallets."""


@dataclass(frozen=True, slots=True, eq=False)
class Drive:
    """How the forklift drives and what it sees."""

    pallet: LevelPose = LevelPose(7.0, 3.0, 1.2, 1.5)
    """``forklift_from_pallet`` where it begins."""
    duration: float = 12.0
    """In seconds."""
    speed: float = 0.5
    """In metres per second."""
    swing: float = 0.25
    """How fast it turns to and fro at most, in radians per second."""
    rate: int = 50
    """Samples of odometry per second."""
    shot_every: int = 5
    """Samples of odometry from one shot to the next."""
    sigma_m: float = 0.001
    """Standard deviation of a measured place at a distance of one metre; it grows with the square."""
    sigma_yaw: float = 0.001
    """The same of the yaw, in radians."""


@dataclass(frozen=True, slots=True, eq=False)
class Approach:
    """What comes in during an approach, and what is true."""

    odometry: tuple[Odometry, ...]
    """In the order of their times."""
    measurements: tuple[PalletMeasurement, ...]
    """One of every shot."""
    truth: FloatArray
    """(n, 4) ``forklift_from_pallet`` at the time of each measurement: x, y, z, yaw."""


def simulate(rng: np.random.Generator, config: TrackerConfig, drive: Drive | None = None) -> Approach:
    """Draw an approach: the odometry's constant errors, its noise, and that of the measurements.

    Parameters
    ----------
    rng : Generator
        Source of everything random.
    config : TrackerConfig
        Whose noise is true.
    drive : Drive, optional
        How the forklift drives.
    """
    drive = drive or Drive()
    dt = 1 / drive.rate
    constants = rng.normal(size=2) * config.odometry.constants
    wander = np.array([config.errors.wander_m] * 3 + [math.radians(config.errors.wander_yaw_deg)])
    stated, pallet = LevelPose(0.0, 0.0, 0.0, 0.0), drive.pallet
    odometry, seen, ways = [Odometry(0.0, stated)], [pallet], [0.0]
    for k in range(1, round(drive.duration * drive.rate) + 1):
        motion = config.odometry.moved(_rates(drive, k * dt), dt)
        stated = composed(stated, motion.increment)
        odometry.append(Odometry(k * dt, stated))
        noise = np.linalg.cholesky(motion.covariance) @ rng.normal(size=3)
        floor = 1e-3 * config.odometry.floor_mm_per_sqrt_m * math.sqrt(motion.path) * rng.normal()
        pallet = seen_after(pallet, motion.increment + motion.constants @ constants + noise)
        x, y, z, yaw = (pallet.as_array() + math.sqrt(motion.path) * wander * rng.normal(size=4)).tolist()
        pallet = LevelPose(x, y, z + floor, wrap_angle(yaw))
        seen.append(pallet)
        ways.append(ways[-1] + motion.path)
    shots = range(0, len(seen), drive.shot_every)
    times = [odometry[k].time for k in shots]
    truth = [seen[k] for k in shots]
    measurements = _measured(times, truth, np.diff([ways[k] for k in shots]), config, drive, rng)
    return Approach(tuple(odometry), measurements, np.array([one.as_array() for one in truth]))


def _rates(drive: Drive, time: float) -> Twist:
    return Twist(drive.speed, 0.0, drive.swing * math.sin(2 * math.pi * time / 5))


def composed(pose: LevelPose, increment: FloatArray | Sequence[float]) -> LevelPose:
    """Return a pose after a motion (dx, dy, dyaw) in its own frame."""
    dx, dy, turn = (float(value) for value in increment)
    cos, sin = math.cos(pose.yaw), math.sin(pose.yaw)
    return LevelPose(pose.x + cos * dx - sin * dy, pose.y + sin * dx + cos * dy, pose.z, wrap_angle(pose.yaw + turn))


def seen_after(pallet: LevelPose, increment: FloatArray | Sequence[float]) -> LevelPose:
    """Return where a pallet is in the forklift's frame after a motion (dx, dy, dyaw) of the forklift."""
    dx, dy, turn = (float(value) for value in increment)
    cos, sin = math.cos(turn), math.sin(turn)
    x, y = pallet.x - dx, pallet.y - dy
    return LevelPose(cos * x + sin * y, cos * y - sin * x, pallet.z, wrap_angle(pallet.yaw - turn))


def _measured(
    times: Sequence[float],
    truth: Sequence[LevelPose],
    ways: FloatArray,
    config: TrackerConfig,
    drive: Drive,
    rng: np.random.Generator,
) -> tuple[PalletMeasurement, ...]:
    """Return measurements whose errors share what the parameters say over the ways between them."""
    exact = [
        PalletMeasurement(time, MODEL, pose, _covariance(pose, drive), 0.9, YawSource.FACE)
        for time, pose in zip(times, truth, strict=True)
    ]
    common = rng.normal(size=4)
    found = []
    for one, split, way in zip(exact, observe(exact, config.errors), (0.0, *ways), strict=True):
        if not isinstance(split, Observation):
            raise split
        stays = math.exp(-way / config.errors.common_path_m)
        common = stays * common + math.sqrt(1 - stays**2) * rng.normal(size=4)
        own = np.linalg.cholesky(split.own) @ rng.normal(size=4)
        x, y, z, yaw = (one.forklift_from_pallet.as_array() + split.common @ common + own).tolist()
        found.append(replace(one, forklift_from_pallet=LevelPose(x, y, z, wrap_angle(yaw))))
    return tuple(found)


def _covariance(pallet: LevelPose, drive: Drive) -> FloatArray:
    """Return the covariance of a measured pose: along the line of sight it is known half as well as across."""
    squared = pallet.x**2 + pallet.y**2 + pallet.z**2
    sigmas = squared * np.array([2 * drive.sigma_m, drive.sigma_m, drive.sigma_m, drive.sigma_yaw])
    bearing = math.atan2(pallet.y, pallet.x)
    axes = np.eye(4)
    axes[:2, :2] = [[math.cos(bearing), -math.sin(bearing)], [math.sin(bearing), math.cos(bearing)]]
    covariance = axes @ np.diag(sigmas**2) @ axes.T
    return np.asarray((covariance + covariance.T) / 2)
