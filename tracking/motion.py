"""Motion of the forklift between two times, with what is uncertain about it.

A motion is the pose of the later forklift in the frame of the earlier one, (dx, dy, dyaw). Its uncertainty has two
parts: noise that is new in every instant, and the odometry's constant errors, the wheels' scale and the gyroscope's
bias, which are the same for every motion of an approach.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np

from palletloc.geometry import FloatArray, LevelPose, wrap_angle

SMALL_TURN = 1e-4
"""Turn below which the series of the exponential map is exact to rounding, in radians."""


@dataclass(frozen=True, slots=True)
class Twist:
    """Constant rates of a planar motion, in the forklift frame."""

    forward: float
    """Speed forward, in metres per second."""
    left: float
    """Speed to the left, in metres per second."""
    turn: float
    """Rate of the yaw, in radians per second."""

    def after(self, duration: float) -> FloatArray:
        """Return (dx, dy, dyaw) after some time at these rates: the exponential map of SE(2).

        Parameters
        ----------
        duration : float
            In seconds.

        Examples
        --------
        >>> Twist(math.pi / 2, 0.0, math.pi / 2).after(1.0).round(6).tolist()
        [1.0, 1.0, 1.570796]
        """
        angle = self.turn * duration
        if abs(angle) < SMALL_TURN:
            along, aside = 1 - angle**2 / 6, angle / 2
        else:
            along, aside = math.sin(angle) / angle, (1 - math.cos(angle)) / angle
        ahead, left = self.forward * duration, self.left * duration
        return np.array([along * ahead - aside * left, aside * ahead + along * left, angle])


def twist_between(earlier: LevelPose, later: LevelPose, duration: float) -> Twist:
    """Return the constant rates that lead from one pose to another: the logarithm of SE(2).

    Parameters
    ----------
    earlier, later : LevelPose
        ``odom_from_forklift`` at both times; the yaw changes by less than half a turn.
    duration : float
        Time between them, positive, in seconds.

    Returns
    -------
    Twist
        Constant over that time.
    """
    cos, sin = math.cos(earlier.yaw), math.sin(earlier.yaw)
    x, y = later.x - earlier.x, later.y - earlier.y
    ahead, left = cos * x + sin * y, cos * y - sin * x
    turn = wrap_angle(later.yaw - earlier.yaw)
    half = turn / 2
    along = 1 - turn**2 / 12 if abs(turn) < SMALL_TURN else half / math.tan(half)
    return Twist((along * ahead + half * left) / duration, (along * left - half * ahead) / duration, turn / duration)


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """Motion from an earlier to a later time, with its uncertainty."""

    increment: FloatArray
    """(3,) (dx, dy, dyaw): the later forklift in the earlier one's frame, in metres and radians."""
    covariance: FloatArray
    """(3, 3) covariance of its noise, which is independent of that of every other time."""
    constants: FloatArray
    """(3, 2) derivative by the wheels' relative scale error, and by the rate in rad/s that the gyroscope misses."""
    path: float
    """Length of the way, in metres."""
    duration: float
    """In seconds."""


@cache
def no_motion() -> Motion:
    """Return the motion of no time at all."""
    return Motion(np.zeros(3), np.zeros((3, 3)), np.zeros((3, 2)), 0.0, 0.0)


def chain(motions: Sequence[Motion]) -> Motion:
    r"""Return several motions, one after the other, as one.

    With :math:`p_i` and :math:`\theta_i` the place and heading where step i begins, its errors
    :math:`(e_x, e_y, e_\theta)` move the end by :math:`R(\theta_i) (e_x, e_y) + e_\theta J (p_n - p_{i+1})`, J the
    quarter turn: an early turn swings all that follows. First order in the errors.

    Parameters
    ----------
    motions : sequence of Motion
        In the order of time.

    Returns
    -------
    Motion
        From the first one's begin to the last one's end.
    """
    if len(motions) == 1:
        return motions[0]
    if not motions:
        return no_motion()
    steps = np.array([motion.increment for motion in motions])
    heading = steps[:, 2].cumsum()
    turn = np.exp(1j * (heading - steps[:, 2]))  # places on the floor are x + iy: this turns them
    ends = (turn * (steps[:, 0] + 1j * steps[:, 1])).cumsum()
    swing = 1j * (ends[-1] - ends)
    by_step = np.zeros((len(motions), 3, 3))
    by_step[:, 0, 0] = by_step[:, 1, 1] = turn.real
    by_step[:, 1, 0], by_step[:, 0, 1] = turn.imag, -turn.imag
    by_step[:, 0, 2], by_step[:, 1, 2], by_step[:, 2, 2] = swing.real, swing.imag, 1.0
    covariances = by_step @ np.array([motion.covariance for motion in motions]) @ by_step.transpose(0, 2, 1)
    return Motion(
        np.array([ends[-1].real, ends[-1].imag, heading[-1]]),
        covariances.sum(axis=0),
        (by_step @ np.array([motion.constants for motion in motions])).sum(axis=0),
        sum(motion.path for motion in motions),
        sum(motion.duration for motion in motions),
    )
