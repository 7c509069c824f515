"""Is it a pallet? Checks of the final pose that edges alone cannot make.

A beam with cartons, or a pallet shifted by one opening, has edges where the template wants them. What tells them
from a pallet is what lies between the edges: blocks that are alike, and openings that are not like the blocks.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from palletloc.contrast import face_contrast
from palletloc.face_fit import FaceEstimate
from palletloc.geometry import LevelPose
from palletloc.matching import edge_energy
from palletloc.measurement import Reason
from palletloc.pallet import PalletModel
from palletloc.template import FacePlacement, face_template, match_template


@dataclass(frozen=True, slots=True)
class VerificationConfig:
    """What a pallet must show."""

    min_coverage: float = 0.45
    """Least part of the face's edges, by length."""
    min_promise: float = 0.45
    """Least product of a detection's score and its contrast for it to be measured."""
    max_doubt: float = 6.0
    """Most edges that may be missing or contradict the others."""
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
    contrast = face_contrast(estimate.seen.view, model)
    found = Verification(contrast, estimate.coverage, _score(estimate, model), None)
    if found.coverage < config.min_coverage:
        return replace(found, reason=Reason.FEW_EDGES)
    if found.contrast < config.min_contrast or found.rank < config.min_rank:
        return replace(found, reason=Reason.LOW_CONTRAST)
    return found


def _score(estimate: FaceEstimate, model: PalletModel) -> float:
    """Match the face's template at the final pose, on every second pixel: edges are wider than one."""
    full, camera = estimate.seen.view.grid, estimate.seen.plane_from_camera
    image = np.ascontiguousarray(estimate.seen.view.image[::2, ::2])
    grid = replace(full, resolution=2 * full.resolution, columns=image.shape[1], rows=image.shape[0])
    window = (round(0.4 / grid.resolution) | 1, round(0.2 / grid.resolution) | 1)
    template = face_template(model, edge_energy(image, window), grid.resolution, camera)
    here = FacePlacement(np.ones((1, 1)), np.zeros((1, 1)), np.zeros((1, 1)))
    return float(np.clip(match_template(template, grid, camera, here, np.zeros(1))[0, 0], 0.0, 1.0))


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
