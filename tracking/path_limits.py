"""What is believed of odometry."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class PathLimits:
    """What is believed of odometry."""

    max_speed_mps: float = 10.0
    """Two poses farther apart than this speed allows are a jump, not a motion."""
    max_turn_dps: float = 180.0
    """The same of the yaw, in degrees per second."""
    max_ahead_s: float = 0.5
    """How far beyond its first and last sample a motion goes on at the last rates."""
