"""The order of the steps: the paper's chain with lines to a fraction of a pixel."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from palletloc.boundary import BoundaryLine
from palletloc.candidate import Candidate, ShotView
from palletloc.config import LocalizerConfig
from palletloc.contrast import face_contrast
from palletloc.face_fit import YawPrior, fit_face
from palletloc.face_view import MIN_DISTANCE, view_face
from palletloc.geometry import FloatArray, LevelPose, wrap_angle
from palletloc.horizontal_view import horizontal_source, view_horizontal
from palletloc.measurement import HeightPrior, Reason, Stage, YawSource
from palletloc.position import sweep
from palletloc.verification import verify
from palletloc.yaw import find_lines, measure_line, measure_yaw

GLANCE_RESOLUTION = 0.006
"""Metres per pixel of the view that tells most places from a pallet at a glance."""
RANGE_SLACK = 1.2
"""How much farther than detections a given start may be."""
MOST_ATTEMPTS = 3
"""How many peaks of the sweep are tried where only the face gives yaw or distance."""
RIVAL_MARGIN = 0.05
"""How much less a rival may agree with the image to be taken seriously."""
SWEPT_CONTRAST = 1.2
"""Contrast of openings and blocks below which that view shows no pallet, in spreads of the blocks."""


def measure_on_planes(shot: ShotView, candidate: Candidate, config: LocalizerConfig) -> None:
    """Measure a candidate: yaw (B), position (C), yaw again where the position puts the plane, then the edges.

    Parameters
    ----------
    shot : ShotView
        The shot.
    candidate : Candidate
        Gets the results, or its refusal.
    config : LocalizerConfig
        Parameters.
    """
    hidden = out_of_sight(shot, candidate, config)
    if hidden is not None:
        return candidate.refuse(Stage.START, hidden)
    source = horizontal_plane_for(shot, candidate, config)
    pose = _line_yaw(shot, candidate, source, config)
    swept = sweep(
        shot.projector,
        shot.image,
        shot.camera_from_forklift,
        pose,
        candidate.model,
        candidate.height,
        source is not YawSource.FACE,
        config.position,
    )
    if isinstance(swept, Reason):
        return candidate.refuse(Stage.POSITION, swept)
    candidate.sweep = swept
    weak = source is YawSource.FACE or candidate.height is None
    attempts = _attempts(shot, candidate, source, swept.peaks, weak, config)
    if not attempts:
        return candidate.refuse(Stage.VERIFICATION, Reason.LOW_CONTRAST)
    best = max(attempts, key=_standing)
    if best.face is not None:
        doubt = best.face.doubt
        growth = doubt**2 if weak else max(doubt - config.face_fit.max_doubt, 0.0)
        _widen(best, growth, attempts if weak else [best])
    for name in ("horizontal", "yaw", "yaw_from", "face", "pose", "covariance", "verification", "refusal"):
        setattr(candidate, name, getattr(best, name))
    return None


def _attempts(
    shot: ShotView,
    candidate: Candidate,
    source: YawSource,
    peaks: Sequence[LevelPose],
    weak: bool,
    config: LocalizerConfig,
) -> list[Candidate]:
    """Fit the face from one peak of the sweep after the other, until one leaves no doubt.

    Where only the face gives the yaw, or nothing is known of the height, the first good fit may have a rival:
    more are tried, until two starts lead to the same pose.
    """
    attempts: list[Candidate] = []
    for peak in peaks:
        if any(one.pose is not None and _near(peak, one.pose) for one in attempts):
            continue  # it would lead to the same pose
        if not _looks_like_pallet(shot, candidate, peak):
            continue
        attempt = replace(candidate, horizontal=list(candidate.horizontal))
        _fit(shot, attempt, _voted_yaw(shot, attempt, source, peak, config), config)
        attempts.append(attempt)
        certain = attempt.face is not None and attempt.face.doubt < config.face_fit.max_doubt
        confirmed = any(_agree(attempt, one) for one in attempts[:-1])
        if confirmed or (certain and (not weak or len(attempts) == MOST_ATTEMPTS)):
            break
    return attempts


def _agree(one: Candidate, other: Candidate) -> bool:
    if one.pose is None or other.pose is None:
        return False
    apart = np.abs(one.pose.as_array() - other.pose.as_array())
    return bool(apart[:3].max() < 0.01 and abs(wrap_angle(float(apart[3]))) < np.radians(0.3))


def _standing(attempt: Candidate) -> float:
    """Return how well an attempt explains the image."""
    return attempt.verification.score if attempt.verification else -1.0


def _widen(best: Candidate, growth: float, attempts: Sequence[Candidate]) -> None:
    """Widen the covariance by what the edges leave in doubt, and by rivals that explain the image nearly as well."""
    if best.pose is None or best.covariance is None:
        return
    rivals = [one.pose for one in attempts if one.pose and _standing(one) > _standing(best) - RIVAL_MARGIN]
    apart = np.array([rival.as_array() - best.pose.as_array() for rival in rivals])
    apart[:, 3] = wrap_angle(apart[:, 3])
    best.covariance = best.covariance * (1 + growth) + apart.T @ apart / len(apart)


def _looks_like_pallet(shot: ShotView, candidate: Candidate, pose: LevelPose) -> bool:
    """Tell whether blocks and openings differ at all: most places that are not a pallet end here."""
    seen = view_face(shot.projector, shot.image, shot.camera_from_forklift, pose, candidate.model, GLANCE_RESOLUTION)
    if isinstance(seen, Reason):
        return True  # the fit tells the reason
    return face_contrast(seen.view, candidate.model) >= SWEPT_CONTRAST


def _near(one: LevelPose, other: LevelPose) -> bool:
    apart = np.linalg.norm(one.as_array()[:3] - other.as_array()[:3])
    return bool(apart < 0.04 and abs(wrap_angle(one.yaw - other.yaw)) < np.radians(2.0))


def out_of_sight(shot: ShotView, candidate: Candidate, config: LocalizerConfig) -> Reason | None:
    """Tell why a candidate's face cannot be seen where it begins.

    Parameters
    ----------
    shot : ShotView
        The shot.
    candidate : Candidate
        The candidate.
    config : LocalizerConfig
        Parameters.

    Returns
    -------
    Reason or None
        `Reason.OUT_OF_RANGE`, `Reason.BEHIND_FACE` or None.
    """
    if np.hypot(*_from_camera(shot, candidate)[:2]) > RANGE_SLACK * config.detection.max_range:
        return Reason.OUT_OF_RANGE
    return Reason.BEHIND_FACE if _distance(shot, candidate) < MIN_DISTANCE else None


def horizontal_plane_for(shot: ShotView, candidate: Candidate, config: LocalizerConfig) -> YawSource:
    """Choose the edge of a candidate's face that the horizontal plane goes through."""
    below = -float(_from_camera(shot, candidate)[2])
    return horizontal_source(candidate.model, below, _distance(shot, candidate), config.yaw)


def _from_camera(shot: ShotView, candidate: Candidate) -> FloatArray:
    start = candidate.start
    return np.array([start.x, start.y, start.z]) - shot.mounting.center


def _distance(shot: ShotView, candidate: Candidate) -> float:
    """Return the distance of the camera from the plane of the face, negative behind it, in metres."""
    x, y, _ = _from_camera(shot, candidate)
    return float(x * np.cos(candidate.start.yaw) + y * np.sin(candidate.start.yaw))


def _line_yaw(shot: ShotView, candidate: Candidate, source: YawSource, config: LocalizerConfig) -> LevelPose:
    """Turn the start by the boundary line next to the view's centre, found by Hough and measured by its peaks."""
    start = candidate.start
    if source is YawSource.FACE:
        return start
    seen = view_horizontal(
        shot.projector, shot.image, shot.camera_from_forklift, start, candidate.model, source, config.yaw
    )
    candidate.horizontal.append(seen)
    candidate.lines = find_lines(seen, config.yaw)
    line = nearest_line(candidate.lines)
    if line is None:
        return start
    fit = measure_line(shot.projector, seen, line, candidate.model, config.yaw)
    turn = line.turn if fit is None else float(np.arctan(fit.slope))
    return replace(start, yaw=wrap_angle(start.yaw + turn))


def nearest_line(lines: list[BoundaryLine]) -> BoundaryLine | None:
    """Return the line nearest to the view's centre among those that are nearly as long as the longest."""
    if not lines:
        return None
    longest = max(line.votes for line in lines)
    return min((line for line in lines if line.votes >= 0.5 * longest), key=lambda line: abs(line.up))


def _voted_yaw(
    shot: ShotView, candidate: Candidate, source: YawSource, pose: LevelPose, config: LocalizerConfig
) -> LevelPose:
    """Measure the yaw by all level edges, twice: the second plane is placed by the first's result."""
    if source is YawSource.FACE:
        return pose
    for _ in range(2):
        seen = view_horizontal(
            shot.projector, shot.image, shot.camera_from_forklift, pose, candidate.model, source, config.yaw
        )
        estimate = measure_yaw(shot.projector, seen, pose, candidate.model, config.yaw)
        if isinstance(estimate, Reason):
            candidate.yaw = None
            break
        candidate.horizontal.append(seen)
        candidate.yaw = estimate
        turned = abs(wrap_angle(estimate.yaw - pose.yaw))
        pose = replace(pose, yaw=estimate.yaw)
        if turned < np.radians(0.1):
            break
    return pose


def _fit(shot: ShotView, candidate: Candidate, pose: LevelPose, config: LocalizerConfig) -> None:
    height = candidate.height or HeightPrior(candidate.start.z, config.prior.free_sigma)
    yaw = None
    if candidate.yaw is not None:
        candidate.yaw_from = candidate.yaw.source
        up = candidate.model.height if candidate.yaw.source is YawSource.TOP else 0.0
        yaw = YawPrior(candidate.yaw.sigma, up)
    spread = float(np.radians(config.prior.yaw_sigma_deg))
    face = fit_face(
        shot.projector, shot.image, shot.mounting, pose, candidate.model, height, yaw, spread, config.face_fit
    )
    if isinstance(face, Reason):
        return candidate.refuse(Stage.POSITION, face)
    candidate.face = face
    candidate.pose, candidate.covariance = face.forklift_from_pallet, face.covariance
    candidate.verification = verify(face, candidate.model, config.verification)
    if candidate.height is not None and abs(face.forklift_from_pallet.z - height.z) > 5 * height.sigma:
        return candidate.refuse(Stage.VERIFICATION, Reason.OFF_LEVEL)
    if face.doubt > config.verification.max_doubt:
        return candidate.refuse(Stage.VERIFICATION, Reason.FEW_EDGES)
    if candidate.verification.reason is not None:
        return candidate.refuse(Stage.VERIFICATION, candidate.verification.reason)
    return None
