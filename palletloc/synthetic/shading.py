"""What light comes back along rays."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from palletloc.synthetic.hall import room_radiance
from palletloc.synthetic.lighting import LightField, light_field
from palletloc.synthetic.rays import Rays
from palletloc.synthetic.samples import Indices, Samples
from palletloc.synthetic.scene import Scene
from palletloc.synthetic.surfaces import Surface, fresnel, surface
from palletloc.synthetic.tracing import FLOOR, Hits, Spheres, bounding_spheres, trace


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
    """Prepare a scene for any number of pictures.

    Parameters
    ----------
    scene : Scene
        What is there.
    """
    return LitScene(scene, bounding_spheres(scene.solids) if scene.solids else None, light_field(scene))


def look(lit_scene: LitScene, rays: Rays, pixel_angle: float) -> tuple[Samples, Hits]:
    """Return what comes along rays.

    Parameters
    ----------
    lit_scene : LitScene
        The scene.
    rays : Rays
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
        _reflect(lit_scene, rays, hits, pixel_angle, radiance)
    radiance *= np.array(lit_scene.scene.light.colour, np.float32)[:, None]
    return radiance, hits


def _radiance(lit_scene: LitScene, rays: Rays, hits: Hits, pixel_angle: float) -> Samples:
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


def _reflect(lit_scene: LitScene, rays: Rays, hits: Hits, pixel_angle: float, radiance: Samples) -> None:
    """Add what a glossy floor mirrors."""
    chosen = np.flatnonzero(hits.solids == FLOOR)
    if not len(chosen):
        return
    flip = np.array([[1.0], [1.0], [-1.0]], np.float32)
    mirrored = Rays(
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
    radiance[:, chosen] += share * _radiance(lit_scene, mirrored, above, pixel_angle)
