"""Upright edges of the blocks behind the face, where the camera sees them through its openings.

All is done on the plane of the face: the image of an upright edge behind it is an upright line there, too, so that
one set of cuts serves every depth.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from palletloc.face import EdgeKind, FaceEdge, FaceLine, contour_shift
from palletloc.geometry import BoolArray, FloatArray, LevelPose
from palletloc.pallet import Opening, PalletModel
from palletloc.refinement.profiles import Profiles, cut_profiles, cuts_across
from palletloc.shot import Shot

BOARD = 0.022
"""What boards may take of an opening's height inside, above and below, in metres."""
LEAST_HEIGHT = 0.025
"""Least height of an edge that is looked for, in metres."""
LEAST_GAP_PX = 2.0
"""Least distance of an edge from its neighbours in the image, in pixels: nearer ones draw each other's peaks."""
SMOOTHING_PX = 1.5
"""Standard deviation of the smoothing along an edge, in pixels of the image."""
_SLACK = 1e-4


@dataclass(frozen=True, slots=True)
class DepthEdge:
    """An upright edge of a block behind the face, where the camera sees it through an opening."""

    place: tuple[float, float, float]
    """Its middle in the face's coordinates: right, up, towards the viewer (negative), in metres."""
    outward: float
    """1 where the block lies to its left, -1 where it lies to its right."""
    level: int
    """Which of the model's depths behind the face it has, from 0: edges of one depth share its error."""
    contour: bool
    """Whether only one of the surfaces that meet at it is in view."""
    image: FaceEdge
    """Its image on the plane of the face."""
    scale: float
    """Size of the image against the edge, below 1."""


@dataclass(frozen=True, slots=True)
class DepthPeaks:
    """Where the image changes around edges behind the face."""

    edges: tuple[DepthEdge, ...]
    """Those that no other edge is too close to."""
    places: tuple[FloatArray, ...]
    """Of each edge: (n,) offsets of the peaks to the right of its image on the face's plane, in metres."""
    shares: tuple[FloatArray, ...]
    """Of each edge: (n,) their strengths, which add up to 1."""
    reach: FloatArray
    """(edges,) how far to each side peaks were looked for, in metres."""


def visible_depth_edges(model: PalletModel, plane_from_camera: FloatArray) -> tuple[DepthEdge, ...]:
    """Return the edges of blocks behind the face that the camera sees through the openings.

    Parameters
    ----------
    model : PalletModel
        The pallet; nothing is seen where it does not say where its blocks are.
    plane_from_camera : (3,) array
        The camera's centre in the face's coordinates: right, up, towards the viewer, in metres.

    Returns
    -------
    tuple of DepthEdge
        Without those that another block hides, or all but a bit of them the boards.
    """
    corners = _corners(model)
    if not len(corners) or not _looks_in(model, float(corners[:, 1].min()), plane_from_camera):
        return ()
    shown = corners[_in_sight(model, corners[:, :2], plane_from_camera)]
    edges = [_edge(model, corner, plane_from_camera) for corner in shown]
    return tuple(edge for edge in edges if edge is not None)


def _corners(model: PalletModel) -> FloatArray:
    """Return the blocks' corners behind the face: right, depth, outward, level."""
    depths = [depth for row in model.block_rows for depth in row][1:]
    corners = [
        (right, depth, outward, level)
        for level, depth in enumerate(depths)
        for sides in model.blocks
        for right, outward in zip(sides, (-1.0, 1.0), strict=True)
    ]
    return np.array(corners)


def _looks_in(model: PalletModel, depth: float, plane_from_camera: FloatArray) -> bool:
    """Tell whether the camera is at a height from which it sees anything so far behind an opening."""
    return any(_seen_height(opening, depth, plane_from_camera) is not None for opening in model.openings)


def _in_sight(model: PalletModel, corners: FloatArray, plane_from_camera: FloatArray) -> BoolArray:
    """Tell which corners no block stands before, seen from above: right and depth, (n, 2)."""
    sides, rows = np.array(model.blocks), np.array(model.block_rows)
    low = np.stack(np.meshgrid(sides[:, 0], rows[:, 0]), -1).reshape(-1, 2) + _SLACK
    high = np.stack(np.meshgrid(sides[:, 1], rows[:, 1]), -1).reshape(-1, 2) - _SLACK
    camera = np.array([plane_from_camera[0], -plane_from_camera[2]])
    way = (corners - camera)[:, None]
    way = np.where(np.abs(way) < _SLACK**2, _SLACK**2, way)
    first, last = (low - camera) / way, (high - camera) / way
    enter, leave = np.minimum(first, last).max(axis=2), np.maximum(first, last).min(axis=2)
    return np.asarray(~(np.maximum(enter, 0.0) < np.minimum(leave, 1.0)).any(axis=1))


def _edge(model: PalletModel, corner: FloatArray, plane_from_camera: FloatArray) -> DepthEdge | None:
    right, depth, outward, level = (float(value) for value in corner)
    aside, above, before = (float(value) for value in plane_from_camera)
    scale = before / (before + depth)
    across = aside + (right - aside) * scale
    opening = next((opening for opening in model.openings if opening.left < across < opening.right), None)
    if opening is None:
        return None
    seen = _seen_height(opening, depth, plane_from_camera)
    if seen is None:
        return None
    low, high = seen
    image = FaceEdge(EdgeKind.OPENING_SIDE, (across, low), (across, high), (outward, 0.0))
    up = above + (image.middle[1] - above) / scale
    back, side_hidden = level % 2 == 0, (aside - right) * outward < 0
    return DepthEdge((right, up, -depth), outward, int(level), back or side_hidden, image, scale)


def _seen_height(opening: Opening, depth: float, plane_from_camera: FloatArray) -> tuple[float, float] | None:
    """Return between which heights of the face's plane blocks so far behind an opening show; None for too little."""
    above, before = float(plane_from_camera[1]), float(plane_from_camera[2])
    scale = before / (before + depth)
    low, high = BOARD if opening.open_below else opening.bottom, opening.top - BOARD
    # what is seen lies within the opening at the face as well as at its own depth
    low, high = max(above + (low - above) * scale, low), min(above + (high - above) * scale, high)
    return (low, high) if high - low >= LEAST_HEIGHT * scale else None


def find_depth_peaks(
    shot: Shot,
    pose: LevelPose,
    model: PalletModel,
    edges: Sequence[DepthEdge],
    reach: FloatArray,
    pixel: tuple[float, float],
) -> DepthPeaks | None:
    """Look for edges behind the face in the shot.

    Parameters
    ----------
    shot : Shot
        The shot.
    pose : LevelPose
        ``forklift_from_pallet`` where the face was measured.
    model : PalletModel
        The pallet.
    edges : sequence of DepthEdge
        From `visible_depth_edges`.
    reach : (edges,) array
        How far from its place each is looked for on the face's plane, in metres.
    pixel : (float, float)
        Size of a pixel of the image along the face's right and up, in metres.

    Returns
    -------
    DepthPeaks or None
        None where there is nothing to see, or the camera does not see all of it.
    """
    apart = np.array([_gap(edge, edges, model) > LEAST_GAP_PX * pixel[0] for edge in edges], dtype=bool)
    chosen = tuple(edge for edge, alone in zip(edges, apart, strict=True) if alone)
    if not chosen:
        return None
    cuts = cuts_across([FaceLine(edge.image.kind, (edge.image,), edge.image) for edge in chosen], pixel[1], pixel[1])
    camera = shot.camera_in(pose)
    shift = np.array([_shift(edge, camera, model.edge_radius) for edge in chosen])
    sizes = np.tile([pixel], (len(chosen), 1))
    profiles = cut_profiles(shot, shot.camera_from_face(pose), cuts, shift, reach[apart], sizes)
    if not profiles.valid.all():
        return None
    places, shares = zip(*_peaks(profiles, [edge.outward for edge in chosen]), strict=True)
    return DepthPeaks(chosen, places, shares, reach[apart])


def _peaks(profiles: Profiles, outward: Sequence[float]) -> list[tuple[FloatArray, FloatArray]]:
    """Return the places and shares of the local maxima of each edge's mean gradient, above its median."""
    gradient, cuts = profiles.gradient(SMOOTHING_PX)[profiles.cuts.inner], profiles.cuts
    firsts = np.flatnonzero(np.diff(cuts.line[cuts.inner], prepend=-1))
    counts = np.diff(firsts, append=len(gradient))[:, None]
    mean = np.add.reduceat(gradient.astype(np.float64), firsts, axis=0) / counts
    above = mean - np.median(mean, axis=1, keepdims=True)
    peaked = (mean[:, 1:-1] > mean[:, :-2]) & (mean[:, 1:-1] >= mean[:, 2:]) & (above[:, 1:-1] > 0)
    found = []
    for line, sign in enumerate(outward):
        peak = 1 + np.flatnonzero(peaked[line])
        strength = above[line, peak]
        found.append((sign * profiles.offsets[peak] * profiles.reach[line], strength / max(strength.sum(), 1e-9)))
    return found


def _gap(edge: DepthEdge, edges: Sequence[DepthEdge], model: PalletModel) -> float:
    """Return the distance of an edge's image from the next upright edge's."""
    here = edge.image.middle[0]
    others = [other.image.middle[0] for other in edges if other is not edge]
    others += [side for opening in model.openings for side in (opening.left, opening.right)]
    return min(abs(here - other) for other in others)


def _shift(edge: DepthEdge, plane_from_camera: FloatArray, radius: float) -> float:
    """Return where a rounded edge appears on the face's plane, outward of its sharp image, in metres."""
    right, _, near = edge.place
    tangent = abs(float((plane_from_camera[0] - right) / (plane_from_camera[2] - near)))
    shift = -contour_shift(radius, tangent) if edge.contour else 0.75 * radius * tangent
    return edge.scale * shift
