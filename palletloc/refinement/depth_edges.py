"""Upright edges of the blocks behind the face, where the camera sees them through its openings: they hold the yaw.

They move against the edges of the face when the pallet turns, at any height of the camera; level with it, the slopes
of level lines say nothing. Inside a pallet it is dark, and other things stand behind it: which peak of the image
belongs to which edge is left open. What the face alone leaves uncertain is nearly one motion, the ridge of yaw and
range; along it all edges vote at once, each for every peak near its place.

All is done on the plane of the face: the image of an upright edge behind it is an upright line there, too, so that
one set of cuts serves every depth.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from palletloc.face import EdgeKind, FaceEdge, FaceLine, contour_shift
from palletloc.geometry import BoolArray, FloatArray
from palletloc.pallet import Opening, PalletModel
from palletloc.refinement.edges import SeenFace
from palletloc.refinement.normal_equations import FaceEquations, FaceSolution
from palletloc.refinement.profiles import Profiles, Samples, cut_profiles, cuts_across
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
"""How far inside a block its sides are taken to be, in metres: its own corners are not hidden by it."""
SIDE_ERROR = 0.004
"""How far a block inside stands from its place along the face (one standard deviation), in metres."""
PEAK_PX = 0.3
"""How far a peak lies from the edge that makes it, in pixels of the image."""
CONTOUR_SEEN, CREASE_SEEN = 0.6, 0.35
"""How often an edge is seen, as the contour of a block and between two of its surfaces."""
WIDER = 0.5
"""How much wider than its covariance says the ridge is searched, for each missing or contradicting edge."""
SURE_DOUBT, MOST_DOUBT = 0.5, 4.0
"""Missing or contradicting edges that widen nothing, and with which nothing behind the face helps."""
SEARCHED, MARGIN, LEAST_REACH, MOST_REACH = 4.0, 0.008, 0.012, 0.08
"""How far an edge is looked for: in standard deviations of its place, and beyond, at least and at most in metres."""
STEPS, LIMIT = 401, 5.0
"""In how many steps the ridge is searched, and how far in standard deviations."""
MOST_SIGMA = 4.5
"""Largest standard deviation along the ridge of a vote that is worth adding, in parts of that of the face alone."""


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


def _find_peaks(
    shot: Shot,
    seen: SeenFace,
    model: PalletModel,
    edges: Sequence[DepthEdge],
    reach: FloatArray,
    pixel: tuple[float, float],
) -> DepthPeaks | None:
    """Look for edges behind a face in the shot.

    ``reach`` is how far from its place each is looked for on the face's plane, ``pixel`` the size of a pixel of the
    image along the face's right and up, in metres. None where the camera does not see all of it.
    """
    if not edges:
        return None
    cuts = cuts_across([FaceLine(edge.image.kind, (edge.image,), edge.image) for edge in edges], pixel[1], pixel[1])
    shift = np.array([_shift(edge, seen.plane_from_camera, model.edge_radius) for edge in edges])
    sizes = np.tile([pixel], (len(edges), 1))
    profiles = cut_profiles(shot, seen.camera_from_face, cuts, shift, reach, sizes)
    if not profiles.valid.all():
        return None
    gradient = profiles.gradient(SMOOTHING_PX)[cuts.inner]
    places, shares = zip(*_peaks(profiles, gradient, [edge.outward for edge in edges]), strict=True)
    return DepthPeaks(tuple(edges), places, shares, reach)


def _peaks(profiles: Profiles, gradient: Samples, outward: Sequence[float]) -> list[tuple[FloatArray, FloatArray]]:
    """Return the places and shares of the local maxima of each edge's mean gradient, above its median."""
    cuts = profiles.cuts
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


@dataclass(frozen=True, slots=True)
class Vote:
    """Where along the ridge the edges behind the face put it, in its standard deviations."""

    place: float
    """What they measure, freed from what was known before."""
    sigma: float
    """Its standard deviation; infinite where they say nothing."""
    evidence: float
    """How much likelier the peaks are with a pallet on the ridge than without, as a logarithm."""


def add_depth_edges(
    shot: Shot, model: PalletModel, system: FaceEquations, alone: FaceSolution, doubt: float
) -> float:
    """Add to the least squares of a face what the edges behind it say, where they agree.

    Parameters
    ----------
    shot : Shot
        The shot.
    model : PalletModel
        The pallet.
    system : FaceEquations
        Of the face; gets one more measurement.
    alone : FaceSolution
        Its solution by the face alone.
    doubt : float
        How many edges of the face are missing or contradict the others.

    Returns
    -------
    float
        How much likelier the image is with the blocks where the pose has them, as a logarithm; 0 where they are not
        seen or do not agree, and nothing was added.
    """
    edges, pixel = visible_depth_edges(model, system.seen.plane_from_camera), _pixel(system.seen)
    if not edges or doubt > MOST_DOUBT or pixel is None:
        return 0.0
    motion = system.motion_behind(np.array([edge.place for edge in edges]), [edge.level for edge in edges])
    reach = np.clip(SEARCHED * np.sqrt(_spread(motion, alone).diagonal()) + MARGIN, LEAST_REACH, MOST_REACH)
    apart = np.array([_gap(edge, edges, model) > LEAST_GAP_PX * pixel[0] for edge in edges], dtype=bool)
    chosen = [edges[i] for i in np.flatnonzero(apart)]
    peaks = _find_peaks(shot, system.seen, model, chosen, reach[apart], pixel)
    if peaks is None:
        return 0.0
    motion = motion[apart]
    ridge, sigma = _ridge(peaks, _spread(motion, alone), pixel[0])
    start = motion @ alone.unknowns
    vote = count_votes(peaks, start, ridge, sigma, 1 + WIDER * max(doubt - SURE_DOUBT, 0.0))
    if vote.evidence <= 0 or vote.sigma > MOST_SIGMA:
        return 0.0
    shares = ridge / (ridge @ ridge)
    system.add_offset(shares @ motion, vote.place + float(shares @ start), vote.sigma)
    return vote.evidence


def _spread(motion: FloatArray, solution: FaceSolution) -> FloatArray:
    """Return the covariance of where a solution expects the images of edges on the face's plane, in square metres."""
    return np.asarray(motion @ np.linalg.solve(solution.information, motion.T))


def _pixel(seen: SeenFace) -> tuple[float, float] | None:
    """Return the size of a pixel of the image along the face's right and up; None where no upright edge is seen."""
    across = [edge.pixel for edge in seen.edges if not edge.edge.horizontal]
    along = [edge.pixel for edge in seen.edges if edge.edge.horizontal] or across
    return (float(np.median(across)), float(np.median(along))) if across else None


def _ridge(peaks: DepthPeaks, spread: FloatArray, pixel: float) -> tuple[FloatArray, FloatArray]:
    """Return how the ridge moves the images of the edges, and how far else their peaks may lie from their places."""
    variances, directions = np.linalg.eigh(spread)
    ridge = directions[:, -1] * np.sqrt(variances[-1])
    placed = np.array([SIDE_ERROR * edge.scale for edge in peaks.edges])
    other = np.maximum(spread.diagonal() - ridge**2, 0.0) + placed**2 + (PEAK_PX * pixel) ** 2
    return ridge, np.sqrt(other)


def count_votes(peaks: DepthPeaks, start: FloatArray, ridge: FloatArray, sigma: FloatArray, width: float) -> Vote:
    """Return where along the ridge the peaks of all edges together put the face.

    Each edge is seen with some probability, and is then one of its peaks, the likelier the stronger it is; otherwise
    its peaks lie anywhere within the reach.

    Parameters
    ----------
    peaks : DepthPeaks
        The peaks around each edge.
    start : (edges,) array
        How far to the right of its place each edge is expected on the face's plane, in metres.
    ridge : (edges,) array
        How far a standard deviation along the ridge moves each edge's image to the right, in metres.
    sigma : (edges,) array
        How far from there a peak may lie, in metres.
    width : float
        Standard deviation of the place on the ridge before anything is seen behind the face; 1 if it is as certain
        as its covariance says.

    Returns
    -------
    Vote
        The Gaussian measurement that leaves, together with what was known, the mean and variance of all places.
    """
    steps = np.linspace(-LIMIT, LIMIT, STEPS) * width
    prior = -0.5 * (steps / width) ** 2
    logarithm = prior.copy()
    for k, edge in enumerate(peaks.edges):
        if not len(peaks.places[k]):
            continue
        apart = (start[k] + ridge[k] * steps[:, None] - peaks.places[k]) / sigma[k]
        density = np.exp(-0.5 * apart**2) @ peaks.shares[k] / (np.sqrt(2 * np.pi) * sigma[k])
        seen = CONTOUR_SEEN if edge.contour else CREASE_SEEN
        logarithm += np.log(1 - seen + seen * density * 2 * peaks.reach[k])
    weight = np.exp(logarithm)
    evidence = float(np.log(weight.sum() / np.exp(prior).sum()))
    weight /= weight.sum()
    mean = float(weight @ steps)
    variance = max(float(weight @ (steps - mean) ** 2), 1e-6)
    gained = 1 / variance - 1 / width**2
    if gained <= 0:
        return Vote(0.0, np.inf, evidence)
    return Vote(mean / variance / gained, float(gained**-0.5), evidence)
