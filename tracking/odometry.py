"""Odometry as it comes: poses or rates, and how uncertain they are in the units of a data sheet."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from palletloc.geometry import FloatArray, LevelPose
from palletloc.trajectory import Trajectory
from tracking.motion import Motion, Twist, twist_between
from tracking.validation import BadInputError, check_time, check_values, checked_covariance

ODOM, FORKLIFT = "odom", "forklift"
"""Frames of the contract: where the odometry began, and the vehicle."""


@dataclass(frozen=True, slots=True, eq=False)
class Odometry:
    """One sample of the forklift's odometry: its pose since the start, its rates, or both."""

    time: float
    """In seconds."""
    pose: LevelPose | None = None
    """``odom_from_forklift``; its height is not used. It goes before the rates where there are both."""
    twist: Twist | None = None
    """Rates at that time."""
    covariance: FloatArray | None = None
    """(3, 3) covariance of the noise of (forward, left, turn), in (m/s)^2 and (rad/s)^2, which is new in every
    sample; None for `OdometryNoise`."""
    frame: str = ODOM
    """Frame of the pose."""
    child_frame: str = FORKLIFT
    """Frame whose pose it is."""

    @property
    def contents(self) -> tuple[tuple[float, ...], tuple[float, ...], tuple[float, ...]]:
        """All of its numbers, to be compared with another sample."""
        pose = () if self.pose is None else tuple(self.pose.as_array().tolist())
        twist = () if self.twist is None else (self.twist.forward, self.twist.left, self.twist.turn)
        covariance = () if self.covariance is None else tuple(np.ravel(self.covariance).tolist())
        return pose, twist, covariance


def check_odometry(sample: Odometry) -> Odometry:
    """Return a sample that can be used.

    Parameters
    ----------
    sample : Odometry
        As it came.

    Returns
    -------
    Odometry
        With a symmetric covariance.

    Raises
    ------
    BadInputError
        If a number is not finite or beyond all reason, the frames are others, it has neither pose nor rates, or its
        covariance is not symmetric positive definite.
    """
    time = sample.time
    check_time(time)
    if (sample.frame, sample.child_frame) != (ODOM, FORKLIFT):
        got = f"got {sample.frame!r} and {sample.child_frame!r}"
        raise BadInputError("frame", time, f"expected the pose of {FORKLIFT!r} in {ODOM!r}, {got}")
    if sample.pose is None and sample.twist is None:
        raise BadInputError("odometry", time, "expected a pose, rates, or both")
    check_values("pose", sample.contents[0], time)
    check_values("twist", sample.contents[1], time)
    if sample.covariance is None:
        return sample
    return replace(sample, covariance=checked_covariance(sample.covariance, 3, time))


class OdometrySource(Protocol):
    """Where odometry comes from: a recording, a bag, a vehicle."""

    def __iter__(self) -> Iterator[Odometry]:
        """Yield the samples; times need not be in order."""
        ...


@dataclass(frozen=True, slots=True)
class OdometryNoise:
    """What odometry cannot know, one standard deviation each, as data sheets of encoders and gyroscopes state it."""

    wheel_scale_percent: float = 1.0
    """Constant relative error of all distances."""
    distance_mm_per_sqrt_m: float = 3.0
    """Random error of the distance, which grows with the root of the way."""
    slip_mm_per_sqrt_m: float = 1.0
    """Random motion sideways, which grows with the root of the way."""
    floor_mm_per_sqrt_m: float = 0.5
    """Random change of the height by the floor, which grows with the root of the way."""
    speed_mm_per_sqrt_s: float = 4.0
    """Random error of the distance, which grows with the root of the time while the wheels turn."""
    gyro_bias_deg_s: float = 0.2
    """Constant error of the yaw rate."""
    gyro_random_walk_deg_per_sqrt_s: float = 0.08
    """Random error of the yaw, which grows with the root of the time while the wheels turn."""
    turn_deg_per_sqrt_turn: float = 0.5
    """Random error of the yaw, which grows with the root of all turns, in degrees per root of a whole turn."""
    acceleration_mps2: float = 0.5
    """How strongly speed may change unseen between two samples."""
    turn_acceleration_dps2: float = 20.0
    """How strongly the yaw rate may change unseen between two samples, in degrees per second squared."""

    @property
    def constants(self) -> FloatArray:
        """(2,) standard deviations of the wheels' relative scale and of the gyroscope's bias, in rad/s."""
        return np.array([self.wheel_scale_percent / 100, math.radians(self.gyro_bias_deg_s)])

    def moved(self, twist: Twist, duration: float, rates: FloatArray | None = None, sample: float = 0.0) -> Motion:
        """Return a motion at constant rates, with its noise.

        Parameters
        ----------
        twist : Twist
            The rates.
        duration : float
            In seconds.
        rates : (3, 3) array, optional
            Covariance of the rates, if the odometry states it.
        sample : float
            Time between samples for which that holds, in seconds.

        Returns
        -------
        Motion
            Its noise is proportional to the time, so that it does not matter how a straight way is cut into motions;
            on a curve, to the second order of the turn.
        """
        increment = twist.after(duration)
        x, y, turn = increment.tolist()
        path = math.hypot(twist.forward, twist.left) * duration
        # a turn's error comes about evenly over the motion: its mean swings half of what is travelled in it,
        # and what varies in it a twelfth of its square
        if rates is None:
            local = self._local(path, abs(twist.turn) * duration, duration)
        else:
            local = rates * sample * duration
        cos, sin = math.cos(turn / 2), math.sin(turn / 2)  # the mean heading
        by_local = np.array([[cos, -sin, -y / 2], [sin, cos, x / 2], [0.0, 0.0, 1.0]])
        constants = np.array([[x, -y / 2 * duration], [y, x / 2 * duration], [0.0, duration]])
        aside = np.array([-y, x, 0.0])
        covariance = by_local.dot(local).dot(by_local.T) + local[2, 2] / 12 * aside[:, None] * aside
        return Motion(increment, covariance, constants, path, duration)

    def _local(self, path: float, turned: float, duration: float) -> FloatArray:
        """Return the (3, 3) covariance of the noise of (ahead, left, turn)."""
        moving = duration if path > 0 or turned > 0 else 0.0
        ahead = (1e-3 * self.distance_mm_per_sqrt_m) ** 2 * path + (1e-3 * self.speed_mm_per_sqrt_s) ** 2 * moving
        left = (1e-3 * self.slip_mm_per_sqrt_m) ** 2 * path
        turn = math.radians(self.gyro_random_walk_deg_per_sqrt_s) ** 2 * moving
        turn += math.radians(self.turn_deg_per_sqrt_turn) ** 2 * turned / (2 * math.pi)
        return np.diag([ahead, left, turn])

    def between_samples(self, before: float, after: float) -> FloatArray:
        """Return the (3, 3) covariance of where the forklift is at a time between two samples.

        Of a speed that changes by at most `acceleration_mps2`, straight interpolation is off by half of that times
        both distances to the samples.

        Parameters
        ----------
        before, after : float
            Time since the sample before, and to the one after, in seconds.
        """
        reach = before * after / 2
        place = (self.acceleration_mps2 * reach) ** 2
        return np.diag([place, place, (math.radians(self.turn_acceleration_dps2) * reach) ** 2])


def rates_between(earlier: Odometry, later: Odometry) -> Twist | None:
    """Return the constant rates between two samples: by their poses, else the mean of their rates.

    Returns
    -------
    Twist or None
        None where one has only a pose and the other only rates.
    """
    duration = later.time - earlier.time
    if earlier.pose is not None and later.pose is not None:
        return twist_between(earlier.pose, later.pose, duration)
    return mean_rates(earlier, later)


def mean_rates(earlier: Odometry, later: Odometry) -> Twist | None:
    """Return the mean of the rates that two samples state; None where neither does."""
    known = [sample.twist for sample in (earlier, later) if sample.twist is not None]
    if not known:
        return None
    count = len(known)
    return Twist(
        sum(twist.forward for twist in known) / count,
        sum(twist.left for twist in known) / count,
        sum(twist.turn for twist in known) / count,
    )


def samples_of(trajectory: Trajectory) -> list[Odometry]:
    """Return the samples of a recording's odometry.

    Parameters
    ----------
    trajectory : Trajectory
        ``odom_from_forklift`` over time, with or without rates.

    Returns
    -------
    list of Odometry
        One for each time.
    """
    samples = []
    for i, (time, x, y, yaw) in enumerate(
        zip(trajectory.times, trajectory.x, trajectory.y, trajectory.yaw, strict=True)
    ):
        twist = None
        if trajectory.speed is not None and trajectory.yaw_rate is not None:
            twist = Twist(float(trajectory.speed[i]), 0.0, float(trajectory.yaw_rate[i]))
        samples.append(Odometry(float(time), LevelPose(float(x), float(y), 0.0, float(yaw)), twist))
    return samples


@dataclass(frozen=True, slots=True)
class PathLimits:
    """What is believed of odometry."""

    max_speed_mps: float = 10.0
    """Two poses farther apart than this speed allows are a jump, not a motion."""
    max_turn_dps: float = 180.0
    """The same of the yaw, in degrees per second."""
    max_ahead_s: float = 0.5
    """How far beyond its first and last sample a motion goes on at the last rates."""
