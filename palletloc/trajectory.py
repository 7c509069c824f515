"""Level poses over time: odometry and the true path of a forklift."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from palletloc.errors import PalletLocError, seconds
from palletloc.geometry import FloatArray, LevelPose, wrap_angle


class TrajectoryError(PalletLocError):
    """A pose was asked for at a time that the trajectory does not cover."""


@dataclass(frozen=True, slots=True, eq=False)
class Trajectory:
    """Samples of a level pose, ``target_from_forklift``, with strictly increasing times.

    The arrays are copied and read-only.

    Raises
    ------
    ValueError
        If there is no sample, the lengths differ, a value is not finite, or the times do not increase.
    """

    times: FloatArray
    """(n,) in seconds."""
    x: FloatArray
    """(n,) in metres."""
    y: FloatArray
    """(n,) in metres."""
    yaw: FloatArray
    """(n,) in radians; unwrapped, whatever was given: neighbours differ by less than half a turn."""
    z: FloatArray | None = None
    """(n,) in metres; None for a path on the floor, where it is zero."""
    speed: FloatArray | None = None
    """(n,) forward, in metres per second; None where it was not recorded."""
    yaw_rate: FloatArray | None = None
    """(n,) in radians per second; None where it was not recorded."""

    def __post_init__(self) -> None:
        """Check the samples, unwrap the yaw and keep read-only copies."""
        for field in fields(self):
            given = getattr(self, field.name)
            if given is None:
                continue
            samples = np.array(given, dtype=np.float64)
            if samples.ndim != 1 or samples.size == 0 or samples.shape != np.shape(self.times):
                raise ValueError(f"trajectory.{field.name}: expected one value per time, got {samples.shape}")
            if not np.isfinite(samples).all():
                raise ValueError(f"trajectory.{field.name}: a value is not finite")
            if field.name == "yaw":
                samples = np.unwrap(samples)
            samples.setflags(write=False)
            object.__setattr__(self, field.name, samples)
        if not (np.diff(self.times) > 0).all():
            raise ValueError("trajectory.times: expected strictly increasing times")

    @property
    def span(self) -> tuple[float, float]:
        """First and last time, in seconds."""
        return float(self.times[0]), float(self.times[-1])

    @property
    def margin(self) -> float:
        """How far outside its span a pose is still given: the median sample interval, in seconds."""
        return float(np.median(np.diff(self.times))) if self.times.size > 1 else 0.0

    def pose_at(self, time: float) -> LevelPose:
        """Return the pose at any time of the span, or up to one sample interval outside it.

        Between samples the pose changes linearly, the yaw along the short way; outside, the motion
        of the outermost two samples goes on.

        Parameters
        ----------
        time : float
            In seconds.

        Returns
        -------
        LevelPose
            ``target_from_forklift``, its yaw in [-pi, pi).

        Raises
        ------
        TrajectoryError
            If the time is farther outside.

        Examples
        --------
        >>> path = Trajectory(*np.array([[0.0, 1.0], [0.0, 2.0], [0.0, 0.0], [0.0, 0.5]]))
        >>> path.pose_at(0.5)
        LevelPose(x=1.0, y=0.0, z=0.0, yaw=0.25)
        """
        start, end = self.span
        reach = self.margin * (1 + 1e-6)
        if not start - reach <= time <= end + reach:
            now, first, after_all = seconds(time, start, end)
            off = f"{max(start - time, time - end):.12g} s {'before' if time < start else 'after'}"
            raise TrajectoryError(
                f"no pose at {now} s: expected a time between {first} s and {after_all} s"
                f" (at most {self.margin:.3g} s outside), and it is {off}"
            )
        last = self.times.size - 1
        after = min(max(int(np.searchsorted(self.times, time, side="right")), 1), last)
        before = max(after - 1, 0)
        step = self.times[after] - self.times[before]
        share = (time - self.times[before]) / step if step > 0 else 0.0

        def between(samples: FloatArray) -> float:
            return float((1 - share) * samples[before] + share * samples[after])

        z = 0.0 if self.z is None else between(self.z)
        return LevelPose(between(self.x), between(self.y), z, wrap_angle(between(self.yaw)))
