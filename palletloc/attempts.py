"""Fits of one candidate from several starts: each is checked, the best one kept, and rivals widen its covariance."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace

import numpy as np

from palletloc.candidate import Candidate, ShotView
from palletloc.config import LocalizerConfig
from palletloc.geometry import LevelPose, wrap_angle
from palletloc.level_check import WRONG_LEVEL, check_level, range_doubt
from palletloc.measurement import HeightPrior, Reason, Stage
from palletloc.refinement.alignment import FaceEstimate, fit_face, same_pose
from palletloc.refinement.appearance import opening_contrasts, shown_openings
from palletloc.refinement.hypotheses import score_pose
from palletloc.refinement.occluder import posts, seen_before
from palletloc.refinement.occlusion import Spans
from palletloc.refinement.patch import FacePatch
from palletloc.verification import WEAK_DOUBT, Signs, of_use, verify

MOST_ATTEMPTS = 3
"""How many starts are tried where only the face gives yaw or distance."""
DOUBTED_APART, REFUSED_APART, REFUSED_APART_DEG = 2.5, 4.0, 1.0
"""How far the yaw of the level lines may be off: in their standard deviations until the pose becomes less certain,
and in those and in degrees until it is refused."""
LEVEL_DOUBT = 1.0
"""Doubt from which on the level is asked whether the face agrees: a wrong one leaves about an edge or more aside."""
GLANCE_CONTRAST = 0.9
"""Contrast of openings and blocks below which a start shows no pallet, in spreads of the blocks."""
GLANCE_DOUBT = 0.3
"""Doubt that a good fit leaves: what it would add to what a glance at a start shows."""

Prepare = Callable[[Candidate, LevelPose], LevelPose]
"""Readies a candidate for a fit from a start, and returns where to begin."""


def keep_best(
    shot: ShotView,
    candidate: Candidate,
    starts: Iterable[tuple[LevelPose, FacePatch]],
    prepare: Prepare,
    weak: bool,
    config: LocalizerConfig,
) -> None:
    """Fit the face from one start after the other, until one leaves no doubt, and keep the best.

    Where only the face gives the yaw, or nothing is known of the height, the first good fit may have a rival:
    more are tried, until two starts lead to the same pose.

    Parameters
    ----------
    shot : ShotView
        The shot.
    candidate : Candidate
        Gets the best attempt's results, or its refusal.
    starts : iterable of (LevelPose, FacePatch)
        Where to begin, the best first, each with a view of its surroundings.
    prepare : callable
        What to do before each fit.
    weak : bool
        Whether only the face gives the yaw, or nothing is known of the height.
    config : LocalizerConfig
        Parameters.
    """
    attempts: list[Candidate] = []
    for start, patch in starts:
        # a refused fit may have taken a line for its neighbour; at any height, though, too much looks like a pallet
        ruling = [one.pose for one in attempts if one.refusal is None or candidate.height is None]
        if any(pose is not None and _near(start, pose) for pose in ruling):
            continue  # it would lead to the same pose
        if not _may_be_pallet(patch, start, candidate, config):
            continue  # most places that are not a pallet end here
        attempt = replace(candidate, horizontal=list(candidate.horizontal))
        known = [one.pose for one in attempts if one.pose is not None]
        _fit(shot, attempt, prepare(attempt, start), patch, known, config)
        attempts.append(attempt)
        certain = not weak and _is_certain(attempt, config)
        agreed = attempt.pose is not None and any(same_pose(attempt.pose, one) for one in known)
        if certain or agreed or len(attempts) == MOST_ATTEMPTS:
            break
    if not attempts:
        return candidate.refuse(Stage.VERIFICATION, Reason.LOW_CONTRAST)
    best = max(attempts, key=lambda one: one.likelihood)
    if best.face is not None:
        doubt = best.face.doubt
        growth = max(doubt - (WEAK_DOUBT if weak else config.face_fit.max_doubt), 0.0) ** 2
        _widen(best, growth, attempts)
    candidate.take(best)
    if candidate.refusal is None:
        _doubt_height(shot, candidate, config)
    uncertain = candidate.covariance is None or not of_use(candidate.covariance, config.verification)
    if candidate.refusal is None and uncertain:
        candidate.refuse(Stage.VERIFICATION, Reason.UNCERTAIN)
    return None


def _may_be_pallet(patch: FacePatch, start: LevelPose, candidate: Candidate, config: LocalizerConfig) -> bool:
    """Tell whether a start could pass the checks if all edges were found; where it is not wholly seen, it may."""
    contrast = _contrast(patch, start, candidate)
    if np.isnan(contrast):
        return True
    if contrast < GLANCE_CONTRAST:
        return False
    hoped = Signs(contrast, 1.0, 0.0, GLANCE_DOUBT)
    if verify(hoped, config.verification).reason is None:
        return True  # whatever its score
    hoped = hoped._replace(score=score_pose(patch, candidate.model, start))
    return verify(hoped, config.verification).reason is None


def _is_certain(attempt: Candidate, config: LocalizerConfig) -> bool:
    """Tell whether a fit leaves no doubt that another start may lead to a better one."""
    if attempt.face is None:
        return False
    beyond_doubt = attempt.refusal is None and attempt.rank >= config.verification.certain
    return beyond_doubt or attempt.face.doubt < config.face_fit.max_doubt


def _contrast(patch: FacePatch, pose: LevelPose, candidate: Candidate, hidden: Spans = ()) -> float:
    """Return how clearly the less clear opening differs from the blocks beside it, NaN where that is not seen."""
    shown = shown_openings(candidate.model, hidden)
    return float(opening_contrasts(patch, candidate.model, pose, hidden)[shown].min()) if shown.any() else 0.0


def _fit(
    shot: ShotView,
    candidate: Candidate,
    pose: LevelPose,
    patch: FacePatch,
    known: Sequence[LevelPose],
    config: LocalizerConfig,
) -> None:
    model = candidate.model
    height = candidate.height or HeightPrior(candidate.start.z, config.prior.free_sigma)
    if candidate.yaw is not None:
        candidate.yaw_from = candidate.yaw.source
    yaw = candidate.yaw_prior
    spread = float(np.radians(config.prior.yaw_sigma_deg))
    before = posts(patch, model, pose)
    face = fit_face(
        shot.projector.camera,
        shot.image,
        shot.mounting,
        pose,
        model,
        height,
        yaw,
        spread,
        config.face_fit,
        known,
        before,
    )
    if isinstance(face, Reason):
        return candidate.refuse(Stage.POSITION, face)
    candidate.face = face
    found = face.forklift_from_pallet
    candidate.pose, candidate.covariance = found, face.covariance
    spans = face.seen.hidden
    covered = (*spans, *posts(patch, model, found))
    bare = covered if shown_openings(model, covered).any() else spans
    contrast = float(np.nan_to_num(_contrast(patch, found, candidate, bare)))
    score, width = score_pose(patch, model, found, spans), face.seen.width_px(model.width)
    explained = seen_before(patch, model, found, spans)
    signs = Signs(contrast, face.coverage, score, face.doubt, face.seen.hidden_part, explained, width)
    candidate.verification = verify(signs, config.verification)
    if candidate.height is not None and abs(found.z - height.z) > 4 * height.sigma:
        return candidate.refuse(Stage.VERIFICATION, Reason.OFF_LEVEL)
    if candidate.verification.reason is not None:
        return candidate.refuse(Stage.VERIFICATION, candidate.verification.reason)
    return _compare_yaws(candidate, face)


def _compare_yaws(candidate: Candidate, face: FaceEstimate) -> None:
    """Refuse a pose whose yaw the level lines alone contradict, or make it less certain."""
    said = face.level_yaw
    if said is None or candidate.covariance is None:
        return None
    apart = abs(said.turn) / said.sigma
    if apart > REFUSED_APART and abs(said.turn) > np.radians(REFUSED_APART_DEG):
        return candidate.refuse(Stage.VERIFICATION, Reason.YAW_DISAGREES)
    if apart > DOUBTED_APART:
        candidate.covariance = candidate.covariance * (1 + said.turn**2 / candidate.covariance[3, 3])
    return None


def _doubt_height(shot: ShotView, candidate: Candidate, config: LocalizerConfig) -> None:
    """Refuse a pose whose level the face contradicts, or make it less certain."""
    if candidate.face is None or candidate.covariance is None:
        return None
    if candidate.height is None:
        candidate.covariance = candidate.covariance + range_doubt(shot, candidate, config)
        return None
    check = None if candidate.face.doubt < LEVEL_DOUBT else check_level(shot, candidate, config)
    if check is None or check.wrong < WRONG_LEVEL:
        return None  # the face speaks rather for its level than against it
    if check.contradicts:
        return candidate.refuse(Stage.VERIFICATION, Reason.OFF_LEVEL)
    candidate.covariance = candidate.covariance + check.wrong * np.outer(check.apart, check.apart)
    return None


def _widen(best: Candidate, growth: float, attempts: Sequence[Candidate]) -> None:
    """Widen the covariance by what the edges leave in doubt, and by rivals as far as they are likely."""
    if best.pose is None or best.covariance is None:
        return
    best.covariance = best.covariance * (1 + growth)
    rivals = [one for one in attempts if one.pose is not None]
    if len(rivals) < 2:
        return
    weight = np.exp([rival.likelihood - best.likelihood for rival in rivals])
    apart = np.array([rival.pose.as_array() - best.pose.as_array() for rival in rivals if rival.pose])
    apart[:, 3] = wrap_angle(apart[:, 3])
    best.covariance = best.covariance + (weight[:, None] * apart).T @ apart / weight.sum()


def _near(one: LevelPose, other: LevelPose) -> bool:
    apart = np.linalg.norm(one.as_array()[:3] - other.as_array()[:3])
    return bool(apart < 0.04 and abs(wrap_angle(one.yaw - other.yaw)) < np.radians(2.0))
