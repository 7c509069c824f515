"""How the surface of a solid looks: texture, decals, light and highlights."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from palletloc.geometry import LevelPose
from palletloc.synthetic.lighting import LightField
from palletloc.synthetic.samples import Indices, Samples
from palletloc.synthetic.scene import Decal, Material, Solid
from palletloc.synthetic.texture import sample
from palletloc.synthetic.tracing import to_solid, turned_to_solid

_SHARPNESS = 4  # doublings of the exponent
_SHINE, _MIRRORED = 8.0, 6
_FRESNEL = 0.04


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
        _stick(decal, solid, local, local_normals, size, colours)
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


def _stick(decal: Decal, solid: Solid, local: Samples, normals: Samples, size: Samples, colour: Samples) -> None:
    """Paint one decal over the colours of a face."""
    face = np.flatnonzero(normals[decal.axis] * decal.sign > 0.9)
    if not len(face):
        return
    one, other = [a for a in range(3) if a != decal.axis]
    middle = (solid.low + solid.high) / 2
    u = local[one, face] - np.float32(middle[one] + decal.center[0])
    v = local[other, face] - np.float32(middle[other] + decal.center[1])
    if decal.pitch:
        half = np.float32(decal.pitch / 2)
        v = (v + half) % np.float32(decal.pitch) - half
    cover = covered(u, decal.size[0], size[face]) * covered(v, decal.size[1], size[face])
    colour[:, face] += cover * (np.array(decal.colour, np.float32)[:, None] - colour[:, face])


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
