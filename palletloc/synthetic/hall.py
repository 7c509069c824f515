"""How the hall around a scene looks: floor with its paint, walls, ceiling with its lamps."""

from __future__ import annotations

import numpy as np

from palletloc.synthetic.lighting import LightField
from palletloc.synthetic.samples import Samples
from palletloc.synthetic.scene import Paint, Room
from palletloc.synthetic.surfaces import covered, textured
from palletloc.synthetic.tracing import CEILING, FLOOR

_ON_PLANE = 1e-3
_CORNER_SHADE, _CORNER_REACH = 0.45, 0.7


def room_radiance(
    part: int, room: Room, field: LightField, points: Samples, directions: Samples, size: Samples
) -> Samples:
    """Return the light that points of the hall send back.

    Parameters
    ----------
    part : int
        `FLOOR`, `WALLS` or `CEILING`.
    room : Room
        The hall.
    field : LightField
        The light.
    points : (3, N) array
        Points of that part, in metres.
    directions : (3, N) array
        Unit vectors from the viewer to the points.
    size : (N,) array
        Width of what one ray stands for, across the ray, in metres.

    Returns
    -------
    (3, N) array
        Blue, green, red in linear light.
    """
    if part == FLOOR:
        slant = np.sqrt(np.maximum(np.abs(directions[2]), np.float32(0.02)))
        radiance = _floor(room, field, points, size / slant)
    elif part == CEILING:
        radiance = _ceiling(room, field, points, size)
    else:
        radiance = _walls(room, field, points, size)
    radiance *= field.light.strength(points) * _corner_shade(room, points)
    return radiance


def _corner_shade(room: Room, points: Samples) -> Samples:
    """Return how much light the corners of the hall leave, 0 to 1."""
    shade = np.ones(points.shape[1], np.float32)
    for axis, (low, high) in enumerate(zip((*room.low, 0.0), (*room.high, room.height), strict=True)):
        gap = np.minimum(points[axis] - np.float32(low), np.float32(high) - points[axis])
        near = np.maximum(1 - gap / np.float32(_CORNER_REACH), 0)
        shade *= 1 - np.where(gap > _ON_PLANE, np.float32(_CORNER_SHADE), 0) * near * near
    return shade


def _floor(room: Room, field: LightField, points: Samples, size: Samples) -> Samples:
    brightness = textured(room.floor, points[0], points[1], size)
    colour = np.array(room.floor.colour, np.float32)[:, None] * brightness
    for paint in room.paint:
        _lay(paint, points, size, colour, brightness)
    colour *= field.on_floor(points[0], points[1])
    return colour


def _ceiling(room: Room, field: LightField, points: Samples, size: Samples) -> Samples:
    brightness = textured(room.ceiling, points[0], points[1], size)
    colour = np.array(room.ceiling.colour, np.float32)[:, None] * brightness
    colour *= np.float32(field.light.bounce * field.light.open_ground)
    for lamp in room.lamps:
        _lay(lamp, points, size, colour, np.ones(points.shape[1], np.float32))
    return colour


def _walls(room: Room, field: LightField, points: Samples, size: Samples) -> Samples:
    normals = np.zeros_like(points)
    for axis in range(2):
        normals[axis] += np.abs(points[axis] - np.float32(room.low[axis])) < _ON_PLANE
        normals[axis] -= np.abs(points[axis] - np.float32(room.high[axis])) < _ON_PLANE
    along = np.where(normals[0] == 0, points[0], points[1])
    colour = np.array(room.walls.colour, np.float32)[:, None] * textured(room.walls, along, points[2], size)
    colour *= field.unshadowed(points, normals)
    return colour


def _lay(paint: Paint, points: Samples, size: Samples, colour: Samples, brightness: Samples) -> None:
    """Lay one painted rectangle over the colours of a level surface."""
    cos, sin = np.float32(np.cos(paint.yaw)), np.float32(np.sin(paint.yaw))
    x, y = points[0] - np.float32(paint.x), points[1] - np.float32(paint.y)
    if paint.pitch:
        half = np.float32(paint.pitch / 2)
        x = (x + half) % np.float32(paint.pitch) - half
    along, across = cos * x + sin * y, cos * y - sin * x
    reached = (np.abs(across) < paint.width / 2 + size) & (np.abs(along) < paint.length / 2 + size)
    near = np.flatnonzero(reached)
    cover = covered(along[near], paint.length, size[near]) * covered(across[near], paint.width, size[near])
    if paint.wear:
        cover *= np.clip(2.5 - 2 * paint.wear + 6 * (brightness[near] - 1), 0, 1)
    target = np.array(paint.colour, np.float32)[:, None] * brightness[near]
    colour[:, near] += cover * (target - colour[:, near])
