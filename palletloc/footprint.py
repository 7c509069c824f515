"""The room that a pallet takes: which of two stand in each other."""

from __future__ import annotations

import numpy as np

from palletloc.geometry import BoolArray, FloatArray, LevelPose
from palletloc.pallet import PalletModel


def overlapping(pose: LevelPose, model: PalletModel, other: LevelPose, other_model: PalletModel) -> bool:
    """Tell whether two pallets would stand in each other.

    Parameters
    ----------
    pose, other : LevelPose
        ``forklift_from_pallet`` of both.
    model, other_model : PalletModel
        Their models.

    Returns
    -------
    bool
        Whether their front faces overlap by more than a tenth of the narrower one.
    """
    return bool(overlaps(pose.as_array(), outline(model), other.as_array(), outline(other_model)))


def outline(model: PalletModel) -> FloatArray:
    """Return (width, height, depth) of a pallet, as `overlaps` takes it."""
    return np.array([model.width, model.height, model.depth])


def overlaps(poses: FloatArray, outlines: FloatArray, others: FloatArray, other_outlines: FloatArray) -> BoolArray:
    """Tell which pallets would stand in each other, as `overlapping` does for two of them.

    Parameters
    ----------
    poses, others : (..., 4) array
        (x, y, z, yaw) of both in the same frame; the shapes are broadcast.
    outlines, other_outlines : (..., 3) array
        Their widths, heights and depths, in metres.

    Returns
    -------
    (...) array of bool
        Whether their front faces overlap by more than a tenth of the narrower one.
    """
    away = others - poses
    cos, sin = np.cos(poses[..., 3]), np.sin(poses[..., 3])
    along = np.abs(cos * away[..., 1] - sin * away[..., 0])
    across = np.abs(cos * away[..., 0] + sin * away[..., 1])
    narrower = np.minimum(outlines, other_outlines)
    together = (outlines[..., 0] + other_outlines[..., 0]) / 2 - 0.1 * narrower[..., 0]
    tall = np.maximum(outlines[..., 1], other_outlines[..., 1])
    found: BoolArray = (along < together) & (np.abs(away[..., 2]) < tall) & (across < narrower[..., 2])
    return found
