"""Fits of one candidate from several starts, and the decision between a fit and its rivals.

One currency serves everywhere: how much likelier one explanation of the image is than another, in nats.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import chain

import numpy as np

from palletloc.candidate import Candidate, Fit, Refusal
from palletloc.config import LocalizerConfig
from palletloc.contrast import least_contrast
from palletloc.face import visible_lines
from palletloc.geometry import FloatArray, LevelPose
from palletloc.measurement import HeightPrior, Reason, Stage, YawSource
from palletloc.pallet import PalletModel
from palletloc.refinement.face_fit import FaceEstimate, FacePrior, YawPrior, fit_face
from palletloc.refinement.hypotheses import score_pose
from palletloc.refinement.occlusion import explained_part, visible_occluders
from palletloc.refinement.patch import FacePatch
from palletloc.rivals import Rival, any_height, other_starts
from palletloc.shot import Shot
from palletloc.verification import WEAK_DOUBT, Evidence, of_use, verify

MOST_ATTEMPTS = 3
"""How many starts are tried where only the face gives yaw or distance: as many as the search returns."""
DOUBTED_APART, REFUSED_APART, REFUSED_APART_DEG = 2.5, 4.0, 1.0
"""How far the yaw of the level lines may be off: in their standard deviations until the pose becomes less certain,
and in those and in degrees until it is refused."""
GLANCE_CONTRAST = 0.9
"""Contrast of openings and blocks below which a start shows no pallet, in spreads of the blocks."""
GLANCE_DOUBT = 0.3
"""Doubt that a good fit leaves: what it would add to what a glance at a start shows."""
NEAR, NEAR_DEG = 0.04, 2.0
"""How near a start is to an earlier fit to lead to the same pose, in metres and degrees: within a fit's reach."""
MOST_OFF_LEVEL = 4.0
"""How far a fit's height may be off its level, in standard deviations of the level."""
MISSED = 1.0
"""How many uprights a right pose misses at most, as a rule."""


@dataclass(frozen=True, slots=True)
class FitStart:
    """Where a fit begins, and what is known of its yaw."""

    pose: LevelPose
    """``forklift_from_pallet``."""
    yaw_from: YawSource
    """What gives the yaw."""
    yaw: YawPrior | None = None
    """What a horizontal plane says of the yaw; None where the face has to give it."""
    steps: tuple[object, ...] = ()
    """Results of the steps that led here."""


Prepare = Callable[[LevelPose], FitStart]
"""Readies a start of the search for a fit."""


def fit_from_starts(
    shot: Shot,
    candidate: Candidate,
    starts: Iterable[tuple[LevelPose, FacePatch]],
    prepare: Prepare,
    weak: bool,
    config: LocalizerConfig,
    steps: tuple[object, ...] = (),
) -> Fit | Refusal:
    """Fit the face from one start after the other, until one leaves no doubt, and decide between the fits.

    Where only the face gives the yaw, or nothing is known of the height, the first good fit may have a rival:
    more are tried, until two starts lead to the same pose.

    Parameters
    ----------
    shot : Shot
        The shot.
    candidate : Candidate
        What is fitted.
    starts : iterable of (LevelPose, FacePatch)
        Where to begin, the best first, each with a view of its surroundings.
    prepare : callable
        What to do before each fit.
    weak : bool
        Whether only the face gives the yaw, or nothing is known of the height.
    config : LocalizerConfig
        Parameters.
    steps : tuple
        Results of the steps before, to be kept.

    Returns
    -------
    Fit or Refusal
        The likeliest attempt's; as uncertain as its edges and its rivals leave it.
    """
    attempts: list[Fit | Refusal] = []
    for start, patch in starts:
        # a refused fit may have taken a line for its neighbour; at any height, though, too much looks like a pallet
        ruling = [attempt.fit for attempt in attempts if isinstance(attempt, Fit) or candidate.height is None]
        if any(fit is not None and _near(start, fit.pose) for fit in ruling):
            continue  # it would lead to the same pose
        if not may_be_pallet(patch, start, candidate, config):
            continue  # most places that are not a pallet end here
        earlier = [attempt.fit.pose for attempt in attempts if attempt.fit is not None]
        prepared = prepare(start)
        prepared = replace(prepared, steps=(*steps, *prepared.steps))
        attempt = _attempt(shot, candidate, prepared, patch, earlier, config)
        attempts.append(attempt)
        certain = not weak and _is_certain(attempt, config)
        if certain or _is_repeated(attempt) or len(attempts) == MOST_ATTEMPTS:
            break
    if not attempts:
        return Refusal(candidate, Stage.VERIFICATION, Reason.LOW_CONTRAST, None, steps)
    best = max(attempts, key=lambda attempt: attempt.likelihood)
    doubted = _with_doubt(shot, best, weak, config)
    heights = any_height(shot, best, config) if isinstance(best, Fit) else ()
    return decide(doubted, chain(other_starts(best, attempts), heights), config)


def decide(best: Fit | Refusal, rivals: Iterable[Rival], config: LocalizerConfig) -> Fit | Refusal:
    """Decide between a fit and other explanations of the image.

    Parameters
    ----------
    best : Fit or Refusal
        What was measured.
    rivals : iterable of Rival
        Other explanations, which exclude each other. They are looked at one by one, and no further than to the first
        that wins.
    config : LocalizerConfig
        Parameters.

    Returns
    -------
    Fit or Refusal
        What was refused gives way to a rival that was not. A fit gives way to a rival that is likelier and stands
        apart from it, or is refused where that one can't be taken. Rivals that are less likely widen its
        covariance by their distance, weighted by their posterior probability; a fit that is not of use then is
        refused, too.
    """
    odds, apart = [0.0], [np.zeros(4)]
    for rival in rivals:
        if isinstance(best, Refusal) and rival.instead is not None:
            return rival.instead
        if isinstance(best, Fit) and rival.wins:
            return rival.instead or replace(_given_up(best, rival.reason), better=rival.better)
        odds.append(rival.nats)
        apart.append(rival.apart)
    if len(odds) > 1:
        best = _widened(best, _mixed(np.array(odds), np.array(apart)))
    if isinstance(best, Fit) and best.face is not None and not of_use(best.covariance, config.verification):
        return _given_up(best, Reason.UNCERTAIN)
    return best


def _given_up(fit: Fit, reason: Reason) -> Refusal:
    """Return the refusal of a fit that did not pass the checks of its pose."""
    return Refusal(fit.candidate, Stage.VERIFICATION, reason, fit, fit.steps)


def _widened(best: Fit | Refusal, added: FloatArray) -> Fit | Refusal:
    """Return a fit, given up or not, with a (4, 4) covariance added to its own."""
    if best.fit is None:
        return best
    wider = replace(best.fit, covariance=best.fit.covariance + added)
    return wider if isinstance(best, Fit) else replace(best, fit=wider)


def _mixed(odds: FloatArray, apart: FloatArray) -> FloatArray:
    """Return what alternatives add to the covariance of the first: a mixture's second moment about it."""
    weight = np.exp(odds - odds.max())
    return np.asarray((weight[:, None] * apart).T @ apart / weight.sum())


def _attempt(
    shot: Shot,
    candidate: Candidate,
    start: FitStart,
    patch: FacePatch,
    earlier: Sequence[LevelPose],
    config: LocalizerConfig,
) -> Fit | Refusal:
    """Fit the face from one start and check what it shows at the pose."""
    model, steps = candidate.model, start.steps
    height = candidate.height or HeightPrior(candidate.start.z, config.prior.free_sigma)
    spread = float(np.radians(config.prior.yaw_sigma_deg))
    prior = FacePrior(height, start.yaw, spread, visible_occluders(patch, model, start.pose))
    face = fit_face(shot, start.pose, model, prior, config.face_fit, earlier)
    if isinstance(face, Reason):
        return Refusal(candidate, Stage.POSITION, face, None, steps)
    pose = face.forklift_from_pallet
    evidence = _evidence(patch, model, face)
    fit = Fit(candidate, pose, face.covariance, start.yaw_from, face, prior, evidence, steps)
    if candidate.height is not None and abs(pose.z - height.z) > MOST_OFF_LEVEL * height.sigma:
        return _given_up(fit, Reason.OFF_LEVEL)
    failed = verify(evidence, config.verification)
    return _compared(fit, face) if failed is None else _given_up(fit, failed)


def _evidence(patch: FacePatch, model: PalletModel, face: FaceEstimate) -> Evidence:
    """Return what a face shows at its fitted pose."""
    pose, spans = face.forklift_from_pallet, face.seen.hidden
    occluders, explained = visible_occluders(patch, model, pose), explained_part(patch, model, pose, spans)
    contrast = float(np.nan_to_num(least_contrast(patch, model, pose, spans, occluders)))
    score, width = score_pose(patch, model, pose, spans), face.seen.width_px(model.width)
    return Evidence(contrast, face.coverage, score, face.doubt, face.seen.hidden_part, explained, width)


def _compared(fit: Fit, face: FaceEstimate) -> Fit | Refusal:
    """Refuse a pose whose yaw the level lines alone contradict, or make it less certain."""
    lines = face.level_yaw
    if lines is None:
        return fit
    apart = abs(lines.turn) / lines.sigma
    if apart > REFUSED_APART and abs(lines.turn) > np.radians(REFUSED_APART_DEG):
        return _given_up(fit, Reason.YAW_DISAGREES)
    if apart > DOUBTED_APART:
        return replace(fit, covariance=fit.covariance * (1 + lines.turn**2 / fit.covariance[3, 3]))
    return fit


def _with_doubt(shot: Shot, best: Fit | Refusal, weak: bool, config: LocalizerConfig) -> Fit | Refusal:
    """Widen a covariance by what the edges leave in doubt, and at any height by what they leave of its range."""
    fit = best.fit
    if fit is None or fit.face is None:
        return best
    doubt = fit.face.doubt - (WEAK_DOUBT if weak else config.face_fit.max_doubt)
    best = _widened(best, fit.covariance * max(doubt, 0.0) ** 2)
    if isinstance(best, Fit) and best.candidate.height is None:
        return _widened(best, _range_doubt(shot, fit, fit.face, config))
    return best


def _range_doubt(shot: Shot, fit: Fit, face: FaceEstimate, config: LocalizerConfig) -> FloatArray:
    """Return what missing uprights leave in doubt of a pose whose height is unknown, to be added to its covariance.

    An upright that is not where the pose says is farther aside than it was looked for: the face may be larger or
    smaller than its model by that over its half width, and nearer or farther away by the same part of its range. As
    it is the other end that holds then, its middle may be as far aside.
    """
    pose, model, added = fit.pose, fit.candidate.model, np.zeros((4, 4))
    visible = visible_lines(model, face.seen.plane_from_camera)
    expected = sum(not line.whole.horizontal for line in visible)  # one that is hidden confirms nothing, either
    pairs = zip(face.seen.edges, face.weights, strict=True)
    found = sum(float(weight) for edge, weight in pairs if not edge.edge.horizontal)
    aside = max(expected - found - MISSED, 0.0) * config.face_fit.reach
    ray = (np.array([pose.x, pose.y, pose.z]) - shot.mounting.center) * aside / (model.width / 2)
    along = aside * np.array([np.sin(pose.yaw), -np.cos(pose.yaw), 0.0])
    added[:3, :3] = np.outer(ray, ray) + np.outer(along, along)
    return added


def may_be_pallet(patch: FacePatch, start: LevelPose, candidate: Candidate, config: LocalizerConfig) -> bool:
    """Tell whether a start could pass the checks if all edges were found; where it is not wholly seen, it may."""
    contrast = least_contrast(patch, candidate.model, start)
    if np.isnan(contrast):
        return True
    if contrast < GLANCE_CONTRAST:
        return False
    most = Evidence(contrast, 1.0, 0.0, GLANCE_DOUBT)
    if verify(most, config.verification) is None:
        return True  # whatever its score
    most = replace(most, score=score_pose(patch, candidate.model, start))
    return verify(most, config.verification) is None


def _is_certain(attempt: Fit | Refusal, config: LocalizerConfig) -> bool:
    """Tell whether a fit leaves no doubt that another start may lead to a better one."""
    if attempt.fit is None or attempt.fit.face is None:
        return False
    beyond_doubt = isinstance(attempt, Fit) and attempt.rank >= config.verification.certain
    return beyond_doubt or attempt.fit.face.doubt < config.face_fit.max_doubt


def _is_repeated(attempt: Fit | Refusal) -> bool:
    """Tell whether a fit came to the pose of an earlier one."""
    return attempt.fit is not None and attempt.fit.face is not None and attempt.fit.face.repeated


def _near(pose: LevelPose, other: LevelPose) -> bool:
    apart = pose.minus(other)
    return bool(np.linalg.norm(apart[:3]) < NEAR and abs(apart[3]) < np.radians(NEAR_DEG))
