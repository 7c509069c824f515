"""Simulated approaches: odometry and measurements that err just as the tracker's model says."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from palletloc.geometry import FloatArray, LevelPose, wrap_angle
from palletloc.measurement import PalletMeasurement, YawSource
from tracking.config import TrackerConfig
from tracking.motion import Motion, Twist
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
    common = rng.normal(size=4)
    stated, pallet = LevelPose(0.0, 0.0, 0.0, 0.0), drive.pallet
    odometry, measurements, truth = [Odometry(0.0, stated)], [], []
    for k in range(round(drive.duration * drive.rate) + 1):
        if k:
            twist = Twist(drive.speed, 0.0, drive.swing * math.sin(2 * math.pi * k * dt / 5))
            motion = config.odometry.moved(twist, dt)
            stated = composed(stated, motion.increment)
            floor = 1e-3 * config.odometry.floor_mm_per_sqrt_m * math.sqrt(motion.path) * rng.normal()
            pallet = replace(seen_after(pallet, _true(motion, constants, rng)), z=pallet.z + floor)
            odometry.append(Odometry(k * dt, stated))
            stays = math.exp(-motion.path / config.errors.common_path_m)
            common = stays * common + math.sqrt(1 - stays**2) * rng.normal(size=4)
        if k % drive.shot_every == 0:
            measurements.append(_measured(k * dt, pallet, common, config, drive, rng))
            truth.append(pallet.as_array())
    return Approach(tuple(odometry), tuple(measurements), np.array(truth))


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


def _true(motion: Motion, constants: FloatArray, rng: np.random.Generator) -> FloatArray:
    noise = rng.multivariate_normal(np.zeros(3), motion.covariance, method="eigh")
    return motion.increment + motion.constants @ constants + noise


def _measured(
    time: float, pallet: LevelPose, common: FloatArray, config: TrackerConfig, drive: Drive, rng: np.random.Generator
) -> PalletMeasurement:
    range_squared = pallet.x**2 + pallet.y**2 + pallet.z**2
    sigmas = range_squared * np.array([drive.sigma_m, 2 * drive.sigma_m, drive.sigma_m, drive.sigma_yaw])
    bearing = math.atan2(pallet.y, pallet.x) + math.pi / 2
    cos, sin = math.cos(bearing), math.sin(bearing)
    axes = np.eye(4)
    axes[:2, :2] = [[cos, -sin], [sin, cos]]
    covariance = axes @ np.diag(sigmas**2) @ axes.T
    exact = PalletMeasurement(time, MODEL, pallet, (covariance + covariance.T) / 2, 0.9, YawSource.FACE)
    (split,) = observe([exact], config.errors)
    if not isinstance(split, Observation):
        raise split
    own = rng.multivariate_normal(np.zeros(4), split.own, method="eigh")
    x, y, z, yaw = (pallet.as_array() + split.common @ common + own).tolist()
    return PalletMeasurement(time, MODEL, LevelPose(x, y, z, wrap_angle(yaw)), exact.covariance, 0.9, YawSource.FACE)
