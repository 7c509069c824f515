"""Which part of a face something stands before, by what is missing and by what is seen there.

An upright, a carton or a bin hides every line behind it at once, so independent lines vote for each stretch of the
face. A line that is nowhere seen has no vote: it may lie in the shadow. One that is alone widens what others say.

What stands before a face is seen below it, too: there it looks unlike the floor or the beam beside it. That tells
what hides edges from a place where there are none, and blocks and openings that are covered from bare ones.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from palletloc.edge_fit import EdgeFit, EdgePeaks
from palletloc.face import FaceEdge
from palletloc.geometry import BoolArray, FloatArray, LevelPose
from palletloc.pallet import PalletModel
from palletloc.refinement.patch import FacePatch
from palletloc.refinement.profiles import FaceCuts

Spans = Sequence[tuple[float, float]]
"""Stretches of a face: (left, right), in metres."""
BINS = 24
"""Stretches of the face's width that are voted on."""
SUPPORT = 0.4
"""Part of the cuts in a stretch, of all lines together, that show their edges where nothing is hidden, over what is
usual."""
USUAL, LEAST_USUAL = 0.75, 0.5
"""Quantile over the stretches of the part of cuts that show their edges, and the least that counts: what nothing
hides shows as many, fewer in noise."""
VOTERS = 2
"""Fewest lines that must vote on a stretch."""
ALIKE = 3.0
"""Factor within which the gradients along an edge are alike."""
LEAST_WIDTH = 2
"""Fewest neighbouring stretches that are hidden by something: a pallet has dents and labels, too."""
MOSTLY = 0.6
"""Part of an edge that is hidden where it counts as hidden."""
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


def hidden_spans(
    cuts: FaceCuts, peaks: EdgePeaks, fits: Sequence[EdgeFit | None], tolerance: FloatArray
) -> tuple[tuple[float, float], ...]:
    """Return the stretches of the face that something stands before.

    Parameters
    ----------
    cuts : FaceCuts
        Across the lines.
    peaks : EdgePeaks
        On the cuts.
    fits : sequence of EdgeFit or None
        Of each line.
    tolerance : (lines,) array
        How far from its line a peak belongs to it, in metres.

    Returns
    -------
    tuple of (left, right)
        In metres on the face, from left to right; empty where nothing is hidden.
    """
    voters = [(i, fit) for i, fit in enumerate(fits) if fit is not None and cuts.level[i]]
    if len(voters) < VOTERS:
        return ()
    half = max(line.whole.end[0] for line in cuts.lines)
    rows = [i for i, _ in voters]
    along, strength = peaks.along[rows], peaks.strength[rows]
    offset, slope, usual = np.array([(fit.offset, fit.slope, fit.strength) for _, fit in voters]).T[..., None]
    on_line = np.abs(peaks.offset[rows] - offset - slope * along) < tolerance[rows, None]
    on_line &= (strength > usual / ALIKE) & (strength < usual * ALIKE)
    middle = np.array([cuts.lines[i].whole.middle[0] for i in rows])[:, None]
    place = ((along + middle + half) * (BINS / (2 * half))).astype(np.intp).clip(0, BINS - 1)
    place += BINS * np.arange(len(rows))[:, None]
    cut = strength >= 0
    here, there = (np.bincount(place[which], minlength=BINS * len(rows)) for which in (cut, cut & on_line))
    count, shown = (votes.reshape(-1, BINS).sum(axis=0) for votes in (here, there))
    lines = np.count_nonzero(here.reshape(-1, BINS), axis=0)
    # neighbours share their votes: something that hides a stretch is not narrower
    spread = np.ones(3)
    around, seen = np.convolve(count, spread, "same"), np.convolve(shown, spread, "same")
    usual = max(float(np.quantile(seen / np.maximum(around, 1), USUAL)), LEAST_USUAL)
    missing = seen < SUPPORT * usual * around
    if not missing.any():
        return ()
    hidden = _grown(missing & (lines >= VOTERS), missing & (lines > 0))
    return tuple((-half + first * 2 * half / BINS, -half + last * 2 * half / BINS) for first, last in _runs(hidden))


def _grown(hidden: BoolArray, alone: BoolArray) -> BoolArray:
    """Return what is hidden with the stretches beside it where a single line votes, as at the outer blocks."""
    grown = hidden
    while True:
        beside = np.convolve(grown, np.ones(3), "same") > 0
        before, grown = grown, grown | (alone & beside)
        if (grown == before).all():
            return grown


def _runs(hidden: BoolArray) -> list[tuple[int, int]]:
    """Return first and one past the last of each long enough run."""
    steps = np.flatnonzero(np.diff(np.concatenate([[False], hidden, [False]]).astype(int)))
    return [(int(first), int(last)) for first, last in steps.reshape(-1, 2) if last - first >= LEAST_WIDTH]


def joined(*many: Spans) -> tuple[tuple[float, float], ...]:
    """Return stretches of a face as one list from left to right, without overlaps.

    Parameters
    ----------
    *many : sequence of (left, right)
        In metres.
    """
    found: list[tuple[float, float]] = []
    for low, high in sorted(span for spans in many for span in spans):
        if found and low <= found[-1][1]:
            found[-1] = found[-1][0], max(high, found[-1][1])
        else:
            found.append((low, high))
    return tuple(found)


def hidden_part(left: float, right: float, spans: Spans) -> float:
    """Return which part of a stretch of the face is hidden, 0 to 1.

    Parameters
    ----------
    left, right : float
        Ends of the stretch, in metres; an upright edge has none of it and is hidden or not.
    spans : sequence of (left, right)
        From `hidden_spans`.
    """
    if not spans:
        return 0.0
    if right - left <= 0:
        return float(any(low <= left <= high for low, high in spans))
    covered = sum(max(0.0, min(right, high) - max(left, low)) for low, high in spans)
    return min(1.0, covered / (right - left))


def is_hidden(edge: FaceEdge, spans: Spans) -> bool:
    """Tell whether most of an edge is hidden."""
    return hidden_part(edge.start[0], edge.end[0], spans) > MOSTLY


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
