"""Looking for a face around a start: which plane to view, and which hypotheses to score on it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from palletloc.cameras.protocol import Projection
from palletloc.geometry import FloatArray, LevelPose, wrap_angle
from palletloc.measurement import HeightPrior, Reason
from palletloc.pallet import PalletModel
from palletloc.refinement.hypotheses import HypothesisGrid, HypothesisScores, SearchConfig, score_hypotheses
from palletloc.refinement.patch import FacePatch, view_patch
from palletloc.shot import MIN_DISTANCE, Shot

TOLERANCE = 2.4
"""How far an edge may lie from its place to be found, in pixels of the patch."""
FINEST, COARSEST = 0.004, 0.012
"""Least and greatest metres per pixel of the patch."""
MARGIN = 0.04
"""What the patch shows beyond the outermost hypothesis, in metres."""
PROBE = 1e-3
"""Length on the face by whose image the size of a pixel is found, in metres."""
LARGEST = 120_000
"""Most pixels of a patch; a larger one is viewed more coarsely."""


@dataclass(frozen=True, slots=True)
class Search:
    """What was looked at and found."""

    patch: FacePatch
    """The view."""
    found: HypothesisScores
    """The hypotheses with their scores."""
    finer: tuple[Search, ...] = ()
    """Searches around the peaks, where all around the start could only be viewed coarsely."""

    @property
    def starts(self) -> list[tuple[LevelPose, FacePatch]]:
        """Where to measure, the best first, each with the view that shows it best."""
        if not self.finer:
            return [(peak.pose, self.patch) for peak in self.found.peaks]
        peaks = [(peak, search.patch) for search in self.finer for peak in search.found.peaks]
        return [(peak.pose, patch) for peak, patch in sorted(peaks, key=lambda pair: -pair[0].score)]


def search(
    shot: Shot,
    start: LevelPose,
    model: PalletModel,
    height: HeightPrior | None,
    config: SearchConfig,
    yaws: tuple[float, float] | None = None,
) -> Search | Reason:
    """Score pose hypotheses around a start.

    Parameters
    ----------
    shot : Shot
        The shot.
    start : LevelPose
        ``forklift_from_pallet``.
    model : PalletModel
        The pallet.
    height : HeightPrior or None
        What is known of the height: then the face slides on its level, else along the viewing ray.
    config : SearchConfig
        Where to look.
    yaws : (low, high) or None
        Between which yaws the pallet may stand, in radians.

    Returns
    -------
    Search or Reason
        `Reason.NO_PEAK` where nothing matches, `Reason.BEHIND_FACE` or `Reason.OUT_OF_VIEW` where nothing can.
    """
    base = start if height is None else replace(start, z=height.z)
    plane = shot.camera_in(base)
    if plane[2] < MIN_DISTANCE:
        return Reason.BEHIND_FACE
    middle = np.array([base.x, base.y, base.z + model.height / 2])
    seen = shot.project(middle + np.array([[0.0, 0.0, 0.0], [0.0, 0.0, PROBE]]))
    if not seen.valid.all():
        return Reason.OUT_OF_VIEW
    finest = _resolution(seen)
    resolution, turns = finest, _turns(base.yaw, yaws, config)
    while True:
        grid = _grid(plane, model, height is None, resolution, config, turns)
        extent = _extent(plane, model, grid)
        area = (extent[1] - extent[0]) * (extent[3] - extent[2]) / resolution**2
        if area <= LARGEST:
            break
        resolution *= float(np.sqrt(area / LARGEST)) * 1.01
    patch = view_patch(shot, base, extent, resolution)
    if isinstance(patch, Reason):
        return patch
    found = score_hypotheses(patch, model, grid, config)
    if not found.peaks:
        return Reason.NO_PEAK
    if resolution == finest:
        return Search(patch, found)
    closer = _closer(grid, plane, config)
    around = [search(shot, peak.pose, model, height, closer, yaws) for peak in found.peaks]
    return Search(patch, found, tuple(each for each in around if not isinstance(each, Reason)))


def _closer(grid: HypothesisGrid, plane: FloatArray, config: SearchConfig) -> SearchConfig:
    """Return a search as far as two steps of a grid."""
    away = float(np.hypot(plane[0], plane[2]))
    turn, distance, place, rise = (
        2 * float(axis[1] - axis[0]) if len(axis) > 1 else 0.0
        for axis in (grid.turns, grid.ranges, grid.places, grid.rises)
    )
    return replace(
        config,
        turn_deg=min(config.turn_deg, float(np.degrees(turn))),
        nearer=min(config.nearer, distance * away),
        farther=min(config.farther, distance * away),
        sideways=min(config.sideways, place),
        upward=min(config.upward, rise),
    )


def _resolution(seen: Projection) -> float:
    """Return the size of a pixel of the image across the face's level lines, within bounds."""
    moved = float(np.hypot(*(seen.pixels[1] - seen.pixels[0])))
    return float(np.clip(PROBE / max(moved, 1e-9), FINEST, COARSEST))


def _grid(
    plane: FloatArray,
    model: PalletModel,
    sliding: bool,
    resolution: float,
    config: SearchConfig,
    reach: tuple[float, float],
) -> HypothesisGrid:
    """Space the hypotheses so that no edge moves farther than the patch tolerates from one to the next."""
    x, y, z = plane
    tolerance = TOLERANCE * resolution
    half = model.width / 2
    extent = max(half, abs(y), abs(y - model.height))
    away = float(np.hypot(x, z))
    nearer = min(config.nearer, away - MIN_DISTANCE * away / z, 0.5 * away)
    ranges = _spread(-nearer / away, config.farther / away, tolerance / extent) + 1
    turns = _spread(*reach, min(tolerance * z / (half * extent), np.radians(4.0)))
    places = _spread(-config.sideways, config.sideways, tolerance)
    rises = _spread(-config.upward, config.upward, tolerance) if sliding else np.zeros(1)
    return HypothesisGrid(turns, ranges, places, rises, sliding)


def _turns(yaw: float, yaws: tuple[float, float] | None, config: SearchConfig) -> tuple[float, float]:
    """Return how far a start may be turned to either side, in radians: as far as is searched and may be."""
    turn = float(np.radians(config.turn_deg))
    if yaws is None:
        return -turn, turn
    low, high = (wrap_angle(end - yaw) for end in yaws)
    return (max(-turn, low), min(turn, high)) if low <= 0.0 <= high else (-turn, turn)


def _spread(low: float, high: float, step: float) -> FloatArray:
    return np.linspace(low, high, max(2, int(np.ceil((high - low) / step)) + 1))


def _extent(plane: FloatArray, model: PalletModel, grid: HypothesisGrid) -> tuple[float, float, float, float]:
    """Return the part of the plane on which every hypothesis appears."""
    x, y, z = plane
    factor, turn = grid.ranges[[0, -1]].reshape(2, 1, 1, 1), grid.turns[[0, -1]].reshape(2, 1, 1)
    u, v = np.array([[-0.5], [0.5]]) * model.width, np.array([0.0, model.height])
    nearer = z / np.maximum(z * factor + u * np.sin(turn), MIN_DISTANCE)
    columns = x + (u * np.cos(turn) - x * factor) * nearer
    rows = y + (v - (y * factor if grid.sliding else y)) * nearer
    aside, above = MARGIN + grid.places[-1] * nearer.max(), MARGIN + grid.rises[-1] * nearer.max()
    return columns.min() - aside, columns.max() + aside, rows.min() - above, rows.max() + above
