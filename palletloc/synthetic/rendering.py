"""Pictures of a scene through any camera: what light comes back along rays, and its mean over each pixel."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from palletloc.geometry import BoolArray
from palletloc.synthetic.lighting import LightField, light_field
from palletloc.synthetic.rays import CameraRays, TiledRays, finer_rays
from palletloc.synthetic.samples import Indices, Samples
from palletloc.synthetic.scene import Scene
from palletloc.synthetic.surfaces import Surface, fresnel, room_radiance, surface
from palletloc.synthetic.tracing import FLOOR, Hits, Spheres, bounding_spheres, trace

UNSEEN = -4
"""What the solids' map holds where the image shows nothing."""
_CONTRAST, _DARKEST = 0.12, 0.02
"""Change of the light's logarithm over a pixel from which more rays are taken, and what is added before it."""
_OFFSETS = np.array([[-0.125, -0.375], [0.375, -0.125], [-0.375, 0.125], [0.125, 0.375]])
"""Where further rays go through a pixel, in pixels from its centre: a rotated grid, no two in a row or column."""


@dataclass(frozen=True, slots=True)
class LitScene:
    """A scene with what its pictures share."""

    scene: Scene
    """Solids, room and light."""
    spheres: Spheres | None
    """Bounds of the solids."""
    field: LightField
    """Its light."""


def lit(scene: Scene) -> LitScene:
    """Prepare a scene for any number of pictures."""
    return LitScene(scene, bounding_spheres(scene.solids) if scene.solids else None, light_field(scene))


def look(lit_scene: LitScene, rays: TiledRays, pixel_angle: float) -> tuple[Samples, Hits]:
    """Return what comes along rays.

    Parameters
    ----------
    lit_scene : LitScene
        The scene.
    rays : TiledRays
        In the world.
    pixel_angle : float
        Angle that one ray stands for, in radians: finer texture is averaged away.

    Returns
    -------
    radiance : (3, N) array
        Blue, green, red in linear light; a white surface in full light has 1.
    hits : Hits
        What they hit.
    """
    hits = trace(rays, lit_scene.scene.solids, lit_scene.spheres, lit_scene.scene.room, pixel_angle)
    radiance = _radiance(lit_scene, rays, hits, pixel_angle)
    if lit_scene.scene.room.floor.gloss > 0:
        floor = np.flatnonzero(hits.solids == FLOOR)
        radiance[:, floor] += _reflected(lit_scene, rays, hits, floor, pixel_angle)
    radiance *= np.array(lit_scene.scene.light.colour, np.float32)[:, None]
    return radiance, hits


def _radiance(lit_scene: LitScene, rays: TiledRays, hits: Hits, pixel_angle: float) -> Samples:
    """Return the (3, N) light that the hit surfaces send back."""
    scene, field = lit_scene.scene, lit_scene.field
    radiance = np.empty((3, rays.count), np.float32)
    seen: list[Surface] = []
    for index, chosen in _by_solid(hits):
        points = rays.points(chosen, hits.distances[chosen])
        directions = rays.directions.take(chosen, axis=1)
        size = hits.distances[chosen] * np.float32(pixel_angle)
        if index < 0:
            radiance[:, chosen] = room_radiance(index, scene.room, field, points, directions, size)
        else:
            seen.append(surface(scene.solids[index], chosen, points, directions, size))
    if seen:
        together = Surface.joined(seen)
        radiance[:, together.chosen] = together.radiance(field)
    return radiance


def _by_solid(hits: Hits) -> Iterator[tuple[int, Indices]]:
    """Return each thing that is hit with the rays that hit it."""
    order = np.argsort(hits.solids.astype(np.int16), kind="stable")
    ordered = hits.solids[order]
    bounds = np.flatnonzero(np.diff(ordered)) + 1
    for chosen in np.split(order, bounds):
        if len(chosen):
            yield int(hits.solids[chosen[0]]), chosen


def _reflected(lit_scene: LitScene, rays: TiledRays, hits: Hits, chosen: Indices, pixel_angle: float) -> Samples:
    """Return the (3, N) light that a glossy floor mirrors, where chosen rays meet it."""
    if not len(chosen):
        return np.zeros((3, 0), np.float32)
    flip = np.array([[1.0], [1.0], [-1.0]], np.float32)
    mirrored = TiledRays(
        rays.points(chosen, hits.distances[chosen]),
        rays.directions.take(chosen, axis=1) * flip,
        np.searchsorted(chosen, rays.starts).astype(np.intp),
        rays.tile_origins * flip[:, 0],  # each cone opens from below the floor
        rays.tile_axes * flip[:, 0],
        rays.tile_angles,
        rays.tile_spreads,
    )
    above = trace(mirrored, lit_scene.scene.solids, lit_scene.spheres, lit_scene.scene.room, pixel_angle)
    slant = np.abs(rays.directions[2, chosen])
    share = np.float32(lit_scene.scene.room.floor.gloss) * fresnel(slant)
    return np.asarray(share * _radiance(lit_scene, mirrored, above, pixel_angle))


@dataclass(frozen=True, slots=True)
class RenderedImage:
    """What a camera sees, before its sensor."""

    radiance: Samples
    """(height, width, 3) blue, green, red in linear light; zero where the image shows nothing."""
    solids: NDArray[np.int32]
    """(height, width) index of the solid at each pixel's centre, a part of the room, or `UNSEEN`."""


def render(
    scene: LitScene, rays: CameraRays, world_from_camera: RigidTransform, smooth: bool = True
) -> RenderedImage:
    """Return the picture that a camera takes of a scene.

    A pixel's value is the mean over its area where something changes within it, else that of its centre.

    Parameters
    ----------
    scene : LitScene
        The scene.
    rays : CameraRays
        The camera's rays, as `camera_rays` gives them; they serve for any number of pictures.
    world_from_camera : RigidTransform
        Where it is.
    smooth : bool
        Whether to take several rays through pixels that something changes in.

    Returns
    -------
    RenderedImage
        Linear light, and which solid is where.
    """
    matrix = world_from_camera.as_matrix()
    rotation, translation = matrix[:3, :3], matrix[:3, 3]
    height, width = rays.camera.height, rays.camera.width
    light, things = np.zeros((height * width, 3), np.float32), np.full(height * width, UNSEEN, np.int32)
    for part in rays.parts:
        radiance, hits = look(scene, part.rays.moved(rotation, translation), rays.angle)
        things[part.pixels] = hits.solids
        light[part.pixels] = radiance.T
    image, solids = light.reshape(height, width, 3), things.reshape(height, width)
    if smooth:
        changed = _changes(image, solids, rays.camera.period_px is not None).ravel()
        for part in rays.parts:
            chosen = changed[part.pixels]
            finer = finer_rays(rays.camera, part, chosen, _OFFSETS).moved(rotation, translation)
            radiance, _ = look(scene, finer, rays.angle / 2)
            light[part.pixels[chosen]] = radiance.reshape(3, -1, len(_OFFSETS)).mean(axis=2).T
    return RenderedImage(image, solids)


def _changes(image: Samples, solids: NDArray[np.int32], closed: bool) -> BoolArray:
    """Return the pixels that differ from a neighbour; in a closed image the first column follows the last."""
    light = np.log(image[:, :, 1] + np.float32(_DARKEST))
    changed = np.zeros(solids.shape, np.bool_)
    for axis in (0, 1):
        differs = np.abs(light - np.roll(light, 1, axis)) > _CONTRAST
        differs |= solids != np.roll(solids, 1, axis)
        if not (closed and axis == 1):
            differs[(slice(None),) * axis + (0,)] = False
        changed |= differs | np.roll(differs, -1, axis)
    return changed
