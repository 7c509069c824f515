"""Where rays hit: the nearest solid along each of them."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from palletloc.geometry import BoolArray, FloatArray, LevelPose
from palletloc.synthetic.rays import TiledRays
from palletloc.synthetic.samples import Indices, Samples
from palletloc.synthetic.scene import Room, Solid

FLOOR, WALLS, CEILING = -1, -2, -3
"""What a ray hits that no solid stops: parts of the room, in place of an index of a solid."""

_CLOSE, _CLOSE_PIXELS = 2e-5, 0.01
"""Distance at which a ray has met a surface: in metres, and in pixels where that is more."""
_STEPS = 96
"""Most steps along a ray inside a solid's bounds; what has not met the surface by then passes by."""


@dataclass(frozen=True, slots=True)
class Hits:
    """The first thing along each ray."""

    distances: Samples
    """(N,) in metres."""
    solids: NDArray[np.int32]
    """(N,) index into the scene's solids, or `FLOOR`, `WALLS` or `CEILING`."""


@dataclass(frozen=True, slots=True)
class Spheres:
    """Spheres that contain solids: several for a long one."""

    centers: FloatArray
    """(M, 3) in metres."""
    radii: FloatArray
    """(M,) in metres."""
    starts: Indices
    """(S,) the first sphere of each solid."""


def bounding_spheres(solids: Sequence[Solid]) -> Spheres:
    """Return spheres that together contain each of some solids, of one at least."""
    centers: list[FloatArray] = []
    radii: list[FloatArray] = []
    starts: list[int] = []
    for solid in solids:
        starts.append(sum(map(len, radii)))
        size = solid.high - solid.low
        long = int(np.argmax(size))
        pieces = int(np.clip(size[long] / max(np.sort(size)[1], 0.1), 1, 24))
        part = size.copy()
        part[long] /= pieces
        local = np.repeat(((solid.low + solid.high) / 2)[None, :], pieces, axis=0)
        local[:, long] = solid.low[long] + (np.arange(pieces) + 0.5) * part[long]
        centers.append(to_world(solid.world_from_solid, local.T).T)
        radii.append(np.full(pieces, np.linalg.norm(part) / 2))
    return Spheres(np.concatenate(centers), np.concatenate(radii), np.array(starts, np.intp))


def to_world(world_from_solid: LevelPose, points: FloatArray) -> FloatArray:
    """Return (3, N) points of a solid's frame in the world."""
    cos, sin = np.cos(world_from_solid.yaw), np.sin(world_from_solid.yaw)
    return np.stack(
        [
            world_from_solid.x + cos * points[0] - sin * points[1],
            world_from_solid.y + sin * points[0] + cos * points[1],
            world_from_solid.z + points[2],
        ]
    )


def to_solid(world_from_solid: LevelPose, points: Samples) -> Samples:
    """Return (3, N) points of the world in a solid's frame."""
    origin = world_from_solid.as_array()[:3, None].astype(np.float32)
    return turned_to_solid(world_from_solid, points - origin)


def turned_to_solid(world_from_solid: LevelPose, vectors: Samples) -> Samples:
    """Return (3, N) directions of the world in a solid's frame."""
    cos, sin = np.float32(np.cos(world_from_solid.yaw)), np.float32(np.sin(world_from_solid.yaw))
    return np.stack([cos * vectors[0] + sin * vectors[1], cos * vectors[1] - sin * vectors[0], vectors[2]])


def trace(
    rays: TiledRays, solids: Sequence[Solid], spheres: Spheres | None, room: Room, pixel_angle: float = 0.0
) -> Hits:
    """Find the first thing along each ray.

    Parameters
    ----------
    rays : TiledRays
        In the world, starting inside the room.
    solids : sequence of Solid
        What stands in the room; a solid around a ray's start is not seen.
    spheres : Spheres or None
        Bounds of the solids; None where there are none.
    room : Room
        The hall around.
    pixel_angle : float
        Angle that one ray stands for, in radians: passing a surface within a hundredth of it is a hit.
    """
    hits = _room_hits(rays, room)
    if spheres is None or not rays.count:
        return hits
    seen = _seen_tiles(rays, spheres)
    middle = rays.tile_origins.mean(axis=0)
    nearness = np.linalg.norm(spheres.centers[spheres.starts] - middle, axis=1)
    grazing: dict[Hashable, list[_Grazing]] = {}
    for index in np.argsort(nearness, kind="stable").tolist():
        tiles = np.flatnonzero(seen[:, index])
        if len(tiles):
            left = _enter(rays, _rays_of(rays, tiles), solids[index], index, hits, pixel_angle)
            if left is not None:
                grazing.setdefault(solids[index].shape, []).append(left)
    for alike in grazing.values():
        _settle(_Grazing.joined(alike), solids[alike[0].solids[0]], hits)
    return hits


def _room_hits(rays: TiledRays, room: Room) -> Hits:
    """Find where rays leave the room."""
    low, high = np.array([*room.low, 0.0], np.float32), np.array([*room.high, room.height], np.float32)
    slope = _nonzero(rays.directions[2])
    distances = (np.where(slope > 0, high[2], low[2]) - rays.origins[2]) / slope
    parts = np.where(slope > 0, np.int32(CEILING), np.int32(FLOOR))
    for axis in range(2):
        slope = _nonzero(rays.directions[axis])
        wall = (np.where(slope > 0, high[axis], low[axis]) - rays.origins[axis]) / slope
        parts[wall < distances] = WALLS
        np.minimum(distances, wall, out=distances)
    return Hits(distances, parts)


def _nonzero(values: Samples) -> Samples:
    """Return values with those next to zero pushed away from it."""
    return np.where(np.abs(values) < 1e-9, np.float32(1e-9), values)


def _seen_tiles(rays: TiledRays, spheres: Spheres) -> BoolArray:
    """Return which tiles (T) may see which solids (S)."""
    origins = rays.tile_origins
    if not np.ptp(origins, axis=0).any():
        origins = origins[:1]
    offsets = spheres.centers[None, :, :] - origins[:, None, :]
    distance = np.maximum(np.linalg.norm(offsets, axis=2), 1e-9)
    cosines = np.matmul(rays.tile_axes[:, None, :], np.swapaxes(offsets, 1, 2))[:, 0] / distance
    reach = np.minimum((spheres.radii + rays.tile_spreads[:, None]) / distance, 1.0)
    allowed = rays.tile_angles[:, None] + np.where(reach < 1.0, np.arcsin(reach), np.pi)
    near = np.arccos(np.clip(cosines, -1.0, 1.0)) <= allowed
    return np.logical_or.reduceat(near, spheres.starts, axis=1)


def _rays_of(rays: TiledRays, tiles: Indices) -> Indices:
    """Return the indices of all rays of some tiles."""
    first, count = rays.starts[tiles], rays.starts[tiles + 1] - rays.starts[tiles]
    ends = np.cumsum(count)
    chosen: Indices = np.arange(ends[-1]) + np.repeat(first - (ends - count), count)
    return chosen


@dataclass(frozen=True, slots=True)
class _Grazing:
    """Rays that entered a solid's bounds without hitting it there."""

    chosen: Indices
    """(N,) which rays."""
    solids: NDArray[np.int32]
    """(N,) which solids."""
    points: Samples
    """(3, N) where they are, in the solid's frame."""
    directions: Samples
    """(3, N) their directions there."""
    done: Samples
    """(N,) how far that is along the ray, in metres."""
    ends: Samples
    """(N,) where they leave the bounds, in metres along the ray."""
    close: Samples
    """(N,) how near the surface counts as on it, in metres."""

    @staticmethod
    def joined(parts: Sequence[_Grazing]) -> _Grazing:
        """Return all of several."""
        return _Grazing(
            np.concatenate([p.chosen for p in parts]),
            np.concatenate([p.solids for p in parts]),
            np.concatenate([p.points for p in parts], axis=1),
            np.concatenate([p.directions for p in parts], axis=1),
            np.concatenate([p.done for p in parts]),
            np.concatenate([p.ends for p in parts]),
            np.concatenate([p.close for p in parts]),
        )


def _enter(
    rays: TiledRays, chosen: Indices, solid: Solid, index: int, hits: Hits, pixel_angle: float
) -> _Grazing | None:
    """Enter into the hits where rays meet the faces of a solid's bounds; return those that go on inside."""
    directions = turned_to_solid(solid.world_from_solid, rays.directions.take(chosen, axis=1))
    single = rays.origins.shape[1] == 1
    origins = to_solid(solid.world_from_solid, rays.origins if single else rays.origins.take(chosen, axis=1))
    near, far = _through_bounds(origins, directions, solid)
    inside = np.flatnonzero((near < far) & (near > 0) & (near < hits.distances.take(chosen)))
    if not len(inside):
        return None
    near, chosen = near[inside], chosen[inside]
    on_surface = np.ones(len(inside), np.bool_)
    if not solid.fills_bounds:
        directions = directions.take(inside, axis=1)
        points = (origins if single else origins.take(inside, axis=1)) + directions * near
        close = np.maximum(near * np.float32(_CLOSE_PIXELS * pixel_angle), np.float32(_CLOSE))
        gaps = solid.distance(points)
        on_surface = gaps < close
    hits.distances[chosen[on_surface]] = near[on_surface]
    hits.solids[chosen[on_surface]] = index
    left = np.flatnonzero(~on_surface)
    if not len(left):
        return None
    which = np.full(len(left), index, np.int32)
    return _Grazing(
        chosen[left], which, points[:, left], directions[:, left], near[left], far[inside[left]], close[left]
    )


def _through_bounds(origins: Samples, directions: Samples, solid: Solid) -> tuple[Samples, Samples]:
    """Return where rays enter and leave a solid's bounding box."""
    low, high = solid.low.astype(np.float32), solid.high.astype(np.float32)
    near = np.full(directions.shape[1], -np.inf, np.float32)
    far = np.full(directions.shape[1], np.inf, np.float32)
    for axis in range(3):
        inverse = 1 / _nonzero(directions[axis])
        first, second = (low[axis] - origins[axis]) * inverse, (high[axis] - origins[axis]) * inverse
        np.maximum(near, np.minimum(first, second), out=near)
        np.minimum(far, np.maximum(first, second), out=far)
    return near, far


def _settle(grazing: _Grazing, solid: Solid, hits: Hits) -> None:
    """Follow rays inside the bounds of solids of one shape, and enter where they hit."""
    length = np.minimum(grazing.ends, hits.distances[grazing.chosen]) - grazing.done
    advanced = np.zeros(len(length), np.float32)
    moving = np.flatnonzero(length > 0)
    reached = [moving[:0]]
    for _ in range(_STEPS):
        points = grazing.directions.take(moving, axis=1)
        points *= advanced.take(moving)
        points += grazing.points.take(moving, axis=1)
        gap = solid.distance(points)
        hit = gap < grazing.close[moving]
        reached.append(moving[hit])
        advanced[moving] += gap
        moving = moving[~hit & (advanced[moving] < length[moving])]
        if not len(moving):
            break
    found = np.concatenate(reached)
    # rays are entered from far to near, so that where several solids of this shape are hit the nearest stays
    distances = grazing.done[found] + advanced[found]
    found = found[np.argsort(-distances, kind="stable")]
    distances = grazing.done[found] + advanced[found]
    hits.distances[grazing.chosen[found]] = distances
    hits.solids[grazing.chosen[found]] = grazing.solids[found]
