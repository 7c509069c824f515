"""Pose hypotheses scored in the image: are there edges of the right direction where the face would have them.

Hypotheses vary in yaw, in distance along the viewing ray and along the face; each costs a few dozen look-ups in a
view of one plane, on which faces at any pose appear by central projection.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import cv2
import numpy as np

from palletloc.geometry import FloatArray, LevelPose
from palletloc.matching import Energy
from palletloc.pallet import PalletModel
from palletloc.refinement.occlusion import Spans
from palletloc.refinement.patch import FacePatch
from palletloc.refinement.samples import face_samples

MOST_ROWS = 32_000
"""Most rows of a map that OpenCV takes, about."""


@dataclass(frozen=True, slots=True)
class SearchConfig:
    """Where around a start a face is looked for, and how hypotheses are compared."""

    turn_deg: float = 6.0
    """How far the yaw may be off, in degrees."""
    nearer: float = 0.12
    """How far before its start the face may stand, along the viewing ray, in metres."""
    farther: float = 0.12
    """How far behind its start the face may stand, along the viewing ray, in metres."""
    sideways: float = 0.08
    """How far along the shelf from the viewing ray the face may stand, in metres."""
    upward: float = 0.06
    """How far from the viewing ray's height the face may stand where no level is known, in metres."""
    kept: int = 60
    """How many combinations of yaw, distance and height are tried at every place along the face."""
    peaks: int = 3
    """Most poses to return."""
    min_score: float = 0.15
    """Least agreement of drawing and image."""
    min_share: float = 0.7
    """Least agreement against the best one's."""
    apart: float = 0.05
    """How far poses are apart at least, in metres, ..."""
    apart_deg: float = 2.5
    """... or in degrees."""


@dataclass(frozen=True, slots=True)
class HypothesisGrid:
    """What is tried: every combination."""

    turns: FloatArray
    """(n,) yaws against the patch's plane, in radians."""
    ranges: FloatArray
    """(m,) distances over that of the patch's origin."""
    places: FloatArray
    """(k,) shifts to the right of the viewing ray, in metres."""
    rises: FloatArray
    """(h,) shifts upwards, in metres."""
    sliding: bool
    """Whether the height slides along the viewing ray, too, as it does where nothing is known of it."""


@dataclass(frozen=True, slots=True)
class Scored:
    """Hypotheses with their scores."""

    pose: LevelPose
    """``forklift_from_pallet``."""
    score: float
    """Agreement of drawing and image about there, at most 1."""


@dataclass(frozen=True, slots=True)
class HypothesisScores:
    """The search's result."""

    grid: HypothesisGrid
    """What was tried."""
    score: FloatArray
    """(turns, ranges) best agreement over places and heights; of the level edges alone where that ruled them out."""
    peaks: tuple[Scored, ...]
    """The best ones, well apart, the best first."""


def score_hypotheses(
    patch: FacePatch, model: PalletModel, grid: HypothesisGrid, config: SearchConfig
) -> HypothesisScores:
    """Score every hypothesis of a grid.

    Level edges tell yaw and distance and hardly change along the face: they are scored first, and only what they
    leave is tried at every place.

    Parameters
    ----------
    patch : FacePatch
        The view.
    model : PalletModel
        The pallet.
    grid : HypothesisGrid
        What to try.
    config : SearchConfig
        How many of them to look at closely.

    Returns
    -------
    HypothesisScores
        With the peaks.
    """
    level = _level_scores(patch, model, grid)
    shape = level.shape
    kept = min(config.kept, level.size)
    chosen = np.argpartition(level.ravel(), -kept)[-kept:]
    turn, distance, rise = np.unravel_index(chosen, shape)
    turns, ranges, rises = grid.turns[turn, None], grid.ranges[distance, None], grid.rises[rise, None]
    seen = _Hypotheses(turns, ranges, grid.places[None, :], rises, grid.sliding)
    samples = face_samples(model)
    pixels = seen.appearing(patch, samples.points[len(samples.level) :])
    score = level.ravel()[chosen, None] + _rest_scores(patch, model, *pixels)
    table = level.max(axis=2)
    np.maximum.at(table, (turn, distance), score.max(axis=1))
    best = [seen.at(*place) for place in _peaks(score, seen, patch, config)]
    peaks = _polished(patch, model, np.array(best), grid) if best else []
    peaks.sort(key=lambda peak: -peak.score)
    return HypothesisScores(grid, table, tuple(peaks))


def score_pose(patch: FacePatch, model: PalletModel, pose: LevelPose, hidden: Spans = ()) -> float:
    """Score one pose by what is not hidden of the face.

    Parameters
    ----------
    patch : FacePatch
        The view.
    model : PalletModel
        The pallet.
    pose : LevelPose
        ``forklift_from_pallet``.
    hidden : sequence of (left, right)
        Stretches of the face that something stands before, in metres.

    Returns
    -------
    float
        Agreement of drawing and image, 1 where every edge is seen and nothing inside the blocks.
    """
    samples = face_samples(model)
    turn = pose.yaw - patch.base.yaw
    slope = float(_slope(patch, model, np.array(turn)))
    parts = (
        (samples.level_weight, patch.along_level(slope)),
        (samples.upright_weight, patch.upright),
        (samples.block_weight, patch.any_direction),
    )
    columns, rows = patch.view.grid.pixels(patch.appearing(pose, samples.points)).T.astype(np.float32)
    shown = np.ones(len(columns), dtype=bool)
    for left, right in hidden:
        shown &= (samples.points[:, 0] < left) | (samples.points[:, 0] > right)
    total, edges, first = 0.0, 0.0, 0
    for weight, field in parts:
        here = slice(first, first + len(weight))
        counted = weight * shown[here]
        total += float(_looked_up(field, columns[here], rows[here]) @ counted)
        edges += float(np.maximum(counted, 0.0).sum())
        first += len(weight)
    return total / edges if edges > 0 else 0.0


class _Hypotheses(NamedTuple):
    """Hypotheses as arrays that broadcast together."""

    turn: FloatArray
    range: FloatArray
    place: FloatArray
    rise: FloatArray
    sliding: bool

    def at(self, row: int, column: int) -> FloatArray:
        """Return turn, range, place and rise of one of them."""
        return np.array([self.turn[row, 0], self.range[row, 0], self.place[0, column], self.rise[row, 0]])

    def appearing(self, patch: FacePatch, points: FloatArray) -> tuple[Energy, Energy]:
        """Return columns and rows of face points in the patch; the points make a last axis.

        Single precision is much finer than a pixel.
        """
        x, y, z = patch.plane_from_camera.tolist()
        grid, turn, distance = patch.view.grid, self.turn[..., None], self.range[..., None]
        right, up = points.T.astype(np.float32)
        aside, above = -x * distance, self.rise[..., None] - (y * distance if self.sliding else y)
        sin, cos, away, aside, above, place = (
            part.astype(np.float32)
            for part in (np.sin(turn), np.cos(turn), z * distance, aside, above, self.place[..., None])
        )
        nearer = np.float32(z / grid.resolution) / (right * sin + away)
        columns = (right * cos + aside) * nearer + np.float32((x - grid.left) / grid.resolution)
        rows = np.float32((grid.top - y) / grid.resolution) - (up + above) * nearer
        columns = columns + place * nearer
        shape = np.broadcast_shapes(columns.shape, rows.shape)
        return np.broadcast_to(columns, shape), np.broadcast_to(rows, shape)


def _pose(patch: FacePatch, sliding: bool, turn: float, distance: float, place: float, rise: float) -> LevelPose:
    """Return the pose of a hypothesis."""
    x, y, z = patch.plane_from_camera.tolist()
    farther = distance - 1
    right, depth, up = place - x * farther, farther * z, rise - (y * farther if sliding else 0.0)
    cos, sin = math.cos(patch.base.yaw), math.sin(patch.base.yaw)
    return LevelPose(
        patch.base.x + sin * right + cos * depth,
        patch.base.y - cos * right + sin * depth,
        patch.base.z + up,
        math.remainder(patch.base.yaw + turn, math.tau),
    )


def _slope(patch: FacePatch, model: PalletModel, turn: FloatArray) -> FloatArray:
    """Return the slope of the face's level lines on the plane, about the same for all of them."""
    x, y, z = patch.plane_from_camera
    return np.asarray((y - model.height / 2) * np.sin(turn) / (z * np.cos(turn) + x * np.sin(turn)))


def _looked_up(field: Energy, columns: Energy, rows: Energy) -> Energy:
    """Return a field's values at the nearest pixels, 0 outside it."""
    count = max(columns.shape[-1], 1)  # a model may have none of a kind of points
    columns, rows, values = columns.reshape(-1, count), rows.reshape(-1, count), np.empty(columns.shape, np.float32)
    found = values.reshape(-1, count)
    for first in range(0, len(found), MOST_ROWS):
        part = slice(first, first + MOST_ROWS)
        found[part] = cv2.remap(field, columns[part], rows[part], cv2.INTER_NEAREST, borderMode=cv2.BORDER_CONSTANT)
    return values


def _level_scores(patch: FacePatch, model: PalletModel, grid: HypothesisGrid) -> FloatArray:
    """Return (turns, ranges, rises) what level edges say at the place on the viewing ray."""
    samples = face_samples(model)
    weight = samples.level_weight.astype(np.float32)
    scores = np.empty((len(grid.turns), len(grid.ranges), len(grid.rises)))
    slopes = _slope(patch, model, grid.turns)
    for turns, field in patch.fields_along(slopes):  # neighbouring turns share a field
        tried = _Hypotheses(
            grid.turns[turns, None, None], grid.ranges[:, None], np.zeros(1), grid.rises, grid.sliding
        )
        scores[turns] = _looked_up(field, *tried.appearing(patch, samples.level)) @ weight
    return scores


def _rest_scores(patch: FacePatch, model: PalletModel, columns: Energy, rows: Energy) -> Energy:
    """Return what upright edges and blocks say of hypotheses, by where their points appear."""
    samples, split = face_samples(model), len(face_samples(model).upright)
    upright = _looked_up(patch.upright, columns[..., :split], rows[..., :split])
    block = _looked_up(patch.any_direction, columns[..., split:], rows[..., split:])
    weight = np.concatenate([samples.upright_weight, samples.block_weight]).astype(np.float32)
    return np.asarray(upright @ weight[:split] + block @ weight[split:])


def _peaks(
    score: FloatArray, tried: _Hypotheses, patch: FacePatch, config: SearchConfig
) -> Iterator[tuple[int, int]]:
    """Yield the best hypotheses that stand apart."""
    remaining = score.copy()
    best = float(score.max())
    for _ in range(config.peaks):
        row, column = divmod(int(remaining.argmax()), score.shape[1])
        if remaining[row, column] < max(config.min_score, config.min_share * best):
            return
        yield row, column
        turn, distance, place, rise = tried.at(row, column)
        near = (np.abs(tried.turn - turn) < np.radians(config.apart_deg)) & (np.abs(tried.rise - rise) < config.apart)
        near &= np.abs(tried.range - distance) * patch.plane_from_camera[2] < config.apart
        remaining[near & (np.abs(tried.place - place) < config.apart)] = -np.inf


def _polished(patch: FacePatch, model: PalletModel, best: FloatArray, grid: HypothesisGrid) -> list[Scored]:
    """Return the best poses between hypotheses, (n, 4), and their neighbours on the grid."""
    samples, level = face_samples(model), len(face_samples(model).level)
    steps = np.array([_step(axis) for axis in (grid.turns, grid.ranges, grid.places, grid.rises)])
    places = best[:, :, None] + _around(tuple((steps > 0).tolist())) * steps[:, None]
    turn, distance, place, rise = places.transpose(1, 0, 2)
    tried = _Hypotheses(turn, distance, place, rise, grid.sliding)
    columns, rows = tried.appearing(patch, samples.points)
    score = _rest_scores(patch, model, columns[..., level:], rows[..., level:])
    weight = samples.level_weight.astype(np.float32)
    for which, field in patch.fields_along(_slope(patch, model, best[:, 0])):
        score[which] += _looked_up(field, columns[which, :, :level], rows[which, :, :level]) @ weight
    # a plateau has no best place but a middle
    top = score >= score.max(axis=1, keepdims=True) - 0.01
    middles = np.einsum("pan,pn->pa", places, top) / np.count_nonzero(top, axis=1)[:, None]
    values = score.max(axis=1).tolist()
    return [
        Scored(_pose(patch, grid.sliding, *middle), value)
        for middle, value in zip(middles.tolist(), values, strict=True)
    ]


@lru_cache(maxsize=16)
def _around(varied: tuple[bool, ...]) -> FloatArray:
    """Return all ways to go a third of a step to and fro along some axes, (axes, n)."""
    sizes = [3 if axis else 1 for axis in varied]
    middle = np.array([size // 2 for size in sizes])
    return np.asarray(0.35 * (np.indices(sizes).reshape(len(sizes), -1) - middle[:, None]))


def _step(axis: FloatArray) -> float:
    return float(axis[1] - axis[0]) if len(axis) > 1 else 0.0
