"""The way that the forklift went: odometry samples in order of time, and the motion between any two times."""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from palletloc.geometry import FloatArray, LevelPose, wrap_angle
from tracking.motion import Motion, Twist, chain, no_motion
from tracking.odometry import Odometry, OdometryNoise, PathLimits, mean_rates, rates_between

UNKNOWN_SPEED, UNKNOWN_TURN = 1.0, 0.5
"""How fast a forklift may drive and turn while nothing is known of it: one standard deviation, in m/s and rad/s."""
MOST_KEPT = 512
"""How many motions are kept to be asked for again."""


@dataclass(frozen=True, slots=True, eq=False)
class _Leg:
    """From one sample to the next."""

    twist: Twist
    known: bool
    jumped: bool
    whole: Motion


class DrivenPath:
    """Samples of odometry, kept in the order of their times, whatever order they come in.

    Parameters
    ----------
    noise : OdometryNoise
        What the odometry cannot know.
    limits : PathLimits
        What is believed of it.
    """

    def __init__(self, noise: OdometryNoise, limits: PathLimits) -> None:
        self._noise = noise
        self._limits = limits
        self._samples: list[Odometry] = []
        self._times: list[float] = []
        self._legs: list[_Leg] = []
        self._kept: dict[tuple[float, float], Motion] = {}

    def __len__(self) -> int:
        """Return how many samples are kept."""
        return len(self._samples)

    def __iter__(self) -> Iterator[Odometry]:
        """Yield the samples in the order of their times."""
        return iter(self._samples)

    @property
    def span(self) -> tuple[float, float] | None:
        """First and last time, in seconds; None before any sample."""
        return (self._times[0], self._times[-1]) if self._times else None

    def find(self, time: float) -> Odometry | None:
        """Return the sample of exactly that time."""
        at = bisect_left(self._times, time)
        return self._samples[at] if at < len(self._times) and self._times[at] == time else None

    def put(self, sample: Odometry) -> float:
        """Take a sample in its place, or in place of one of the same time.

        Parameters
        ----------
        sample : Odometry
            Checked by the caller.

        Returns
        -------
        float
            From when on motions have changed, in seconds.
        """
        at = bisect_left(self._times, sample.time)
        if at < len(self._times) and self._times[at] == sample.time:
            self._samples[at] = sample
        else:
            self._samples.insert(at, sample)
            self._times.insert(at, sample.time)
            if len(self._samples) > 1:
                self._legs.insert(max(at - 1, 0), self._leg(max(at - 1, 0)))
        for leg in (at - 1, at):
            if 0 <= leg < len(self._legs):
                self._legs[leg] = self._leg(leg)
        # what is before the first sample goes by the first leg
        changed = self._times[at - 1] if at > 1 else -math.inf
        # what is beyond the last sample goes by the last leg
        again = self._times[at + 1] if at + 2 < len(self._times) else math.inf
        self._kept = {ends: motion for ends, motion in self._kept.items() if ends[1] <= changed or ends[0] >= again}
        return changed

    def last_before(self, time: float) -> float | None:
        """Return the time of the last sample up to a time."""
        at = bisect_right(self._times, time)
        return self._times[at - 1] if at else None

    def first_after(self, time: float) -> float | None:
        """Return the time of the first sample after a time."""
        at = bisect_right(self._times, time)
        return self._times[at] if at < len(self._times) else None

    def jumps_at(self, time: float) -> bool:
        """Tell whether the poses jump before or after the sample of a time."""
        at = bisect_left(self._times, time)
        return any(0 <= leg < len(self._legs) and self._legs[leg].jumped for leg in (at - 1, at))

    def reaches(self, time: float) -> bool:
        """Tell whether the samples say where the forklift was at a time."""
        if not self._times:
            return False
        ahead = self._limits.max_ahead_s
        return self._times[0] - ahead <= time <= self._times[-1] + ahead

    def is_between_samples(self, time: float) -> bool:
        """Tell whether a time lies between the first and the last sample."""
        return bool(self._times) and self._times[0] <= time <= self._times[-1]

    def motion(self, start: float, end: float) -> Motion | None:
        """Return the motion between two times.

        Parameters
        ----------
        start, end : float
            In seconds, in this order.

        Returns
        -------
        Motion or None
            None where the samples do not reach that far.
        """
        found = self._kept.get((start, end))
        if found is None and self.reaches(start) and self.reaches(end):
            found = self.extrapolated(start, end)
            if len(self._kept) >= MOST_KEPT:
                self._kept.clear()
            if found is not None:
                self._kept[start, end] = found
        return found

    def extrapolated(self, start: float, end: float) -> Motion | None:
        """Return the motion between two times however far beyond the samples; None before any sample."""
        if not self._samples:
            return None
        if end <= start:
            return no_motion()
        first, last = (bisect_right(self._times, time) - 1 for time in (start, end))
        if last > first and self._times[last] == end:
            last -= 1
        return chain(
            [
                self._part(leg, start if leg == first else None, end if leg == last else None)
                for leg in range(first, last + 1)
            ]
        )

    def pose_at(self, time: float) -> LevelPose | None:
        """Return ``odom_from_forklift`` at a time by the nearest sample that has a pose; None where none has."""
        posed = [sample for sample in self._samples if sample.pose is not None]
        if not posed:
            return None
        at = max(bisect_right([sample.time for sample in posed], time) - 1, 0)
        pose = posed[at].pose
        ends = sorted((posed[at].time, time))
        motion = self.extrapolated(*ends)
        if pose is None or motion is None:
            return None
        dx, dy, turn = motion.increment
        if time < posed[at].time:
            cos, sin = math.cos(turn), math.sin(turn)
            dx, dy, turn = -cos * dx - sin * dy, sin * dx - cos * dy, -turn
        cos, sin = math.cos(pose.yaw), math.sin(pose.yaw)
        x, y = pose.x + cos * dx - sin * dy, pose.y + sin * dx + cos * dy
        return LevelPose(float(x), float(y), 0.0, wrap_angle(float(pose.yaw + turn)))

    def rates_within(self, start: float, end: float) -> tuple[FloatArray, FloatArray] | None:
        """Return the rates at which the forklift went between two times.

        Parameters
        ----------
        start, end : float
            In seconds, in this order.

        Returns
        -------
        times : (n + 1,) array
            Of the samples, from the last one up to the start to the first one from the end on.
        rates : (n, 3) array
            Speed forward and to the left in m/s, and turn in rad/s, between them.

        Or None where the samples do not cover that time, or the rates are not known throughout.
        """
        first, last = bisect_right(self._times, start) - 1, bisect_left(self._times, end)
        legs = self._legs[max(first, 0) : last]
        if first < 0 or last >= len(self._times) or not legs or any(leg.jumped or not leg.known for leg in legs):
            return None
        rates = [(leg.twist.forward, leg.twist.left, leg.twist.turn) for leg in legs]
        return np.array(self._times[first : last + 1]), np.array(rates)

    def forget_before(self, time: float) -> None:
        """Drop samples that no motion from a time on needs."""
        count = bisect_right(self._times, time) - 1
        if count > 0:
            del self._samples[:count], self._times[:count], self._legs[:count]
            self._kept = {ends: motion for ends, motion in self._kept.items() if ends[0] >= time}

    def _leg(self, number: int) -> _Leg:
        """Return the leg from a sample to the next one."""
        earlier, later = self._samples[number : number + 2]
        duration = later.time - earlier.time
        between = rates_between(earlier, later)
        twist = self._believed(between)
        jumped = between is not None and twist is None
        if jumped:
            twist = self._believed(mean_rates(earlier, later))
        known = twist is not None
        twist = twist or Twist(0.0, 0.0, 0.0)
        return _Leg(twist, known, jumped, self._moved(twist, known, later.covariance, duration, duration))

    def _believed(self, twist: Twist | None) -> Twist | None:
        """Return rates that a forklift may have; None for others."""
        if twist is None:
            return None
        fast = math.hypot(twist.forward, twist.left) > self._limits.max_speed_mps
        return None if fast or abs(twist.turn) > math.radians(self._limits.max_turn_dps) else twist

    def _moved(self, twist: Twist, known: bool, rates: FloatArray | None, whole: float, duration: float) -> Motion:
        """Return the motion for a part of a leg, without what is unsure of its ends."""
        if not known:
            rates = np.diag([UNKNOWN_SPEED, UNKNOWN_SPEED, UNKNOWN_TURN]) ** 2
        return self._noise.moved(twist, duration, rates, whole)

    def _part(self, leg: int, start: float | None, end: float | None) -> Motion:
        """Return the motion on a leg from a time, or its begin, to a time, or its end."""
        if leg < 0 or leg >= len(self._legs):
            return self._beyond(leg, start, end)
        this, before, after = self._legs[leg], self._times[leg], self._times[leg + 1]
        begin = before if start is None else start
        finish = after if end is None else end
        if begin == before and finish == after:
            return this.whole
        motion = self._moved(
            this.twist, this.known, self._samples[leg + 1].covariance, after - before, finish - begin
        )
        return _with_noise(
            motion, sum(self._noise.between_samples(cut - before, after - cut) for cut in (begin, finish))
        )

    def _beyond(self, leg: int, start: float | None, end: float | None) -> Motion:
        """Return the motion before the first or after the last sample, at the rates there."""
        edge = self._times[0] if leg < 0 else self._times[-1]
        sample, nearest = (self._samples[0], self._legs[:1]) if leg < 0 else (self._samples[-1], self._legs[-1:])
        twist = self._believed(sample.twist) or (nearest[0].twist if nearest and nearest[0].known else None)
        begin = edge if start is None else start
        finish = edge if end is None else end
        duration = finish - begin
        motion = self._moved(twist or Twist(0.0, 0.0, 0.0), twist is not None, None, duration, duration)
        unseen = [abs(cut - edge) for cut in (begin, finish)]
        return _with_noise(motion, sum(self._noise.between_samples(away, away) for away in unseen))


def _with_noise(motion: Motion, covariance: FloatArray | int) -> Motion:
    return Motion(motion.increment, motion.covariance + covariance, motion.constants, motion.path, motion.duration)
