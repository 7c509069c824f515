"""What lies between the edges of a face: blocks that are alike, and openings that are not like the blocks."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np

from palletloc.geometry import BoolArray, FloatArray, Image
from palletloc.pallet import PalletModel
from palletloc.plane import PlaneGrid

SMOOTHING = 0.006
"""Standard deviation of the smoothing before colours are compared, in metres."""
NOISE = 2.0
"""Differences below this are noise, in gray levels."""
MARGIN = 0.15
"""Part of a block's or an opening's size that is left out on each side."""

Placing = Callable[[FloatArray], FloatArray]
"""Maps (n, 2) points of the face to points of the viewed plane, in metres."""


def smoothed(image: Image, grid: PlaneGrid) -> Image:
    """Return a view's image without what noise and grain do to colours."""
    return np.asarray(cv2.GaussianBlur(image, (0, 0), max(SMOOTHING / grid.resolution, 0.5)), dtype=np.uint8)


def opening_contrast(image: Image, grid: PlaneGrid, model: PalletModel, placing: Placing) -> float:
    """Return how clearly the openings differ from the blocks.

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
    float
        For the less clear opening: median distance of its pixels from the blocks' mean colour, over the spread
        of the blocks (within and between them). About 1 where there is no opening; what is seen through one may
        be dark and bright at once, so its mean colour says little. 0 where the view does not reach.
    """
    return float(opening_contrasts(image, grid, model, lambda points: placing(points)[None])[0])


def opening_contrasts(image: Image, grid: PlaneGrid, model: PalletModel, placing: Placing) -> FloatArray:
    """Return what `opening_contrast` does for many places of the face at once.

    Parameters
    ----------
    image, grid, model
        As for `opening_contrast`.
    placing : callable
        Maps (n, 2) points of the face to (m, n, 2) points of the viewed plane, in metres.

    Returns
    -------
    (m,) array
        The contrast at each place.
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
    low = max(min(opening.bottom for opening in model.openings), 0.01)
    high = min(opening.top for opening in model.openings)
    spans = np.array([*model.blocks, *((opening.left, opening.right) for opening in model.openings)])
    across, up = MARGIN * (spans[:, 1] - spans[:, 0]), MARGIN * (high - low)
    first = np.stack([spans[:, 0] + across, np.full(len(spans), high - up)], axis=1)
    last = np.stack([spans[:, 1] - across, np.full(len(spans), low + up)], axis=1)
    columns, rows = (np.abs(last - first).max(axis=0) / resolution).round().astype(int) + 1
    return np.concatenate([first, last]), (int(columns), int(rows))


def _inside(pixels: FloatArray, size: int) -> BoolArray:
    """Tell which rows of pixels lie inside the view at least in part."""
    return np.asarray(((pixels >= 0) & (pixels < size)).any(axis=-1))
