"""What the blocks behind the face say of its yaw.

Their edges move against those of the face when the pallet turns, at any height of the camera; level with it, where
the slopes of level lines say nothing, that holds the yaw. Inside a pallet it is dark, and other things stand behind
it: which peak of the image belongs to which edge is left open. What the face alone leaves uncertain is nearly one
motion, the ridge of yaw and range; along it all edges vote at once, each for every peak near its place.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from palletloc.geometry import FloatArray, LevelPose
from palletloc.pallet import PalletModel
from palletloc.refinement.depth_edges import DepthPeaks, find_depth_peaks, visible_depth_edges
from palletloc.refinement.edges import SeenFace
from palletloc.refinement.normal_equations import FaceEquations, FaceSolution
from palletloc.shot import Shot

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
class Vote:
    """Where along the ridge the edges behind the face put it, in its standard deviations."""

    place: float
    """What they measure, freed from what was known before."""
    sigma: float
    """Its standard deviation; infinite where they say nothing."""
    evidence: float
    """How much likelier the peaks are with a pallet on the ridge than without, as a logarithm."""


def add_depth_edges(
    shot: Shot, pose: LevelPose, model: PalletModel, system: FaceEquations, alone: FaceSolution, doubt: float
) -> float:
    """Add to the least squares of a face what the edges behind it say, where they agree.

    Parameters
    ----------
    shot : Shot
        The shot.
    pose : LevelPose
        ``forklift_from_pallet`` where the face was measured.
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
    spread = np.sqrt(system.spread_behind(edges, alone).diagonal())
    reach = np.clip(SEARCHED * spread + MARGIN, LEAST_REACH, MOST_REACH)
    peaks = find_depth_peaks(shot, pose, model, edges, reach, pixel)
    if peaks is None:
        return 0.0
    ridge, sigma = _ridge(peaks, system.spread_behind(peaks.edges, alone), pixel[0])
    start = system.expected_behind(peaks.edges, alone)
    vote = count_votes(peaks, start, ridge, sigma, 1 + WIDER * max(doubt - SURE_DOUBT, 0.0))
    if vote.evidence <= 0 or vote.sigma > MOST_SIGMA:
        return 0.0
    shares = ridge / (ridge @ ridge)
    system.add_behind(peaks.edges, shares, vote.place + float(shares @ start), vote.sigma)
    return vote.evidence


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
