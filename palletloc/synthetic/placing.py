"""Placing things along a shelf, on either side of the aisle.

The shelf frame is laid like a pallet's: x into the shelf, y left as seen from the aisle, z up; its origin is
on the floor below the front plane, abreast of the world's origin. ``along`` counts in the direction of
travel.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from palletloc.choices import Side
from palletloc.geometry import LevelPose, level_pose
from palletloc.synthetic.scene import Box, Decal, Material


@dataclass(frozen=True, slots=True)
class ShelfFrame:
    """Where a shelf's front plane is in the world."""

    side: Side
    """On which side of the world's x axis."""
    distance: float
    """From the world's x axis to the front plane, in metres."""

    @property
    def sign(self) -> float:
        """1 on the left, -1 on the right."""
        return 1.0 if self.side is Side.LEFT else -1.0

    def world(self, inwards: float, along: float, z: float, yaw: float = 0.0) -> LevelPose:
        """Return the world pose of something so far into the shelf, along it and up, in metres, and its turn."""
        world_from_shelf = LevelPose(0.0, self.sign * self.distance, 0.0, self.sign * np.pi / 2)
        shelf_from_thing = LevelPose(inwards, -self.sign * along, z, yaw)
        return level_pose(world_from_shelf.transform() * shelf_from_thing.transform())


def standing(
    world_from_foot: LevelPose,
    low: tuple[float, float, float],
    high: tuple[float, float, float],
    material: Material,
    rounding: float = 0.0,
    decals: tuple[Decal, ...] = (),
) -> Box:
    """Return the box between two corners that are given in the frame of its foot.

    Parameters
    ----------
    world_from_foot : LevelPose
        A frame; x may point into the shelf.
    low, high : tuple of float
        The corners in that frame, in metres.
    material : Material
        Of the box.
    rounding : float
        Radius of its edges, in metres; as much of it as the box allows.
    decals : tuple of Decal
        What is stuck on it.
    """
    middle = LevelPose((low[0] + high[0]) / 2, (low[1] + high[1]) / 2, (low[2] + high[2]) / 2, 0.0)
    x, y, z = (b - a for a, b in zip(low, high, strict=True))
    pose = level_pose(world_from_foot.transform() * middle.transform())
    return Box(pose, (x, y, z), material, min(rounding, 0.45 * min(x, y, z)), decals)


def seeded(material: Material, rng: np.random.Generator, spread: float = 0.0) -> Material:
    """Return a material of the same kind with its textures elsewhere and a slightly other brightness."""
    factor = float(np.exp(spread * rng.standard_normal()))
    blue, green, red = (min(channel * factor, 0.95) for channel in material.colour)
    return replace(material, colour=(blue, green, red), seed=int(rng.integers(1 << 16)))
