"""How surfaces look: texture, decals and highlights of solids; the hall's floor with its paint, walls, lamps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from palletloc.geometry import LevelPose
from palletloc.synthetic.lighting import LightField
from palletloc.synthetic.samples import Indices, Samples
from palletloc.synthetic.scene import Decal, Material, Paint, Room, Solid
from palletloc.synthetic.texture import sample
from palletloc.synthetic.tracing import CEILING, FLOOR, to_solid, turned_to_solid

_SHARPNESS = 4
"""Doublings of the exponent of highlights: cosine to the 16th, a broad highlight."""
_SHINE, _MIRRORED = 8.0, 6
"""Strength of highlights against diffuse light, and how many of the strongest directions make them."""
_FRESNEL = 0.04
"""Share of light that is mirrored at right angles: a refractive index of 1.5, as plastic and varnish have."""
_ON_PLANE = 1e-3
"""Distance within which a point lies on a wall, in metres: float32 at 20 m keeps 2e-6."""
_CORNER_SHADE, _CORNER_REACH = 0.45, 0.7
"""Part of the light that a corner of the hall takes, and from how far, in metres."""


@dataclass(frozen=True, slots=True)
class Surface:
    """Points on the surfaces of solids, ready to be lit."""

    chosen: Indices
    """(N,) the rays that hit them."""
    points: Samples
    """(3, N) in the world, in metres."""
    directions: Samples
    """(3, N) unit vectors from the viewer to them."""
    normals: Samples
    """(3, N) outward unit normals, in the world."""
    colours: Samples
    """(3, N) reflectances."""
    gloss: Samples
    """(N,) strength of highlights."""

    @staticmethod
    def joined(parts: Sequence[Surface]) -> Surface:
        """Return all points of several."""
        return Surface(
            np.concatenate([p.chosen for p in parts]),
            np.concatenate([p.points for p in parts], axis=1),
            np.concatenate([p.directions for p in parts], axis=1),
            np.concatenate([p.normals for p in parts], axis=1),
            np.concatenate([p.colours for p in parts], axis=1),
            np.concatenate([p.gloss for p in parts]),
        )

    def radiance(self, field: LightField) -> Samples:
        """Return the (3, N) light that they send back."""
        light = field.irradiance(self.points, self.normals) * field.light.strength(self.points)
        radiance: Samples = self.colours * light
        shiny = np.flatnonzero(self.gloss)
        if len(shiny):
            directions, normals = self.directions.take(shiny, axis=1), self.normals.take(shiny, axis=1)
            slant = -np.einsum("ij,ij->j", directions, normals)
            shine = _highlight(field, directions + 2 * slant * normals) * fresnel(np.abs(slant))
            radiance[:, shiny] += self.gloss[shiny] * (np.float32(0.3) + light[shiny]) * shine
        return radiance


def surface(solid: Solid, chosen: Indices, points: Samples, directions: Samples, size: Samples) -> Surface:
    """Return what points of a solid's surface are like.

    Parameters
    ----------
    solid : Solid
        The solid.
    chosen : (N,) array
        The rays that hit it.
    points : (3, N) array
        Points of its surface, in the world, in metres.
    directions : (3, N) array
        Unit vectors from the viewer to the points.
    size : (N,) array
        Width of what one ray stands for, across the ray, in metres.
    """
    local = to_solid(solid.world_from_solid, points)
    local_normals = solid.normals(local)
    normals = turned_to_solid(LevelPose(0.0, 0.0, 0.0, -solid.world_from_solid.yaw), local_normals)
    slant = np.abs(np.einsum("ij,ij->j", directions, normals))
    size = size / np.sqrt(np.maximum(slant, np.float32(0.1)))
    axis = np.abs(local_normals).argmax(axis=0)
    brightness = _grain(solid, local, axis, size) * solid.tint(local, local_normals)
    colours = np.array(solid.material.colour, np.float32)[:, None] * brightness
    for decal in solid.decals:
        colours = _with_decal(colours, decal, solid, local, local_normals, size)
    gloss = np.full(len(chosen), solid.material.gloss, np.float32)
    return Surface(chosen, points, directions, normals, colours, gloss)


def textured(material: Material, u: Samples, v: Samples, size: Samples) -> Samples:
    """Return the relative brightness of a material's textures; streaks run along ``u``."""
    brightness = np.ones(len(u), np.float32)
    for layer in material.textures:
        brightness += sample(layer, material.seed % 4, u, v, size)
    return np.maximum(brightness, np.float32(0.1))


def fresnel(slant: Samples) -> Samples:
    """Return what share of the light is mirrored, given the cosine of its angle to the normal (Schlick)."""
    mirrored: Samples = np.float32(_FRESNEL) + np.float32(1 - _FRESNEL) * (1 - np.minimum(slant, 1)) ** 5
    return mirrored


def covered(offset: Samples, width: float, size: Samples) -> Samples:
    """Return how much of each ray's footprint lies in a band of some width, 0 to 1."""
    share: Samples = np.clip((np.float32(width / 2) - np.abs(offset)) / size + np.float32(0.5), 0, 1)
    return share


def _grain(solid: Solid, local: Samples, axis: Indices, size: Samples) -> Samples:
    """Return the brightness of a solid's textures, with streaks along its longest side."""
    long = int(np.argmax(solid.high - solid.low))
    first, second = [a for a in range(3) if a != long]
    shift = np.float32(0.37 * (solid.material.seed % 97))
    u = np.where(axis == long, local[first], local[long]) + shift
    v = np.where((axis == first) | (axis == long), local[second], local[first]) + shift
    return textured(solid.material, u, v, size)


def _with_decal(
    colours: Samples, decal: Decal, solid: Solid, local: Samples, normals: Samples, size: Samples
) -> Samples:
    """Return colours with one decal over those of its face."""
    face = np.flatnonzero(normals[decal.axis] * decal.sign > 0.9)
    if not len(face):
        return colours
    first, second = [axis for axis in range(3) if axis != decal.axis]
    middle = (solid.low + solid.high) / 2
    u = local[first, face] - np.float32(middle[first] + decal.center[0])
    v = local[second, face] - np.float32(middle[second] + decal.center[1])
    if decal.pitch:
        half = np.float32(decal.pitch / 2)
        v = (v + half) % np.float32(decal.pitch) - half
    cover = covered(u, decal.size[0], size[face]) * covered(v, decal.size[1], size[face])
    painted = colours.copy()
    painted[:, face] += cover * (np.array(decal.colour, np.float32)[:, None] - colours[:, face])
    return painted


def _highlight(field: LightField, mirrored: Samples) -> Samples:
    """Return the mirror image of the light's strongest directions in a surface that is not quite smooth."""
    light = field.light
    shine = np.zeros(mirrored.shape[1], np.float32)
    for index in np.argsort(light.weights)[::-1][:_MIRRORED].tolist():
        along = np.maximum(np.array(light.directions[index], np.float32) @ mirrored, 0)
        for _ in range(_SHARPNESS):
            along *= along
        shine += np.float32(_SHINE * light.weights[index]) * along
    return shine


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
        colour = _with_paint(colour, paint, points, size, brightness)
    colour *= field.on_floor(points[0], points[1])
    return colour


def _ceiling(room: Room, field: LightField, points: Samples, size: Samples) -> Samples:
    brightness = textured(room.ceiling, points[0], points[1], size)
    colour = np.array(room.ceiling.colour, np.float32)[:, None] * brightness
    colour *= np.float32(field.light.bounce * field.light.open_ground)
    for lamp in room.lamps:
        colour = _with_paint(colour, lamp, points, size, np.ones(points.shape[1], np.float32))
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


def _with_paint(colours: Samples, paint: Paint, points: Samples, size: Samples, brightness: Samples) -> Samples:
    """Return the colours of a level surface with one painted rectangle over them."""
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
    painted = colours.copy()
    painted[:, near] += cover * (target - colours[:, near])
    return painted
