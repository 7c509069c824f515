"""Does a face agree with the level that it is said to stand on? Its size tells the range, and so the height.

A pose on a wrong level slides along its viewing ray until the level lines fit; the uprights then stand too far apart
or too close. The same face fitted at any height is the rival of the pose on the level. Where no level is known, the
size is all there is: missing uprights then leave the range open.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from palletloc.candidate import Candidate, ShotView
from palletloc.config import LocalizerConfig
from palletloc.face_view import visible_lines
from palletloc.geometry import FloatArray, wrap_angle
from palletloc.measurement import HeightPrior, Reason
from palletloc.refinement.alignment import fit_face
from palletloc.verification import NATS_PER_EDGE, WEAK_DOUBT

WRONG_LEVEL = 0.01
"""How often a level that is given is wrong, before anything is seen."""

CLEARLY_OFF = 3.0
"""From how many standard deviations on a face contradicts its level: fewer are no matter of height."""

MISSED = 1.0
"""How many uprights a right pose misses at most, as a rule."""


@dataclass(frozen=True, slots=True)
class LevelCheck:
    """A pose on its level compared with the same face at any height."""

    apart: FloatArray
    """(4,) how far the pose at any height is from the one on the level: (x, y, z, yaw), in metres and radians."""
    off: float
    """How far the face's own height is from the level, in standard deviations."""
    wrong: float
    """Probability that the level is wrong."""

    @property
    def contradicts(self) -> bool:
        """Whether the level is rather wrong than right, and the height is what tells."""
        return self.wrong > 0.5 and self.off > CLEARLY_OFF


def check_level(shot: ShotView, candidate: Candidate, config: LocalizerConfig) -> LevelCheck | None:
    """Compare a pose on a known level with the same face at any height.

    Parameters
    ----------
    shot : ShotView
        The shot.
    candidate : Candidate
        With the fit of its face.
    config : LocalizerConfig
        Parameters.

    Returns
    -------
    LevelCheck or None
        None where no level is known, or the face cannot be fitted at any height.
    """
    known, pose, face = candidate.height, candidate.pose, candidate.face
    if known is None or pose is None or face is None:
        return None
    spread, camera = float(np.radians(config.prior.yaw_sigma_deg)), shot.projector.camera
    anywhere = HeightPrior(pose.z, config.prior.free_sigma)
    free = fit_face(
        camera,
        shot.image,
        shot.mounting,
        pose,
        candidate.model,
        anywhere,
        candidate.yaw_prior,
        spread,
        config.face_fit,
        arrived=True,
    )
    if isinstance(free, Reason):
        return None
    apart = free.forklift_from_pallet.as_array() - pose.as_array()
    apart[3] = wrap_angle(apart[3])
    variance = float(free.covariance[2, 2]) * (1 + max(free.doubt - WEAK_DOUBT, 0.0) ** 2)
    off = abs(free.forklift_from_pallet.z - known.z) / float(np.sqrt(variance + known.sigma**2))
    # one more unknown fits always better: what it gains must outweigh how much it could have been anything
    chance = np.log(WRONG_LEVEL / (1 - WRONG_LEVEL) * np.sqrt(variance) / config.prior.free_sigma)
    odds = chance + 0.5 * off**2 + NATS_PER_EDGE * (face.doubt - free.doubt)
    return LevelCheck(apart, float(off), float(1 / (1 + np.exp(-odds))))


def range_doubt(shot: ShotView, candidate: Candidate, config: LocalizerConfig) -> FloatArray:
    """Return what missing uprights leave in doubt of a pose whose height is unknown.

    An upright that is not where the pose says is farther aside than it was looked for: the face may be larger or
    smaller than its model by that over its half width, and nearer or farther away by the same part of its range. As
    it is the other end that holds then, its middle may be as far aside.

    Parameters
    ----------
    shot : ShotView
        The shot.
    candidate : Candidate
        With the fit of its face.
    config : LocalizerConfig
        Parameters.

    Returns
    -------
    (4, 4) array
        To be added to the covariance; zero where hardly an upright is missing.
    """
    face, pose, added = candidate.face, candidate.pose, np.zeros((4, 4))
    if face is None or pose is None:
        return added
    visible = visible_lines(candidate.model, face.seen.plane_from_camera)
    expected = sum(not line.whole.horizontal for line in visible)  # one that is hidden confirms nothing, either
    pairs = zip(face.seen.edges, face.weights, strict=True)
    found = sum(float(weight) for one, weight in pairs if not one.edge.horizontal)
    aside = max(expected - found - MISSED, 0.0) * config.face_fit.reach
    ray = (np.array([pose.x, pose.y, pose.z]) - shot.mounting.center) * aside / (candidate.model.width / 2)
    along = aside * np.array([np.sin(pose.yaw), -np.cos(pose.yaw), 0.0])
    added[:3, :3] = np.outer(ray, ray) + np.outer(along, along)
    return added
