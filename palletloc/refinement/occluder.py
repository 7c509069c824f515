"""What stands before a face is seen below it, too: there it looks unlike the floor or the beam beside it.

It tells what hides edges from a place where there are none, and blocks and openings that are covered from bare ones.
"""

from __future__ import annotations

import math

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
LIKE = 0.3
"""Difference of colours between what is seen below and on the face, over that from the floor, up to which it is one
thing."""
FEWEST = 2
"""Fewest columns of points that are compared."""
FACE_ROWS, FACE_MARGIN = 8, 0.02
"""Points on the face, upwards, and their distance from its edges, in metres."""
NOISE = 2.0
"""Differences below this are noise, in gray levels."""


def explained_part(patch: FacePatch, model: PalletModel, pose: LevelPose, hidden: Spans) -> float:
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
    right = _columns(model)
    colours, seen = _strip(patch, pose, right, np.linspace(*BELOW, ROWS))
    behind = [(right > low) & (right < high) for low, high in hidden]
    free = seen & ~np.any(behind, axis=0)
    if np.count_nonzero(free) < FEWEST:
        return 0.0
    away, spread = _unlike(colours, free)
    total = 0.0
    for (low, high), stretch in zip(hidden, behind, strict=True):
        there = stretch & seen
        if np.count_nonzero(there) >= FEWEST and np.median(away[there]) > UNLIKE * spread:
            total += (high - low) / model.width
    return total


def visible_occluders(patch: FacePatch, model: PalletModel, pose: LevelPose) -> Spans:
    """Return the stretches of a face before which something stands that is seen on the face and below it.

    Parameters
    ----------
    patch, model, pose
        As for `explained_part`.

    Returns
    -------
    tuple of (left, right)
        In metres on the face, from left to right. Narrower ones than those that hide edges count, too.
    """
    right = _columns(model)
    below, seen = _strip(patch, pose, right, np.linspace(*BELOW, ROWS))
    if np.count_nonzero(seen) < FEWEST:
        return ()
    away, spread = _unlike(below, seen)
    seen &= away > UNLIKE * spread
    if np.count_nonzero(seen) < FEWEST:
        return ()  # mostly nothing stands there
    face, on_face = _strip(patch, pose, right, np.linspace(FACE_MARGIN, model.height - FACE_MARGIN, FACE_ROWS))
    step = np.sqrt(np.square(below.mean(axis=1) - face.mean(axis=1)).sum(axis=1))
    covered = seen & on_face & (step < LIKE * away)
    ends = np.flatnonzero(np.diff(np.concatenate([[0], covered.astype(int), [0]]))).reshape(-1, 2)
    width = model.width / COLUMNS
    return tuple(
        (first * width - model.width / 2, last * width - model.width / 2)
        for first, last in ends.tolist()
        if last - first >= FEWEST
    )


def _columns(model: PalletModel) -> FloatArray:
    """Return the middles of the columns of points, in metres to the right."""
    return np.asarray((np.arange(COLUMNS) + 0.5) / COLUMNS * model.width - model.width / 2)


def _unlike(colours: FloatArray, where: BoolArray) -> tuple[FloatArray, float]:
    """Return how far the mean colours of columns are from what is usual in some of them, and the spread of that."""
    mean = np.einsum("crk->ck", colours) / colours.shape[1]
    away = np.sqrt(np.square(mean - np.median(mean[where], axis=0)).sum(axis=1))
    return away, math.hypot(float(np.median(away[where])), NOISE)


def _strip(patch: FacePatch, pose: LevelPose, right: FloatArray, up: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Return (columns, rows, channels) colours at places on the face's plane, and which columns are seen."""
    points = np.stack(np.meshgrid(right, up, indexing="ij"), axis=-1).reshape(-1, 2)
    colours, seen = patch.colours(pose, points)
    return colours.reshape(len(right), len(up), -1), np.asarray(seen.reshape(len(right), -1).all(axis=1))
