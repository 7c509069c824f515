"""The nominal front plane of a shelf: where pallets are looked for."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from palletloc.geometry import LevelPose, wrap_angle


@dataclass(frozen=True, slots=True)
class ShelfPlane:
    """A vertical plane along a shelf's front, centimetres and a degree off; in `odom` or `forklift`."""

    x: float
    """A point on the plane, in metres."""
    y: float
    """The same point's second coordinate, in metres."""
    facing: float
    """Heading of the normal that points from the shelf into the aisle, in radians."""
    levels: tuple[float, ...] = ()
    """Heights that loads stand on, in metres above the floor; empty where unknown."""
    drift: float = 0.0
    """How far the forklift's heading may have drifted since the plane was given, in radians."""

    @property
    def yaw(self) -> float:
        """Heading into the shelf, which is the yaw of a pallet that stands straight, in radians."""
        return wrap_angle(self.facing + np.pi)

    def seen_from(self, odom_from_forklift: LevelPose, drift: float = 0.0) -> ShelfPlane:
        """Return the plane, given in `odom`, in the `forklift` frame.

        Parameters
        ----------
        odom_from_forklift : LevelPose
            The forklift's pose.
        drift : float
            How far its heading may have drifted by then, in radians.

        Examples
        --------
        >>> shelf = ShelfPlane(3.0, 2.0, np.radians(-90))
        >>> shelf.seen_from(LevelPose(1.0, 0.0, 0.0, 0.0))
        ShelfPlane(x=2.0, y=2.0, facing=-1.5707963267948966, levels=(), drift=0.0)
        """
        dx, dy = self.x - odom_from_forklift.x, self.y - odom_from_forklift.y
        cos, sin = np.cos(odom_from_forklift.yaw), np.sin(odom_from_forklift.yaw)
        return ShelfPlane(
            float(cos * dx + sin * dy),
            float(cos * dy - sin * dx),
            float(wrap_angle(self.facing - odom_from_forklift.yaw)),
            self.levels,
            drift,
        )
