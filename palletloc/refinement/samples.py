"""Points of a face's drawing to look at: on its edges, where there should be some, and in its blocks, where not."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from palletloc.face import face_edges
from palletloc.geometry import FloatArray
from palletloc.pallet import PalletModel
from palletloc.template import BLOCK_WEIGHT, UPRIGHT_WEIGHT

LEVEL_SPACING = 0.05
"""Distance between points on level edges, in metres."""
UPRIGHT_POINTS = 4
"""Points on an upright edge."""
BLOCK_POINTS = (4, 3)
"""Points in a block, along and up."""
BLOCK_MARGIN = 0.02
"""What is left out at the sides of a block at most, in metres."""


@dataclass(frozen=True, slots=True)
class FaceSamples:
    """Points on the drawn face; the arrays are shared and read-only."""

    level: FloatArray
    """(n, 2) on level edges: right and up, in metres."""
    upright: FloatArray
    """(m, 2) on upright edges."""
    block: FloatArray
    """(k, 2) inside blocks."""
    level_weight: FloatArray
    """(n,) parts in the score; with those of the upright edges they add up to 1."""
    upright_weight: FloatArray
    """(m,)."""
    block_weight: FloatArray
    """(k,) negative."""
    points: FloatArray
    """(n + m + k, 2) all of them, in this order."""


@lru_cache(maxsize=64)
def face_samples(model: PalletModel) -> FaceSamples:
    """Spread points over a model's face.

    Parameters
    ----------
    model : PalletModel
        The pallet.

    Returns
    -------
    FaceSamples
        Evenly along the edges.
    """
    points: dict[bool, list[FloatArray]] = {True: [], False: []}
    weights: dict[bool, list[FloatArray]] = {True: [], False: []}
    for edge in face_edges(model):
        count = max(2, round(edge.length / LEVEL_SPACING)) if edge.horizontal else UPRIGHT_POINTS
        part = ((np.arange(count) + 0.5) / count)[:, None]
        points[edge.horizontal].append(np.array(edge.start) * (1 - part) + np.array(edge.end) * part)
        weight = edge.length if edge.horizontal else UPRIGHT_WEIGHT * edge.length
        weights[edge.horizontal].append(np.full(count, weight / count))
    level, upright = (np.concatenate(points[horizontal]) for horizontal in (True, False))
    level_weight, upright_weight = (np.concatenate(weights[horizontal]) for horizontal in (True, False))
    total = float(level_weight.sum() + upright_weight.sum())
    block = _inside_blocks(model)
    arrays = (
        level,
        upright,
        block,
        level_weight / total,
        upright_weight / total,
        np.full(len(block), -BLOCK_WEIGHT / max(len(block), 1)),
        np.concatenate([level, upright, block]),
    )
    for array in arrays:
        array.flags.writeable = False
    return FaceSamples(*arrays)


def _inside_blocks(model: PalletModel) -> FloatArray:
    """Return points in the solid parts beside and between the openings."""
    low = min(opening.bottom for opening in model.openings) + BLOCK_MARGIN
    high = max(opening.top for opening in model.openings) - BLOCK_MARGIN
    along, up = ((np.arange(count) + 0.5) / count for count in BLOCK_POINTS)
    margins = [min(BLOCK_MARGIN, (right - left) / 4) for left, right in model.blocks]
    blocks = [(left + aside, right - aside) for (left, right), aside in zip(model.blocks, margins, strict=True)]
    points = [
        np.stack(np.meshgrid(left + along * (right - left), low + up * (high - low)), axis=-1).reshape(-1, 2)
        for left, right in blocks
        if right > left and high > low
    ]
    return np.concatenate(points) if points else np.zeros((0, 2))
