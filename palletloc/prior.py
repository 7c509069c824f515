"""What is known of pallets, levels and odometry before anything is measured."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class PriorConfig:
    """What is known before anything is measured."""

    level_sigma: float = 0.0025
    """How far loads stand from the known levels (one standard deviation), in metres: half of what an even floor may
    be off over 2 m (DIN 18202:2013, table 3, row 4: 5 mm)."""
    level_reach: float = 0.30
    """How far from a known level a given start may be to belong to it, in metres."""
    start_nearer: float = 0.90
    """How far before a given start a pallet is looked for that is not found near it, in metres."""
    start_farther: float = 0.90
    """How far behind a given start a pallet is looked for that is not found near it, in metres."""
    start_turn_deg: float = 24.0
    """How far the yaw of such a start may be off, in degrees."""
    free_sigma: float = 0.30
    """How far a pallet may stand from a start's height where no level is known, in metres."""
    yaw_sigma_deg: float = 5.0
    """How far a start's yaw may be off where only the face can give it, in degrees."""
    drift_rate_deg_s: float = 0.3
    """How fast the odometry's heading may drift, in degrees per second."""
    max_drift_deg: float = 4.0
    """How far it may drift in all, in degrees."""

    def drift_after(self, duration: float) -> float:
        """Return how far the odometry's heading may have drifted after some time, in radians."""
        return math.radians(min(self.drift_rate_deg_s * abs(duration), self.max_drift_deg))
