"""What lies between the edges of a face: blocks that are alike, and openings that are not like the blocks."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np

from palletloc.geometry import FloatArray, Image
from palletloc.pallet import PalletModel
from palletloc.plane import PlaneGrid, PlaneView

SMOOTHING = 0.006
"""Standard deviation of the smoothing before colours are compared, in metres."""
NOISE = 2.0
"""Differences below this are noise, in gray levels."""
MARGIN = 0.15
"""Part of a block's or an opening's size that is left out on each side."""

Placing = Callable[[FloatArray], FloatArray]
"""Maps (n, 2) points of the face to points of the viewed plane, in metres."""


def face_contrast(view: PlaneView, model: PalletModel) -> float:
    """Return how clearly openings differ from blocks on a view of the face at its pose.

    Parameters
    ----------
    view : PlaneView
        The front face.
    model : PalletModel
        The pallet.

    Returns
    -------
    float
        As `opening_contrast` has it.
    """
    return opening_contrast(smoothed(view.image, view.grid), view.grid, model, lambda points: points)


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
    low = max(min(opening.bottom for opening in model.openings), 0.01)
    high = min(opening.top for opening in model.openings)
    spans = [*model.blocks, *((opening.left, opening.right) for opening in model.openings)]
    patches = _patches(image, grid, np.array(spans), (low, high), placing)
    if any(patch.size == 0 for patch in patches):
        return 0.0
    blocks, openings = patches[: len(model.blocks)], patches[len(model.blocks) :]
    means = np.array([block.mean(axis=0) for block in blocks])
    center = means.mean(axis=0)
    within = float(np.mean([block.var(axis=0).sum() for block in blocks]))
    between = float(((means - center) ** 2).sum(axis=1).mean())
    spread = float(np.sqrt(within + between + NOISE**2))
    return min(float(np.sqrt(np.median(((colours - center) ** 2).sum(axis=1)))) / spread for colours in openings)


def _patches(
    image: Image, grid: PlaneGrid, spans: FloatArray, height: tuple[float, float], placing: Placing
) -> list[FloatArray]:
    """Return the colours inside rectangles of the face, without their margins, each (n, channels)."""
    low, high = height[0] + MARGIN * (height[1] - height[0]), height[1] - MARGIN * (height[1] - height[0])
    margin = MARGIN * (spans[:, 1] - spans[:, 0])
    corners = np.stack(
        [
            np.stack([spans[:, 0] + margin, np.full(len(spans), high)], axis=1),
            np.stack([spans[:, 1] - margin, np.full(len(spans), low)], axis=1),
        ]
    )
    pixels = np.rint(grid.pixels(placing(corners.reshape(-1, 2)))).astype(int).reshape(2, -1, 2)
    channels = 1 if image.ndim == 2 else image.shape[2]
    return [
        image[max(r0, 0) : max(r1 + 1, 0), max(c0, 0) : max(c1 + 1, 0)].reshape(-1, channels).astype(np.float64)
        for (c0, r0), (c1, r1) in zip(*pixels, strict=True)
    ]
