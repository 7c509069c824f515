"""What stands before a face is seen beside it, too: below a hidden stretch it looks unlike below the others."""

from __future__ import annotations

import numpy as np

from palletloc.geometry import BoolArray, FloatArray, LevelPose
from palletloc.pallet import PalletModel
from palletloc.refinement.occlusion import Spans
from palletloc.refinement.patch import FacePatch

BELOW = (-0.035, -0.012)
"""Between which heights against the face's lower edge it is looked for, in metres: the edge itself is rounded."""
COLUMNS, ROWS = 60, 4
"""Points that are looked at, along and up."""
UNLIKE = 4.0
"""Difference of colours from which on it is another thing, in spreads of the floor's or the beam's: shadows and
grain make about one."""
FEWEST = 2
"""Fewest columns of points that are compared."""
NOISE = 2.0
"""Differences below this are noise, in gray levels."""


def seen_before(patch: FacePatch, model: PalletModel, pose: LevelPose, hidden: Spans) -> float:
    """Return which part of a face's width is hidden by something that itself is seen.

    An upright, a carton or a bin reaches below the face, or covers what is seen below it. Where edges are missing
    for another reason, as beside a pallet or on another one, the floor or the beam goes on below.

    Parameters
    ----------
    patch : FacePatch
        A view around the face.
    model : PalletModel
        The pallet.
    pose : LevelPose
        ``forklift_from_pallet``.
    hidden : sequence of (left, right)
        Stretches of the face that something seems to stand before, in metres.

    Returns
    -------
    float
        From 0 to the hidden part.
    """
    if not hidden:
        return 0.0
    right = (np.arange(COLUMNS) + 0.5) / COLUMNS * model.width - model.width / 2
    colours, seen = _strip(patch, pose, right)
    behind = [(right > low) & (right < high) for low, high in hidden]
    free = seen & ~np.any(behind, axis=0)
    if np.count_nonzero(free) < FEWEST:
        return 0.0
    usual = np.median(colours[free], axis=(0, 1))
    away = np.sqrt(np.square(colours - usual).sum(axis=2))
    spread = np.hypot(np.median(away[free]), NOISE)
    total = 0.0
    for (low, high), stretch in zip(hidden, behind, strict=True):
        there = stretch & seen
        if np.count_nonzero(there) >= FEWEST and np.median(away[there]) > UNLIKE * spread:
            total += (high - low) / model.width
    return total


def _strip(patch: FacePatch, pose: LevelPose, right: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Return (columns, rows, channels) colours below a face, and which columns are seen."""
    points = np.stack(np.meshgrid(right, np.linspace(*BELOW, ROWS), indexing="ij"), axis=-1).reshape(-1, 2)
    column, row = np.rint(patch.view.grid.pixels(patch.appearing(pose, points))).astype(np.intp).T
    rows, columns = patch.smooth.shape[:2]
    inside = (column >= 0) & (row >= 0) & (column < columns) & (row < rows)
    row, column = row.clip(0, rows - 1), column.clip(0, columns - 1)
    inside &= patch.view.valid[row, column]
    colours = patch.smooth[row, column].reshape(len(right), ROWS, -1).astype(np.float64)
    return colours, np.asarray(inside.reshape(-1, ROWS).all(axis=1))
