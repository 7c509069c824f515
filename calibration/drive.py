"""The way of the forklift as its odometry tells it: increments from shot to shot, and how far each may be off."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from palletloc.geometry import FloatArray, LevelPose
from palletloc.planar import compose as compose
from palletloc.planar import relative as relative
from palletloc.trajectory import Trajectory


@dataclass(frozen=True, slots=True)
class DriveNoise:
    """How far odometry may be off; one standard deviation each."""

    scale: float = 0.015
    """Relative error of all distances."""
    bias: float = 0.01
    """Constant error of the yaw rate, in radians per second."""
    position: float = 0.006
    """Random error of the position after one second, in metres; grows with the root of the time."""
    heading: float = 0.0025
    """Random error of the heading after one second, in radians; grows with the root of the time."""
    slip: float = 0.005
    """Random error of a step's position as a part of its length."""


@dataclass(frozen=True, slots=True, eq=False)
class Drive:
    """Increments of the pose between the odometry's first sample and the shots."""

    start: LevelPose
    """``odom_from_forklift`` at the odometry's first sample: what fixes the frame `odom`."""
    steps: FloatArray
    """(n, 3) x, y and yaw of each shot's pose in the frame of the one before; the first in that of `start`."""
    durations: FloatArray
    """(n,) how long each took, in seconds; not negative."""
    noise: DriveNoise = DriveNoise()
    """How far they may be off."""

    @property
    def sigma(self) -> FloatArray:
        """(n, 3) standard deviations of the random part of each increment, in metres and radians."""
        root = np.sqrt(np.maximum(self.durations, 1e-3))
        length = np.hypot(self.steps[:, 0], self.steps[:, 1])
        place = np.hypot(self.noise.position * root, self.noise.slip * length)
        return np.stack([place, place, self.noise.heading * root], axis=1)

    def poses(self, scale: float = 1.0, bias: float = 0.0) -> FloatArray:
        """Return the poses at the shots, added up from the increments.

        Parameters
        ----------
        scale : float
            True distance over measured distance.
        bias : float
            What the measured yaw rate has too much, in radians per second.

        Returns
        -------
        (n, 3) array
            x, y and yaw of ``odom_from_forklift``, in metres and radians.
        """
        pose = self.start.as_array()[[0, 1, 3]]
        poses = []
        for step in self.corrected(scale, bias):
            pose = compose(pose, step)
            poses.append(pose)
        return np.array(poses)

    def corrected(self, scale: float, bias: float) -> FloatArray:
        """Return the increments without a scale error and a gyroscope's bias, (n, 3)."""
        turn = bias * self.durations
        cos, sin = np.cos(turn / 2), np.sin(turn / 2)
        x, y, yaw = self.steps.T
        return np.stack([scale * (cos * x + sin * y), scale * (cos * y - sin * x), yaw - turn], axis=1)


def read_drive(odometry: Trajectory, times: Sequence[float], noise: DriveNoise | None = None) -> Drive:
    """Return the increments between shots.

    Parameters
    ----------
    odometry : Trajectory
        ``odom_from_forklift``.
    times : sequence of float
        Of the shots, increasing, in seconds.
    noise : DriveNoise, optional
        How far the odometry may be off.

    Raises
    ------
    TrajectoryError
        If the odometry does not reach one of them.
    """
    first = odometry.span[0]
    start = odometry.pose_at(first)
    poses = np.array([(p.x, p.y, p.yaw) for p in (start, *(odometry.pose_at(time) for time in times))])
    durations = np.abs(np.diff(np.array([first, *times])))
    return Drive(start, relative(poses[:-1], poses[1:]), durations, noise or DriveNoise())


def evenly_spread(count: int, most: int) -> NDArray[np.intp]:
    """Return which of a number of things to take, evenly spread from the first to the last.

    Parameters
    ----------
    count : int
        How many there are.
    most : int
        How many are taken at most.

    Examples
    --------
    >>> evenly_spread(9, 3).tolist()
    [0, 4, 8]
    """
    return np.unique(np.linspace(0, count - 1, min(count, most)).round().astype(np.intp))
