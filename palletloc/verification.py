"""Is it a pallet? Checks of the final pose that edges alone cannot make.

A beam with cartons, or a pallet shifted by one opening, has edges where the template wants them. What tells them
from a pallet is what lies between the edges: blocks that are alike, and openings that are not like the blocks.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from palletloc.face_fit import FaceEstimate
from palletloc.geometry import FloatArray, LevelPose
from palletloc.matching import edge_energy
from palletloc.measurement import Reason
from palletloc.pallet import PalletModel
from palletloc.plane import PlaneView
from palletloc.template import FacePlacement, face_template, match_template

SMOOTHING = 0.006
"""Standard deviation of the smoothing before colours are compared, in metres."""
NOISE = 2.0
"""Differences below this are noise, in gray levels."""


@dataclass(frozen=True, slots=True)
class VerificationConfig:
    """What a pallet must show."""

    min_coverage: float = 0.45
    """Least part of the face's edges, by length."""
    min_contrast: float = 2.0
    """Least difference of openings and blocks, in spreads of the blocks."""
    min_rank: float = 0.40
    """Least standing of contrast, coverage and agreement with the template together."""
    certain: float = 0.6
    """Rank from which on no other candidate is tried in a pallet's place."""


@dataclass(frozen=True, slots=True)
class Verification:
    """What the face shows at the final pose."""

    contrast: float
    """Difference of the less clear opening from the blocks, in spreads of the blocks."""
    coverage: float
    """Part of the face's edges that is seen, 0 to 1."""
    score: float
    """Agreement of face and template, 0 to 1."""
    reason: Reason | None
    """Why it is not a pallet; None where it is one."""

    @property
    def rank(self) -> float:
        """One number to choose between candidates in one place, 0 to 1."""
        return float(np.clip(0.5 * (self.score + self.coverage) * min(1.0, self.contrast / 4.0), 0.0, 1.0))


def verify(estimate: FaceEstimate, model: PalletModel, config: VerificationConfig) -> Verification:
    """Check the face at its final pose.

    Parameters
    ----------
    estimate : FaceEstimate
        With the view of the face.
    model : PalletModel
        The pallet.
    config : VerificationConfig
        Thresholds.

    Returns
    -------
    Verification
        With a reason where it fails.
    """
    contrast = opening_contrast(estimate.seen.view, model)
    found = Verification(contrast, estimate.coverage, _score(estimate, model), None)
    if found.coverage < config.min_coverage:
        return replace(found, reason=Reason.FEW_EDGES)
    if found.contrast < config.min_contrast or found.rank < config.min_rank:
        return replace(found, reason=Reason.LOW_CONTRAST)
    return found


def opening_contrast(view: PlaneView, model: PalletModel) -> float:
    """Return how clearly the openings differ from the blocks.

    Parameters
    ----------
    view : PlaneView
        The front face at its pose.
    model : PalletModel
        The pallet.

    Returns
    -------
    float
        For the less clear opening: median distance of its pixels from the blocks' mean colour, over the spread
        of the blocks (within and between them). About 1 where there is no opening; what is seen through one may
        be dark and bright at once, so its mean colour says little.
    """
    low = max(min(opening.bottom for opening in model.openings), 0.01)
    high = min(opening.bottom + opening.height for opening in model.openings)
    ends = [-model.width / 2]
    for opening in model.openings:
        ends += [opening.center - opening.width / 2, opening.center + opening.width / 2]
    ends.append(model.width / 2)
    blocks = [_colours(view, left, right, low, high) for left, right in zip(ends[::2], ends[1::2], strict=True)]
    openings = [
        _colours(view, left, right, low, high)
        for left, right in zip(ends[1:-1:2], ends[2:-1:2], strict=True)
    ]
    means = np.array([block.mean(axis=0) for block in blocks])
    within = np.mean([block.var(axis=0).sum() for block in blocks])
    between = float(((means - means.mean(axis=0)) ** 2).sum(axis=1).mean())
    spread = np.sqrt(within + between + NOISE**2)
    distances = [
        float(np.median(np.linalg.norm(colours - means.mean(axis=0), axis=1))) / spread for colours in openings
    ]
    return float(min(distances))


def _colours(view: PlaneView, left: float, right: float, low: float, high: float) -> FloatArray:
    """Return the smoothed colours inside a rectangle of the face, without its margins, (n, channels)."""
    margin_right, margin_up = 0.15 * (right - left), 0.15 * (high - low)
    corners = view.grid.pixels(np.array([[left + margin_right, high - margin_up], [right - margin_right, low + margin_up]]))
    (c0, r0), (c1, r1) = np.rint(corners).astype(int)
    patch = cv2.GaussianBlur(view.image[r0 : r1 + 1, c0 : c1 + 1], (0, 0), SMOOTHING / view.grid.resolution)
    return patch.astype(np.float64).reshape(-1, 1 if view.image.ndim == 2 else 3)


def _score(estimate: FaceEstimate, model: PalletModel) -> float:
    view = estimate.seen.view
    camera = estimate.seen.plane_from_camera
    window = (round(0.4 / view.grid.resolution) | 1, round(0.2 / view.grid.resolution) | 1)
    template = face_template(model, edge_energy(view.image, window, dilation=2), view.grid.resolution, camera)
    here = FacePlacement(np.ones((1, 1)), np.zeros((1, 1)), np.zeros((1, 1)))
    return float(np.clip(match_template(template, view.grid, camera, here, np.zeros(1))[0, 0], 0.0, 1.0))


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
    dx, dy = other.x - pose.x, other.y - pose.y
    along = abs(-np.sin(pose.yaw) * dx + np.cos(pose.yaw) * dy)
    across = abs(np.cos(pose.yaw) * dx + np.sin(pose.yaw) * dy)
    widths = (model.width, other_model.width)
    return bool(
        along < sum(widths) / 2 - 0.1 * min(widths)
        and abs(other.z - pose.z) < max(model.height, other_model.height)
        and across < min(model.depth, other_model.depth)
    )
