"""What lies between the edges of a face at a pose: openings that are not like the blocks beside them."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from palletloc.geometry import BoolArray, FloatArray, LevelPose
from palletloc.pallet import PalletModel
from palletloc.refinement.occlusion import Spans, hidden_part
from palletloc.refinement.patch import FacePatch

POINTS = (9, 5)
"""Points in each block and each opening, along and up: odd in all, for one of them to be the middle one."""
MARGIN = 0.15
"""Part of a block's or an opening's size that is left out on each side."""
SHOWN = 0.7
"""Least part of a block or an opening that nothing stands before where it counts."""
NOISE = 2.0
"""Differences below this are noise, in gray levels."""


def opening_contrasts(patch: FacePatch, model: PalletModel, pose: LevelPose, hidden: Spans = ()) -> FloatArray:
    """Return how clearly each opening differs from the blocks beside it.

    Parameters
    ----------
    patch : FacePatch
        A view around the face.
    model : PalletModel
        The pallet.
    pose : LevelPose
        ``forklift_from_pallet``.
    hidden : sequence of (left, right)
        Stretches of the face that something stands before, in metres: what they cover does not count.

    Returns
    -------
    (openings,) array
        Median distance of an opening's colours from the mean of the two blocks beside it, over the spread of those
        (within and between them). About 1 where there is no opening; what is seen through one may be dark and
        bright at once, so its mean colour says little. NaN where the view does not reach.
    """
    points = _points(model)
    colours, inside = patch.colours(pose, points.reshape(-1, 2))
    if not inside.all():
        return np.full(len(model.openings), np.nan)
    seen = colours.reshape(*points.shape[:2], -1)
    weight, part = _weights(points, hidden)
    count = len(model.blocks)
    mean = np.einsum("bn,bnc->bc", weight[:count], seen[:count])
    within = np.einsum("bn,bn->b", weight[:count], _squares(seen[:count] - mean[:, None]))
    left, right = _shares(part[:count])
    center = left[:, None] * mean[:-1] + right[:, None] * mean[1:]
    between = left * right * ((mean[:-1] - mean[1:]) ** 2).sum(axis=1)
    spread = np.sqrt(left * within[:-1] + right * within[1:] + between + NOISE**2)
    away = _squares(seen[count:] - center[:, None])
    away = np.sort(np.where(weight[count:] > 0, away, np.inf), axis=1)
    middle = np.count_nonzero(weight[count:], axis=1) // 2
    return np.asarray(np.sqrt(away[np.arange(len(away)), middle]) / spread)


def shown_openings(model: PalletModel, hidden: Spans) -> BoolArray:
    """Return (openings,) which of a face's openings are seen well enough to be compared with the blocks."""
    return np.array([1 - hidden_part(one.left, one.right, hidden) >= SHOWN for one in model.openings])


def _weights(points: FloatArray, hidden: Spans) -> tuple[FloatArray, FloatArray]:
    """Return (blocks and openings, n) weights of points that sum up to 1, and which part of each nothing hides."""
    right = points[..., 0]
    seen = np.ones(right.shape)
    if not hidden:
        return seen / right.shape[1], seen[:, 0]
    for low, high in hidden:
        seen[(right > low) & (right < high)] = 0.0
    part = seen.mean(axis=1)
    seen[part == 0] = 1.0
    return seen / seen.sum(axis=1, keepdims=True), part


def _shares(part: FloatArray) -> FloatArray:
    """Return what the left and the right block beside each opening count, (2, openings), by what is seen of each."""
    shown = part >= SHOWN
    # where one block is hidden the other has to do, where both are it makes no difference
    both = np.where(shown[:-1] | shown[1:], np.stack([shown[:-1], shown[1:]]), True)
    return np.asarray(both / both.sum(axis=0))


def _squares(colours: FloatArray) -> FloatArray:
    """Return the squared sizes of colour differences, the last axis."""
    return np.asarray(np.einsum("bnc,bnc->bn", colours, colours))


@lru_cache(maxsize=64)
def _points(model: PalletModel) -> NDArray[np.float64]:
    """Return (blocks and openings, n, 2) points between the edges."""
    low = max(min(opening.bottom for opening in model.openings), 0.01)
    high = min(opening.top for opening in model.openings)
    spans = np.array([*model.blocks, *((opening.left, opening.right) for opening in model.openings)])
    along, up = (MARGIN + (1 - 2 * MARGIN) * (np.arange(count) + 0.5) / count for count in POINTS)
    right = spans[:, :1] + along * (spans[:, 1:] - spans[:, :1])
    height = low + up * (high - low)
    points = np.stack(np.broadcast_arrays(right[:, :, None], height), axis=-1)
    return points.reshape(len(spans), -1, 2)
