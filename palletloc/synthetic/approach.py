"""The way of a forklift along a shelf, and what its odometry makes of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from palletloc.geometry import FloatArray, LevelPose
from palletloc.trajectory import Trajectory


@dataclass(frozen=True, slots=True)
class Approach:
    """A way that winds a little around a straight line; the heading follows the way."""

    start: LevelPose = LevelPose(-0.8, 0.0, 0.0, 0.0)
    """World pose that the straight line begins at."""
    length: float = 3.2
    """Along the line, in metres."""
    speed: float = 0.5
    """Along the line, in metres per second."""
    winding: float = 0.02
    """Largest distance from the line, in metres."""
    wavelength: float = 3.0
    """Of the windings, in metres."""
    phase: float = 0.0
    """Of the windings at the start, in radians."""

    @property
    def duration(self) -> float:
        """How long it takes, in seconds."""
        return self.length / self.speed

    def poses(self, times: FloatArray) -> FloatArray:
        """Return where the forklift is.

        Parameters
        ----------
        times : (n,) array
            Seconds from the start.

        Returns
        -------
        (n, 3) array
            x, y and yaw of ``world_from_forklift``.
        """
        wave = 2 * np.pi / self.wavelength
        along = self.speed * np.asarray(times)
        across = self.winding * np.sin(wave * along + self.phase)
        turn = np.arctan(self.winding * wave * np.cos(wave * along + self.phase))
        cos, sin = np.cos(self.start.yaw), np.sin(self.start.yaw)
        return np.stack(
            [
                self.start.x + cos * along - sin * across,
                self.start.y + sin * along + cos * across,
                self.start.yaw + turn,
            ],
            -1,
        )


@dataclass(frozen=True, slots=True)
class OdometryNoise:
    """Errors of wheel odometry and gyroscope; all zero for perfect ones."""

    scale_sigma: float = 0.006
    """Standard deviation of the relative error of distances, constant over an approach."""
    bias_sigma: float = 0.004
    """Standard deviation of the gyroscope's bias, constant over an approach, in radians per second."""
    speed_sigma: float = 0.03
    """Standard deviation of each sample's speed, in metres per second."""
    yaw_rate_sigma: float = 0.01
    """Standard deviation of each sample's yaw rate, in radians per second."""


def measure_odometry(
    approach: Approach, noise: OdometryNoise, rng: np.random.Generator, rate: float = 50.0
) -> Trajectory:
    """Return what odometry says about an approach.

    Each sample's motion is measured with its errors and added up, so that the pose drifts.

    Parameters
    ----------
    approach : Approach
        The true way.
    noise : OdometryNoise
        Its errors.
    rng : numpy.random.Generator
        Draws them.
    rate : float
        Samples per second.

    Returns
    -------
    Trajectory
        ``odom_from_forklift`` with speed and yaw rate, from the pose at the start, which is zero, to the end.
    """
    count = int(np.ceil(approach.duration * rate - 1e-9)) + 1
    times = np.arange(count) / rate
    step = 1 / rate
    motion = _motion(approach.poses(times))
    scale = 1 + noise.scale_sigma * rng.standard_normal()
    bias = noise.bias_sigma * rng.standard_normal()
    motion[:, :2] *= scale
    motion[:, 0] += noise.speed_sigma * step * rng.standard_normal(count - 1)
    motion[:, 2] += (bias + noise.yaw_rate_sigma * rng.standard_normal(count - 1)) * step
    yaw = np.concatenate([[0.0], np.cumsum(motion[:, 2])])
    cos, sin = np.cos(yaw[:-1]), np.sin(yaw[:-1])
    x = np.concatenate([[0.0], np.cumsum(cos * motion[:, 0] - sin * motion[:, 1])])
    y = np.concatenate([[0.0], np.cumsum(sin * motion[:, 0] + cos * motion[:, 1])])
    rates = np.concatenate([motion[:1], motion]) / step
    return Trajectory(times=times, x=x, y=y, yaw=yaw, speed=rates[:, 0], yaw_rate=rates[:, 2])


def _motion(poses: FloatArray) -> FloatArray:
    """Return each pose in the frame of the one before, (n - 1, 3)."""
    delta = np.diff(poses, axis=0)
    cos, sin = np.cos(poses[:-1, 2]), np.sin(poses[:-1, 2])
    return np.stack([cos * delta[:, 0] + sin * delta[:, 1], cos * delta[:, 1] - sin * delta[:, 0], delta[:, 2]], -1)
