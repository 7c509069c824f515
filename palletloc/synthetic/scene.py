"""What a scene is made of: level solids in a room, their materials, and light."""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from palletloc.geometry import FloatArray, LevelPose
from palletloc.synthetic.samples import Samples, lengths
from palletloc.synthetic.texture import Colour, Texture


@dataclass(frozen=True, slots=True)
class Material:
    """How a surface reflects light."""

    colour: Colour
    """Reflectance."""
    textures: tuple[Texture, ...] = ()
    """Layers of brightness changes."""
    gloss: float = 0.0
    """Strength of highlights, 0 to 1."""
    seed: int = 0
    """Which noise its textures use."""


@dataclass(frozen=True, slots=True)
class Decal:
    """Something flat on a face of a box: a label, a tape, the holes of an upright."""

    axis: int
    """Axis of the face's normal: 0, 1 or 2."""
    sign: int
    """-1 or 1: which of the two faces."""
    center: tuple[float, float]
    """On the two other axes, in their order, in metres from the box's middle."""
    size: tuple[float, float]
    """Along the two other axes, in metres."""
    colour: Colour
    """Reflectance."""
    pitch: float = 0.0
    """If not zero, it repeats along the second of the two axes, in metres."""


class Solid(Protocol):
    """A level body that rays can hit."""

    @property
    def world_from_solid(self) -> LevelPose:
        """Where it is."""

    @property
    def low(self) -> FloatArray:
        """(3,) lower corner of its bounding box in its own frame, in metres."""

    @property
    def high(self) -> FloatArray:
        """(3,) upper corner of its bounding box in its own frame, in metres."""

    @property
    def material(self) -> Material:
        """How its surface reflects light."""

    @property
    def decals(self) -> tuple[Decal, ...]:
        """What is stuck on its faces."""

    @property
    def fills_bounds(self) -> bool:
        """Whether the body is its bounding box, with sharp edges."""

    @property
    def shape(self) -> Hashable:
        """Equal for solids with the same `distance`."""

    def distance(self, points: Samples) -> Samples:
        """Return a lower bound of the distance of points, (3, N), to the surface: exact near it, negative inside."""

    def normals(self, points: Samples) -> Samples:
        """Return the (3, N) outward unit normals at points of the surface."""

    def tint(self, points: Samples, normals: Samples) -> Samples:
        """Return the (N,) factors by which the body brightens its material at points of its surface."""

    def blocks(self) -> tuple[Box, ...]:
        """Return sharp boxes that cast about the same shadow."""


@dataclass(frozen=True, slots=True)
class Box:
    """A level box whose origin is its middle."""

    world_from_solid: LevelPose
    """Where it is."""
    size: tuple[float, float, float]
    """Its lengths along its own axes, in metres."""
    material: Material
    """How its surface reflects light."""
    rounding: float = 0.0
    """Radius of its edges, in metres."""
    decals: tuple[Decal, ...] = ()
    """What is stuck on its faces."""

    @property
    def low(self) -> FloatArray:
        """(3,) lower corner in its own frame."""
        return -self.high

    @property
    def high(self) -> FloatArray:
        """(3,) upper corner in its own frame."""
        return np.array(self.size) / 2

    @property
    def fills_bounds(self) -> bool:
        """Whether its edges are sharp."""
        return self.rounding == 0.0

    @property
    def shape(self) -> Hashable:
        """Size and rounding."""
        return self.size, self.rounding

    def distance(self, points: Samples) -> Samples:
        """Return the distance to the surface."""
        q = np.abs(points) - (self.high - self.rounding).astype(np.float32)[:, None]
        outside = np.maximum(q, 0)
        far: Samples = lengths(outside) + np.minimum(q.max(axis=0), 0) - np.float32(self.rounding)
        return far

    def normals(self, points: Samples) -> Samples:
        """Return the outward unit normals at points of the surface."""
        q = np.abs(points) - (self.high - self.rounding).astype(np.float32)[:, None]
        outside = np.maximum(q, 0) if self.rounding else (q >= q.max(axis=0)).astype(np.float32)
        normals: Samples = outside * np.sign(points)
        normals /= np.maximum(lengths(normals), np.float32(1e-12))
        return normals

    def tint(self, points: Samples, normals: Samples) -> Samples:  # noqa: ARG002 - part of the protocol
        """Return ones: a box is of one piece."""
        return np.ones(points.shape[1], np.float32)

    def blocks(self) -> tuple[Box, ...]:
        """Return the box itself."""
        return (self,)


@dataclass(frozen=True, slots=True)
class Paint:
    """A painted rectangle on the floor, or a lamp on the ceiling."""

    x: float
    """Its middle, in metres."""
    y: float
    """Its middle's second coordinate, in metres."""
    yaw: float
    """Heading of its length, in radians."""
    length: float
    """Along the heading, in metres."""
    width: float
    """Across, in metres."""
    colour: Colour
    """Reflectance; of a lamp its radiance, which may be above 1."""
    wear: float = 0.0
    """How much of it is rubbed off, 0 to 1."""
    pitch: float = 0.0
    """If not zero, it repeats along x, in metres."""


@dataclass(frozen=True, slots=True)
class Room:
    """A level hall around the scene: floor at z = 0, four walls, a ceiling."""

    low: tuple[float, float]
    """Corner with the smallest x and y, in metres."""
    high: tuple[float, float]
    """Corner with the largest x and y, in metres."""
    height: float
    """Of the ceiling, in metres."""
    floor: Material
    """Material of the floor."""
    walls: Material
    """Material of the walls."""
    ceiling: Material
    """Material of the ceiling."""
    paint: tuple[Paint, ...] = ()
    """Lines on the floor."""
    lamps: tuple[Paint, ...] = ()
    """Lamps on the ceiling."""


@dataclass(frozen=True, slots=True)
class Light:
    """Light from many directions at once; what is in the way of one of them casts a soft shadow."""

    directions: tuple[tuple[float, float, float], ...]
    """Unit vectors towards the light."""
    weights: tuple[float, ...]
    """Irradiance of a surface that faces the direction."""
    sharp: int = 0
    """How many of the directions, from the first on, let even thin things cast a shadow."""
    bounce: float = 0.35
    """Share of the floor's irradiance that comes back from below."""
    colour: Colour = (1.0, 1.0, 1.0)
    """Tint."""
    pools: float = 0.0
    """How much brighter the floor is below the lamps than between them, 0 to 1."""
    pool_spacing: float = 4.0
    """From lamp to lamp along x, in metres."""
    slope: float = 0.0
    """Relative change of brightness per metre along x."""

    @property
    def open_ground(self) -> float:
        """Irradiance of level ground that nothing shades."""
        return sum(max(z, 0.0) * w for (_, _, z), w in zip(self.directions, self.weights, strict=True))

    def strength(self, points: Samples) -> Samples:
        """Return how bright the light is at (3, N) points of the world: (N,), about 1."""
        brightness = np.ones(points.shape[1], np.float32)
        if self.pools:
            phase = points[0] * np.float32(2 * np.pi / self.pool_spacing)
            brightness += np.float32(self.pools / 2) * np.cos(phase)
        if self.slope:
            brightness *= np.maximum(1 + np.float32(self.slope) * points[0], np.float32(0.15))
        return brightness


@dataclass(frozen=True, slots=True)
class Scene:
    """Everything that a camera can see; it does not move."""

    room: Room
    """The hall."""
    light: Light
    """Its light."""
    solids: tuple[Solid, ...] = field(default=())
    """What stands in it."""
