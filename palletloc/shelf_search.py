"""A face looked for everywhere on a view of the shelf.

The first pass takes a face parallel to the shelf at every place, depth and height within reach. A face at another
depth appears scaled about the camera's foot point, so at each depth an edge of it is read off one row of the view.
These rows are stretched to the same steps along the shelf for all depths; then each piece of the face is a shifted
copy of one of them, and the score of all places is a sum of a few arrays. The best places are scored again with
turned faces and finer steps.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from palletloc.geometry import FloatArray, Image
from palletloc.pallet import PalletModel
from palletloc.shelf_view import DetectionConfig, ShelfView, depth_reach, depth_slack, yaw_reach
from palletloc.template import FacePlacement, TemplatePiece, WeightedSums, match_template

Scores = NDArray[np.float32]
"""(scales, heights, places) float32 array of scores."""
Indices = NDArray[np.intp]
"""Indices into an array."""

TOLERANCE_PX = 2.4
"""How far an edge moves from one hypothesis of the first pass to the next, in pixels of the view."""
FIRST_SHARE = 0.75
"""Part of the least score that a place must have in the first pass, which does not turn faces."""
SURPRISE = 0.05
"""What the score loses at the end of the reach in depth, and again in heading: where the view leaves them open, as
near the camera's height, the nominal plane is the better guess."""
PLATEAU = 0.035
"""How much less a place may score than the best one near it to be about as good."""
BATCH = 8
"""Heights that are scored together."""


class Sites(NamedTuple):
    """Where a face may stand, each field (n,), or (n, a) with a hypotheses for each of n places."""

    place: FloatArray
    """Middle of the face along the shelf, to the right, in metres."""
    depth: FloatArray
    """How far it stands behind the viewed plane, in metres."""
    yaw: FloatArray
    """Yaw against the viewed plane's, in radians."""
    height: FloatArray
    """Height of its lower edge, in metres."""
    score: FloatArray
    """Agreement of view and template, 0 to 1."""

    def chosen(self, which: Indices) -> Sites:
        """Return some of them."""
        return Sites(*(values[which] for values in self))


class Steps(NamedTuple):
    """What is tried in the first pass."""

    heights: FloatArray
    """(h,) heights of the face's lower edge, in metres."""
    scales: FloatArray
    """(k,) distances from the camera over the viewed plane's, evenly spaced."""
    places: FloatArray
    """(m,) middles of the face along the shelf, in metres, two pixels of the view apart."""
    turn: float
    """How far the face may be turned from the viewed plane, in radians."""
    free: bool
    """Whether the height is free: else a face at another distance is seen at another height."""


def first_steps(seen: ShelfView, model: PalletModel, config: DetectionConfig) -> Steps:
    """Return what to try, spaced so that no edge moves farther than the view tolerates.

    Parameters
    ----------
    seen : ShelfView
        The view.
    model : PalletModel
        The pallet.
    config : DetectionConfig
        Parameters.

    Returns
    -------
    Steps
        At least three scales and two places.
    """
    resolution = seen.view.grid.resolution
    tolerance = TOLERANCE_PX * resolution
    turn = yaw_reach(seen.drift, config)
    farthest = max(-seen.columns[0], seen.columns[1])
    reach = min(float(depth_reach(farthest, seen.anchor, turn, config)), 0.4 * seen.distance)
    extent, heights = model.width / 2, np.arange(*config.heights, tolerance)
    if seen.level is not None:
        below = seen.level - seen.camera_height
        extent, heights = max(extent, abs(below), abs(below + model.height)), np.array([seen.level])
    count = max(1, int(np.ceil(reach / seen.distance / (tolerance / extent))))
    return Steps(
        heights,
        1 + np.linspace(-reach, reach, 2 * count + 1) / seen.distance,
        np.arange(seen.columns[0], max(seen.columns[1], seen.columns[0] + 3 * resolution), 2 * resolution),
        turn,
        seen.level is None,
    )


def search(seen: ShelfView, template: Sequence[TemplatePiece], steps: Steps, config: DetectionConfig) -> Sites:
    """Score a face that is parallel to the shelf everywhere.

    Parameters
    ----------
    seen : ShelfView
        The view.
    template : sequence of TemplatePiece
        From `palletloc.template.face_template`, for the view.
    steps : Steps
        What to try.
    config : DetectionConfig
        Parameters.

    Returns
    -------
    Sites
        Local maxima along the shelf, in height and in each slab of depth.
    """
    depths = (steps.scales - 1) * seen.distance
    score = _scores(seen, template, steps)
    off = np.abs(depths[:, None]) / depth_reach(steps.places, seen.anchor, steps.turn, config)
    score -= np.where(off > 1, np.inf, SURPRISE * off**2).astype(np.float32)[:, None]
    deep, high, along = _peaks(score, depths, steps, config)
    best = score[deep, high, along].astype(np.float64)
    return Sites(steps.places[along], depths[deep], np.zeros(len(best)), steps.heights[high], best)


def _peaks(score: Scores, depths: FloatArray, steps: Steps, config: DetectionConfig) -> tuple[Indices, ...]:
    """Return the indices of the local maxima along the shelf and in height in each slab of depth."""
    slabs = np.floor(depths / config.min_depth_spacing)
    starts = np.flatnonzero(np.diff(slabs, prepend=np.nan))
    top = np.maximum.reduceat(score, starts, axis=0)
    width = 2 * int(config.min_spacing / 2 / (steps.places[1] - steps.places[0])) + 1
    around = np.stack([cv2.dilate(layer, np.ones((3, width), np.uint8)) for layer in top])
    slab, high, along = np.nonzero((top >= around) & (top >= FIRST_SHARE * config.min_score))
    inside = slabs[:, None] == slabs[starts][slab]
    return np.where(inside, score[:, high, along], -np.inf).argmax(axis=0), high, along


def _scores(seen: ShelfView, template: Sequence[TemplatePiece], steps: Steps) -> Scores:
    """Return (scales, heights, places) scores of faces parallel to the viewed plane."""
    shape = (len(steps.scales), len(steps.heights), len(steps.places))
    score = np.empty(shape, np.float32)
    for start in range(0, len(steps.heights), BATCH):
        part = slice(start, start + BATCH)
        score[:, part] = _scores_at(seen, template, steps, steps.heights[part])
    return score


def _scores_at(seen: ShelfView, template: Sequence[TemplatePiece], steps: Steps, heights: FloatArray) -> Scores:
    grid, camera, count = seen.view.grid, seen.camera_height, len(steps.places)
    margin = max(abs(round(piece.right / grid.resolution)) for piece in template) // 2 + 1
    # one pixel apart: even ones and odd ones, each two pixels apart like the places
    along = steps.places[0] + grid.resolution * np.arange(-2 * margin, 2 * (count + margin)).reshape(-1, 2).T
    inverse = 1 / steps.scales
    columns = np.rint((along[:, None, :] * inverse[:, None] - grid.left) / grid.resolution)
    columns = np.clip(columns, 0, grid.columns - 1).astype(np.intp)
    stretched: dict[tuple[int, float], Image] = {}
    sums = WeightedSums((len(inverse) * len(heights), count))
    for piece in template:
        key = id(piece.field), piece.up
        if key not in stretched:
            up = camera + (heights + piece.up - camera) * inverse[:, None]
            rows = np.clip(np.rint((grid.top - up) / grid.resolution), 0, grid.rows - 1).astype(np.intp)
            at = columns[:, :, None] + rows[..., None] * grid.columns
            stretched[key] = piece.field.ravel().take(at).reshape(2, -1, at.shape[-1])
        aside, odd = divmod(round(piece.right / grid.resolution), 2)
        sums.add(stretched[key][odd, :, margin + aside : margin + aside + count], piece.weight)
    return sums.total().reshape(len(inverse), len(heights), count)


def refine(
    seen: ShelfView,
    template: Sequence[TemplatePiece],
    steps: Steps,
    sites: Sites,
    part: float,
    config: DetectionConfig,
) -> Sites:
    """Return the middle of the places that score high near each of the given ones.

    Edges are widened, so the score is highest somewhere on a plateau: the middle of it is the better place. Distances
    change along the viewing ray, on which the face stays where it is seen.

    Parameters
    ----------
    seen, template, steps, config
        As for `search`.
    sites : Sites
        Where to look.
    part : float
        How far around: 1 for as far as the first pass leaves open.

    Returns
    -------
    Sites
        As many.
    """
    if not len(sites.place):
        return sites
    aside = seen.view.grid.resolution * np.array([-1.0, 0.0, 1.0])
    tried = _around(seen, steps, sites, part)
    score = match_template(
        template,
        seen.view.grid,
        np.array([0.0, seen.camera_height, seen.distance]),
        FacePlacement(*(v.reshape(-1, 1) for v in (1 + tried.depth / seen.distance, tried.yaw, tried.height))),
        aside,
        tried.place.reshape(-1, 1),
    ).reshape(*tried.place.shape, -1)
    share = score - _surprise(seen, tried, config)[..., None]
    share = np.exp((share - share.max(axis=(1, 2), keepdims=True)) / PLATEAU)
    share /= share.sum(axis=(1, 2), keepdims=True)
    each = share.sum(axis=2)
    place, depth, yaw, height = ((each * values).sum(axis=1) for values in tried[:4])
    return Sites(place + share.sum(axis=1) @ aside, depth, yaw, height, score.max(axis=(1, 2)))


def _around(seen: ShelfView, steps: Steps, sites: Sites, part: float) -> Sites:
    """Return (n, a) hypotheses around each site; a free height follows the viewing ray, too."""
    ends = part * np.linspace(-1.0, 1.0, 5)
    deep = float(steps.scales[1] - steps.scales[0]) * ends
    lift = part * TOLERANCE_PX / 2 * seen.view.grid.resolution * (np.arange(-1.0, 2.0) if steps.free else np.zeros(1))
    nearer, turn, above = (grid.ravel() for grid in np.meshgrid(deep, steps.turn * ends, lift, indexing="ij"))
    first = 1 + sites.depth[:, None] / seen.distance
    scale, height = first + nearer, sites.height[:, None] + above
    if steps.free:
        height = seen.camera_height + (height - seen.camera_height) * scale / first
    place, depth = sites.place[:, None] * scale / first, (scale - 1) * seen.distance
    return Sites(place, depth, sites.yaw[:, None] + turn, height, np.zeros_like(place))


def _surprise(seen: ShelfView, sites: Sites, config: DetectionConfig) -> FloatArray:
    """Return what the score of places loses for their depth and their heading, at most 1 for either.

    Drift turns the whole shelf about the camera, and depth and heading with it.
    """
    slack = depth_slack(seen.anchor, config) + np.abs(sites.place) * np.tan(np.radians(config.pallet_yaw_deg))
    deep = (sites.depth - sites.place * np.tan(sites.yaw)) / slack
    turned = sites.yaw / yaw_reach(seen.drift, config)
    return np.asarray(np.minimum(SURPRISE * deep**2, 1.0) + np.minimum(SURPRISE * turned**2, 1.0))


def spaced(sites: Sites, rank: FloatArray, most: int, height: float, config: DetectionConfig) -> Indices:
    """Return which sites to keep, best first: apart along the shelf, in depth or in height.

    Parameters
    ----------
    sites : Sites
        (n,) places of one model.
    rank : (n,) array
        How good they are.
    most : int
        How many to keep.
    height : float
        The model's height, in metres.
    config : DetectionConfig
        Gives the distances.

    Returns
    -------
    (k,) array
        Their indices.
    """
    order = np.argsort(-rank, kind="stable")
    kept: list[int] = []
    while len(order) and len(kept) < most:
        best = order[0]
        kept.append(int(best))
        near = np.abs(sites.place[order] - sites.place[best]) < config.min_spacing
        near &= np.abs(sites.depth[order] - sites.depth[best]) < config.min_depth_spacing
        near &= np.abs(sites.height[order] - sites.height[best]) < 0.6 * height
        order = order[~near]
    return np.array(kept, dtype=np.intp)
