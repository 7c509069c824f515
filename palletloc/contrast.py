"""What lies between the edges of a face: blocks that are alike, and openings that are not like the blocks.

The contrast of an opening is the median distance of its colours from the blocks' mean, over the spread of the blocks
(within and between them). About 1 where there is no opening; what is seen through one may be dark and bright at once,
so its mean colour says little.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from palletloc.geometry import BoolArray, FloatArray, Image, LevelPose
from palletloc.pallet import PalletModel
from palletloc.plane import PlaneGrid
from palletloc.refinement.occlusion import Spans, hidden_part
from palletloc.refinement.patch import FacePatch

NOISE = 2.0
"""Differences below this are noise, in gray levels."""
MARGIN = 0.15
"""Part of a block's or an opening's size that is left out on each side: edges and their blur."""
LOWEST = 0.01
"""Least height above the lower edge that is looked at, in metres: below an open one, the floor begins."""
POINTS = (9, 5)
"""Points in each block and each opening, along and up: odd in all, for one of them to be the middle one."""
SHOWN = 0.7
"""Least part of a block or an opening that nothing stands before where it counts."""

Placing = Callable[[FloatArray], FloatArray]
"""Maps (n, 2) points of the face to (m, n, 2) points of the viewed plane for m places, in metres."""


def place_contrasts(image: Image, grid: PlaneGrid, model: PalletModel, placing: Placing) -> FloatArray:
    """Return the contrast of the less clear opening against all blocks, at many places of the face at once.

    Parameters
    ----------
    image : (rows, columns) or (rows, columns, 3) array
        Smoothed view of a vertical plane.
    grid : PlaneGrid
        Of the view.
    model : PalletModel
        The pallet.
    placing : callable
        Where points of the face lie on the viewed plane.

    Returns
    -------
    (m,) array
        At each place; 0 where the view does not reach.
    """
    corners, counts = _lattice(model, grid.resolution)
    ends = grid.pixels(placing(corners)).reshape(-1, 2, len(corners) // 2, 2)
    columns, rows = (
        np.rint(ends[:, 0, :, axis, None] + (ends[:, 1, :, axis, None] - ends[:, 0, :, axis, None]) * shares)
        for axis, shares in enumerate(np.arange(count) / max(count - 1, 1) for count in counts)
    )
    inside = _inside(columns, grid.columns) & _inside(rows, grid.rows)
    rows, columns = np.clip(rows, 0, grid.rows - 1), np.clip(columns, 0, grid.columns - 1)
    at = rows[..., :, None] * grid.columns + columns[..., None, :]
    at = at.reshape(*inside.shape, counts[0] * counts[1]).astype(np.intp)
    channels = image.size // (grid.rows * grid.columns)
    colours = image.ravel().take(channels * at + np.arange(channels)[:, None, None, None]).astype(np.float32)
    blocks = len(model.blocks)
    colours -= colours[:, :, :blocks].mean(axis=(2, 3), keepdims=True)
    away = np.square(colours, out=colours).sum(axis=0)
    # all blocks have as many points, so this is the spread within them and that between them together
    spread = away[:, :blocks].mean(axis=(1, 2)) + NOISE**2
    clear = np.median(away[:, blocks:], axis=-1).min(axis=1)
    return np.where(inside.all(axis=1), np.sqrt(clear / spread), 0.0).astype(np.float64)


def _lattice(model: PalletModel, resolution: float) -> tuple[FloatArray, tuple[int, int]]:
    """Return where the colours of blocks and openings are looked up, without their margins.

    Returns (2 n, 2) corners of n rectangles, the upper left ones first, blocks before openings; and how many columns
    and rows of points each gets: as many as the widest has pixels of the view.
    """
    spans, low, high = _between_edges(model)
    across, up = MARGIN * (spans[:, 1] - spans[:, 0]), MARGIN * (high - low)
    first = np.stack([spans[:, 0] + across, np.full(len(spans), high - up)], axis=1)
    last = np.stack([spans[:, 1] - across, np.full(len(spans), low + up)], axis=1)
    columns, rows = (np.abs(last - first).max(axis=0) / resolution).round().astype(int) + 1
    return np.concatenate([first, last]), (int(columns), int(rows))


def _inside(pixels: FloatArray, size: int) -> BoolArray:
    """Tell which rows of pixels lie inside the view at least in part."""
    return np.asarray(((pixels >= 0) & (pixels < size)).any(axis=-1))


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
        Against the two blocks beside each; NaN where the view does not reach.
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


def least_contrast(
    patch: FacePatch, model: PalletModel, pose: LevelPose, hidden: Spans = (), occluders: Spans = ()
) -> float:
    """Return the contrast of the less clear opening that is seen; parameters as for `opening_contrasts`.

    What ``occluders`` are seen to cover does not count either, as long as they leave an opening. NaN where the view
    does not reach; 0 where something stands before all openings.
    """
    covered = (*hidden, *occluders)
    bare = covered if shown_openings(model, covered).any() else hidden
    shown = shown_openings(model, bare)
    return float(opening_contrasts(patch, model, pose, bare)[shown].min()) if shown.any() else 0.0


def shown_openings(model: PalletModel, hidden: Spans) -> BoolArray:
    """Return (openings,) which of a face's openings are seen well enough to be compared with the blocks."""
    return np.array([1 - hidden_part(opening.left, opening.right, hidden) >= SHOWN for opening in model.openings])


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
    spans, low, high = _between_edges(model)
    along, up = (MARGIN + (1 - 2 * MARGIN) * (np.arange(count) + 0.5) / count for count in POINTS)
    right = spans[:, :1] + along * (spans[:, 1:] - spans[:, :1])
    height = low + up * (high - low)
    points = np.stack(np.broadcast_arrays(right[:, :, None], height), axis=-1)
    return points.reshape(len(spans), -1, 2)


def _between_edges(model: PalletModel) -> tuple[FloatArray, float, float]:
    """Return left and right of all blocks, then all openings, (n, 2), and between which heights all of them lie."""
    low = max(min(opening.bottom for opening in model.openings), LOWEST)
    high = min(opening.top for opening in model.openings)
    return np.array([*model.blocks, *((opening.left, opening.right) for opening in model.openings)]), low, high
