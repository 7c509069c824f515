"""The body of a pallet, made from the front face of its model.

The front face is exactly the model's: outline, openings, corners, rounded edges. Behind it, blocks stand in
rows with the front's profile, joined by a deck above and, where openings are open at the floor, by runners below.
Where the model does not say where the rows are, there are three of them; a pallet whose blocks are as narrow as
stringers then has one row of the whole depth.
"""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from palletloc.geometry import FloatArray, LevelPose
from palletloc.pallet import Opening, PalletModel
from palletloc.synthetic.samples import Samples, lengths
from palletloc.synthetic.scene import Box, Decal, Material

_ROW_SHARE = 0.125
"""Depth of a row of blocks where the model has none, in parts of the pallet's: 100 mm of 800 mm."""
_STRINGER = 0.07
"""Width below which what stands between openings is a stringer of the whole depth, in metres."""
_BOARD = 0.024
"""Thickness of deck, runners and bottom boards, in metres: about the 22 mm of common boards."""
_SEAM = 0.0012
"""Half width of the dark seam between boards, in metres."""
_DECK_PITCH, _DECK_BOARD = 0.185, 0.145
"""From deck board to deck board, and width of one, in metres: the wide boards of an EPAL 1."""


def _round_rectangle(
    right: Samples, up: Samples, center: tuple[float, float], half: tuple[float, float], radius: float
) -> Samples:
    """Return the signed distance to a rectangle with rounded corners."""
    qx = np.abs(right - np.float32(center[0])) - np.float32(half[0] - radius)
    qy = np.abs(up - np.float32(center[1])) - np.float32(half[1] - radius)
    inside = np.minimum(np.maximum(qx, qy), 0)
    distance: Samples = _length(np.maximum(qx, 0), np.maximum(qy, 0)) + inside
    return distance - np.float32(radius)


def _rounded_both(a: Samples, b: Samples, radius: float) -> Samples:
    """Return the distance to where both hold, with the edge between them rounded."""
    a, b = a + np.float32(radius), b + np.float32(radius)
    both: Samples = _length(np.maximum(a, 0), np.maximum(b, 0)) + np.minimum(np.maximum(a, b), 0)
    return both - np.float32(radius)


def _length(a: Samples, b: Samples) -> Samples:
    # np.hypot guards against overflow and is several times slower
    length: Samples = np.sqrt(a * a + b * b)
    return length


@dataclass(frozen=True)
class PalletBody:
    """A pallet as a solid, in the pallet frame: the origin is the middle of the front face's lower edge."""

    world_from_solid: LevelPose
    """Where it is."""
    model: PalletModel
    """The front face and the depth."""
    material: Material
    """How its surface reflects light."""
    planks: bool = True
    """Whether it is made of boards, which differ and have seams, rather than moulded."""
    decals: tuple[Decal, ...] = field(default=())
    """None: labels belong on boxes."""

    @property
    def low(self) -> FloatArray:
        """(3,) lower corner of its bounding box."""
        return np.array([0.0, -self.model.width / 2, 0.0])

    @property
    def high(self) -> FloatArray:
        """(3,) upper corner of its bounding box."""
        return np.array([self.model.depth, self.model.width / 2, self.model.height])

    @property
    def fills_bounds(self) -> bool:
        """Return False: it has openings."""
        return False

    @property
    def shape(self) -> Hashable:
        """The model."""
        return self.model

    @cached_property
    def opening_top(self) -> float:
        """Height of the upper edge of the highest opening, in metres."""
        return max((o.bottom + o.height for o in self.model.openings), default=self.model.height - _BOARD)

    @cached_property
    def stands(self) -> tuple[tuple[float, float], ...]:
        """What stands between the openings, as (right, right) intervals in metres."""
        half, edges = self.model.width / 2, []
        left = -half
        for opening in sorted(self.model.openings, key=lambda o: o.center):
            edges.append((left, opening.center - opening.width / 2))
            left = opening.center + opening.width / 2
        return (*edges, (left, half))

    @cached_property
    def rows(self) -> tuple[tuple[float, float], ...]:
        """Rows of blocks as (front, back) intervals of x, in metres."""
        depth = self.model.depth
        if self.model.block_rows:
            return self.model.block_rows
        if min(right - left for left, right in self.stands) < _STRINGER:
            return ((0.0, depth),)
        thick = _ROW_SHARE * depth
        return ((0.0, thick), ((depth - thick) / 2, (depth + thick) / 2), (depth - thick, depth))

    @cached_property
    def beams(self) -> tuple[tuple[FloatArray, FloatArray], ...]:
        """What joins the rows: (low, high) corners of the deck and of the runners."""
        model = self.model
        deck = model.height - min(model.height - self.opening_top, _BOARD)
        joined = [(np.array([0.0, self.low[1], deck]), self.high)]
        if any(o.open_below for o in model.openings) and len(self.rows) > 1:
            joined += [
                (np.array([0.0, -right, 0.0]), np.array([model.depth, -left, _BOARD])) for left, right in self.stands
            ]
        return tuple(joined)

    def distance(self, points: Samples) -> Samples:
        """Return a lower bound of the distance to the surface, exact near it."""
        x, right, up = points[0], -points[1], points[2]
        radius = self.model.edge_radius
        front = self._profile(right, up)
        nearest: Samples | None = None
        for start, end in self.rows:
            along = np.abs(x - np.float32((start + end) / 2)) - np.float32((end - start) / 2)
            row = _rounded_both(front, along, radius)
            nearest = row if nearest is None else np.minimum(nearest, row)
        for low, high in self.beams:
            center, half = ((low + high) / 2).astype(np.float32), ((high - low) / 2).astype(np.float32)
            rounding = np.float32(min(radius, 0.9 * float(half.min())))
            q = np.abs(points - center[:, None]) - (half - rounding)[:, None]
            outside = np.maximum(q, 0)
            beam = lengths(outside) + np.minimum(q.max(axis=0), 0) - rounding
            nearest = beam if nearest is None else np.minimum(nearest, beam)
        return front if nearest is None else nearest

    def _profile(self, right: Samples, up: Samples) -> Samples:
        """Return the signed distance to the front face in its plane: exact inside, a bound outside."""
        model = self.model
        face = _round_rectangle(
            right, up, (0.0, model.height / 2), (model.width / 2, model.height / 2), model.corner_radius
        )
        for opening in model.openings:
            face = np.maximum(face, -self._hole(opening, right, up))
        return face

    @staticmethod
    def _hole(opening: Opening, right: Samples, up: Samples) -> Samples:
        top = opening.bottom + opening.height
        bottom = -top if opening.open_below else opening.bottom
        center, half = (opening.center, (top + bottom) / 2), (opening.width / 2, (top - bottom) / 2)
        return _round_rectangle(right, up, center, half, opening.radius)

    def normals(self, points: Samples) -> Samples:
        """Return the outward unit normals at points of the surface, from differences of the distance."""
        step = np.float32(2e-4)
        normals = np.empty_like(points)
        for axis in range(3):
            shift = np.zeros((3, 1), np.float32)
            shift[axis] = step
            normals[axis] = self.distance(points + shift) - self.distance(points - shift)
        normals /= np.maximum(lengths(normals), np.float32(1e-12))
        return normals

    def tint(self, points: Samples, normals: Samples) -> Samples:
        """Return the brightness of each board and the dark seams between boards."""
        tint = np.ones(points.shape[1], np.float32)
        if not self.planks:
            return tint
        x, right, up = points[0], -points[1], points[2]
        deck, board = np.float32(self.beams[0][0][2]), np.float32(_BOARD - 0.002)
        layer = (up > deck).astype(np.int64) + (up > board)
        stand = np.searchsorted([left for left, _ in self.stands[1:]], right)
        on_deck = (normals[2] > 0.7) & (layer == 2)
        row = np.floor((x + np.float32(0.01)) / np.float32(_DECK_PITCH)).astype(np.int64)
        piece = np.where(layer == 1, 3 + stand, layer) + 16 * row
        shades = 1 + 0.09 * np.random.default_rng(self.material.seed).standard_normal(1024)
        tint *= shades[piece % 1024].astype(np.float32)
        seam = (np.abs(up - deck) < _SEAM) | ((np.abs(up - board) < _SEAM) & (layer < 2))
        gap = on_deck & (x % np.float32(_DECK_PITCH) > _DECK_BOARD)
        tint[seam] *= np.float32(0.72)
        tint[gap] *= np.float32(0.15)
        return tint

    def blocks(self) -> tuple[Box, ...]:
        """Return sharp boxes that cast about the same shadow: deck, runners, blocks, bottom boards."""
        pieces = list(self.beams)
        for start, end in self.rows:
            pieces += [
                (np.array([start, -right, 0.0]), np.array([end, -left, self.model.height]))
                for left, right in self.stands
            ]
            pieces += [
                (np.array([start, -o.center - o.width / 2, 0.0]), np.array([end, -o.center + o.width / 2, o.bottom]))
                for o in self.model.openings
                if not o.open_below
            ]
        return tuple(self._box(low, high) for low, high in pieces)

    def _box(self, low: FloatArray, high: FloatArray) -> Box:
        center, size = (low + high) / 2, high - low
        pose = self.world_from_solid
        cos, sin = np.cos(pose.yaw), np.sin(pose.yaw)
        return Box(
            LevelPose(
                float(pose.x + cos * center[0] - sin * center[1]),
                float(pose.y + sin * center[0] + cos * center[1]),
                float(pose.z + center[2]),
                pose.yaw,
            ),
            (float(size[0]), float(size[1]), float(size[2])),
            self.material,
        )
