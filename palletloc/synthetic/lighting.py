"""Kinds of light, and soft shadows: how much of it reaches each point, from depth maps along each direction."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from palletloc.choices import Illumination
from palletloc.geometry import FloatArray
from palletloc.synthetic.samples import Samples, lookup
from palletloc.synthetic.scene import Box, Light, Scene
from palletloc.synthetic.tracing import to_world

_SKY, _KEY = 18, 5
"""Directions of the sky and of the strongest lamp: so many that shadows have no visible steps."""
_KEY_SHARE = {
    Illumination.EVEN: 0.15,
    Illumination.LAMPS: 0.35,
    Illumination.WINDOW: 0.55,
    Illumination.SPOT: 0.65,
    Illumination.DIM: 0.3,
}
"""Share of the strongest lamp in the light of level ground: the more, the harder the shadows."""
_SHARP_TEXEL, _SOFT_TEXEL, _FLOOR_TEXEL = 0.015, 0.03, 0.025
"""Pixels of the depth maps of lamp and sky and of the floor's map, in metres:
finer ones cost memory, coarser ones blur the shadows of thin things."""
_LIFT_TEXELS, _SOFT_TEXELS = 1.5, 1.0
"""How far points are lifted off their surface, lest it shade itself, and the depth of a shadow's edge, in texels."""
_MARGIN = 2.0
"""Of the floor's map around the shadows that solids cast on it, in metres."""
_NOTHING = -1e3
"""Depth where no solid is, in metres: farther than any."""
_THIN = 0.13
"""Thickness below which a solid casts no shadow from the sky, in metres: uprights and boards, of which a soft shadow
is too faint to be seen."""


def light_of(kind: Illumination, rng: np.random.Generator) -> Light:
    """Return a light of some kind, with directions, tint and strength drawn at random."""
    share = _KEY_SHARE[kind]
    low = kind is Illumination.WINDOW
    elevation = np.radians(rng.uniform(22, 40) if low else rng.uniform(50, 80))
    heading = rng.uniform(-np.pi, np.pi)
    spread = np.radians(1.5 if kind is Illumination.SPOT else 4.0)
    key = _directions(elevation + spread * rng.standard_normal(_KEY), heading + spread * rng.standard_normal(_KEY))
    sky = _sky(rng)
    # level ground in full light has irradiance 1, of which the key lamp gives its share
    key_weight = share / key[:, 2].sum()
    sky_weight = (1 - share) / sky[:, 2].sum()
    strength = float(rng.uniform(0.8, 1.15)) * (0.25 if kind is Illumination.DIM else 1.0)
    warm = float(rng.uniform(-0.12, 0.12))
    return Light(
        tuple((float(x), float(y), float(z)) for x, y, z in np.concatenate([key, sky])),
        tuple([float(key_weight)] * _KEY + [float(sky_weight)] * _SKY),
        sharp=_KEY,
        bounce=float(rng.uniform(0.3, 0.45)),
        colour=(strength * (1 - warm), strength, strength * (1 + warm)),
        pools=float(rng.uniform(0.3, 0.7)) if kind is Illumination.LAMPS else 0.0,
        pool_spacing=float(rng.uniform(3.0, 6.0)),
        slope=float(rng.choice([-1, 1]) * rng.uniform(0.06, 0.12)) if low else 0.0,
    )


def _directions(elevations: FloatArray, headings: FloatArray) -> FloatArray:
    level = np.cos(elevations)
    return np.stack([level * np.cos(headings), level * np.sin(headings), np.sin(elevations)], -1)


def _sky(rng: np.random.Generator) -> FloatArray:
    """Return directions spread over the upper half, down to what white walls send back."""
    turn = np.pi * (3 - np.sqrt(5))
    heights = (np.arange(_SKY) + 0.5) / _SKY * 0.9 + 0.06
    return _directions(np.arcsin(heights), turn * np.arange(_SKY) + rng.uniform(0, 2 * np.pi))


@dataclass(frozen=True, slots=True)
class _DepthMap:
    """The solids as seen against one direction of the light."""

    axes: FloatArray
    """(3, 3) rows: right, up, towards the light; unit vectors in the world."""
    corner: tuple[float, float]
    """``right`` and ``up`` of the first column and row, in metres."""
    depth: Samples
    """(rows, columns): how far towards the light the nearest solid reaches, in metres."""
    texel: float
    """Metres per pixel."""


@dataclass(frozen=True, slots=True)
class LightField:
    """The light of a scene, ready to be looked up."""

    light: Light
    """Where it comes from."""
    maps: tuple[_DepthMap, ...]
    """One for each direction; empty where nothing casts a shadow."""
    floor: Samples
    """(rows, columns) irradiance of the floor."""
    floor_corner: tuple[float, float]
    """World x and y of its first column and row, in metres."""

    def on_floor(self, x: Samples, y: Samples) -> Samples:
        """Return the (N,) irradiance of the floor at points of the world."""
        return lookup(
            self.floor,
            (x - np.float32(self.floor_corner[0])) / np.float32(_FLOOR_TEXEL),
            (y - np.float32(self.floor_corner[1])) / np.float32(_FLOOR_TEXEL),
            outside=self.light.open_ground,
        )

    def unshadowed(self, points: Samples, normals: Samples) -> Samples:
        """Return the (N,) irradiance as if no solid stood in the way."""
        return LightField(self.light, (), self.floor, self.floor_corner).irradiance(points, normals)

    def irradiance(self, points: Samples, normals: Samples) -> Samples:
        """Return the (N,) irradiance at (3, N) points of surfaces with (3, N) normals, in the world."""
        lit = np.zeros(points.shape[1], np.float32)
        lifted = {texel: points + np.float32(_LIFT_TEXELS * texel) * normals for texel in (_SHARP_TEXEL, _SOFT_TEXEL)}
        for index, direction in enumerate(self.light.directions):
            facing = np.array(direction, np.float32) @ normals
            facing *= np.float32(self.light.weights[index])
            lit_side = np.flatnonzero(facing > 0)
            facing = facing[lit_side]
            if index < len(self.maps):
                where = lifted[self.maps[index].texel].take(lit_side, axis=1)
                facing *= _visible(self.maps[index], where)
            lit[lit_side] += facing
        lit += np.float32(self.light.bounce / 2) * (1 - normals[2]) * self.on_floor(points[0], points[1])
        return lit


def light_field(scene: Scene) -> LightField:
    """Work out the shadows of a scene by its solids and light."""
    boxes = [box for solid in scene.solids for box in solid.blocks()]
    corners = [_corners(box) for box in boxes]
    thick = [i for i, box in enumerate(boxes) if sorted(box.size)[1] > _THIN]
    maps = tuple(
        _depth_map(boxes, corners, range(len(boxes)), direction, _SHARP_TEXEL)
        if i < scene.light.sharp
        else _depth_map(boxes, corners, thick, direction, _SOFT_TEXEL)
        for i, direction in enumerate(scene.light.directions)
    )
    low, high = _shaded_floor(scene, corners)
    columns, rows = (np.ceil((high - low) / _FLOOR_TEXEL).astype(int) + 1).tolist()
    x = low[0] + np.arange(columns) * _FLOOR_TEXEL
    y = low[1] + np.arange(rows) * _FLOOR_TEXEL
    points = np.zeros((3, rows * columns), np.float32)
    points[0], points[1] = np.tile(x, rows), np.repeat(y, columns)
    up = np.zeros_like(points)
    up[2] = 1.0
    dark = LightField(scene.light, maps, np.zeros((1, 1), np.float32), (0.0, 0.0))  # level ground sees no floor
    floor = dark.irradiance(points, up).reshape(rows, columns)
    return LightField(scene.light, maps, floor, (float(low[0]), float(low[1])))


def _shaded_floor(scene: Scene, corners: Sequence[FloatArray]) -> tuple[FloatArray, FloatArray]:
    """Return the corners of the part of the floor that lies in the shadows of the lamp, and around solids."""
    room_low, room_high = np.array(scene.room.low), np.array(scene.room.high)
    if not corners:
        return room_low, room_low
    points = np.concatenate(corners, axis=1)
    feet = [points[:2]]
    feet += [points[:2] - np.outer(d[:2], points[2] / d[2]) for d in scene.light.directions[: scene.light.sharp]]
    reached = np.concatenate(feet, axis=1)
    low = np.maximum(room_low, reached.min(axis=1) - _MARGIN)
    return low, np.minimum(room_high, reached.max(axis=1) + _MARGIN)


def _visible(depth_map: _DepthMap, points: Samples) -> Samples:
    """Return how much of one direction's light reaches points, 0 to 1."""
    right, up, depth = depth_map.axes.astype(np.float32) @ points
    reach = lookup(
        depth_map.depth,
        (right - np.float32(depth_map.corner[0])) / np.float32(depth_map.texel),
        (up - np.float32(depth_map.corner[1])) / np.float32(depth_map.texel),
        outside=_NOTHING,
    )
    reach -= depth
    reach /= np.float32(-_SOFT_TEXELS * depth_map.texel)
    reach += 1
    return np.clip(reach, 0, 1, out=reach)


def _corners(box: Box) -> FloatArray:
    """Return the (3, 8) corners of a box in the world."""
    signs = np.array(np.meshgrid([-1.0, 1.0], [-1.0, 1.0], [-1.0, 1.0])).reshape(3, 8)
    return to_world(box.world_from_solid, signs * box.high[:, None])


def _depth_map(
    boxes: Sequence[Box],
    corners: Sequence[FloatArray],
    chosen: Sequence[int],
    direction: tuple[float, float, float],
    texel: float,
) -> _DepthMap:
    """Return the depth map of chosen boxes, seen against one direction."""
    towards = np.array(direction)
    right = np.cross([0.0, 0.0, 1.0] if abs(towards[2]) < 0.9 else [1.0, 0.0, 0.0], towards)
    right /= np.linalg.norm(right)
    axes = np.stack([right, np.cross(towards, right), towards])
    if not len(chosen):
        return _DepthMap(axes, (0.0, 0.0), np.full((1, 1), _NOTHING, np.float32), texel)
    spans = [(axes[:2] @ corners[i]) / texel for i in chosen]
    first = np.floor(np.min([s.min(axis=1) for s in spans], axis=0)).astype(int) - 1
    last = np.ceil(np.max([s.max(axis=1) for s in spans], axis=0)).astype(int) + 1
    columns, rows = (last - first + 1).tolist()
    depth_map = _DepthMap(
        axes,
        (float(first[0] * texel), float(first[1] * texel)),
        np.full((rows, columns), _NOTHING, np.float32),
        texel,
    )
    for index, span in zip(chosen, spans, strict=True):
        _draw(depth_map, boxes[index], span)
    return depth_map


def _draw(depth_map: _DepthMap, box: Box, span: FloatArray) -> None:
    """Draw one box into a depth map; ``span`` holds its corners in pixels from the map's zero."""
    first = np.round(np.array(depth_map.corner) / depth_map.texel).astype(int)
    low, high = np.floor(span.min(axis=1)).astype(int), np.ceil(span.max(axis=1)).astype(int)
    right = np.arange(low[0], high[0] + 1) * depth_map.texel
    up = np.arange(low[1], high[1] + 1) * depth_map.texel
    pose = box.world_from_solid
    cos, sin = np.cos(pose.yaw), np.sin(pose.yaw)
    solid_axes = np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]])
    local = solid_axes @ depth_map.axes.T
    middle = solid_axes @ [pose.x, pose.y, pose.z]
    bounds: list[tuple[Samples, Samples]] = []
    for axis in range(3):
        slope = local[axis, 2] if abs(local[axis, 2]) > 1e-9 else 1e-9
        across = ((up * local[axis, 1]) / -slope).astype(np.float32)[:, None] + (
            (right * local[axis, 0] - middle[axis]) / -slope
        ).astype(np.float32)
        half = np.float32(box.size[axis] / 2 / abs(slope))
        bounds.append((across - half, across + half))
    near = np.maximum(np.maximum(bounds[0][0], bounds[1][0]), bounds[2][0])
    far = np.minimum(np.minimum(bounds[0][1], bounds[1][1]), bounds[2][1])
    start, end = low - first, high - first + 1
    part = depth_map.depth[start[1] : end[1], start[0] : end[0]]
    np.maximum(part, far, out=part, where=near < far)
