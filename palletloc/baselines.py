"""The methods to compare with: the paper's chain, as it is written and with lines to a fraction of a pixel."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from palletloc.candidate import Candidate, Fit, Refusal
from palletloc.config import LocalizerConfig
from palletloc.fitting import MOST_OFF_LEVEL, FitStart, fit_from_starts, may_be_pallet
from palletloc.geometry import FloatArray, LevelPose, wrap_angle
from palletloc.measurement import Reason, Stage, YawSource
from palletloc.pallet import PalletModel
from palletloc.paper.boundary import BoundaryLine
from palletloc.paper.horizontal_view import horizontal_source, view_horizontal
from palletloc.paper.joint_search import search_jointly
from palletloc.paper.position import sweep
from palletloc.paper.yaw import find_lines, measure_line, measure_yaw
from palletloc.refinement.face_fit import YawPrior
from palletloc.refinement.patch import FacePatch, view_patch
from palletloc.shot import Shot, out_of_sight
from palletloc.verification import of_use

NEAR_PEAK = 0.95
"""Hypotheses that score this part of the best one are taken for as good: the spread of the covariance."""
GLANCE_RESOLUTION = 0.006
"""Metres per pixel of the view that tells most places from a pallet at a glance."""
MARGIN = 0.08
"""What that view shows beyond the face, in metres."""
LONG = 0.5
"""Part of the longest line's votes from which on another line may be the face's, too."""
SMALL_TURN_DEG = 0.1
"""Correction of the yaw below which the horizontal plane is not placed again, in degrees."""


def measure_on_planes(shot: Shot, candidate: Candidate, config: LocalizerConfig) -> Fit | Refusal:
    """Measure a candidate: yaw (B), position (C), yaw again where the position puts the plane, then the edges.

    Parameters
    ----------
    shot : Shot
        The shot.
    candidate : Candidate
        Where a pallet may stand.
    config : LocalizerConfig
        Parameters.

    Returns
    -------
    Fit or Refusal
        With lines, horizontal views, sweep and yaw among its steps.
    """
    camera = shot.camera_in(candidate.start)
    hidden = out_of_sight(camera, config.farthest_start)
    if hidden is not None:
        return Refusal(candidate, Stage.START, hidden)
    model = candidate.model
    source = horizontal_source(model, camera, config.yaw)
    turned, steps = _line_yaw(shot, candidate, source, config)
    swept = sweep(shot, turned, model, candidate.height, source is not YawSource.FACE, config.position)
    if isinstance(swept, Reason):
        return Refusal(candidate, Stage.POSITION, swept, None, steps)
    weak = source is YawSource.FACE or candidate.height is None

    def prepared(peak: LevelPose) -> FitStart:
        return _voted_yaw(shot, model, source, FitStart(peak, YawSource.FACE), config)

    return fit_from_starts(
        shot, candidate, _surroundings(shot, model, swept.peaks), prepared, weak, config, (*steps, swept)
    )


def _surroundings(
    shot: Shot, model: PalletModel, poses: Iterable[LevelPose]
) -> Iterator[tuple[LevelPose, FacePatch]]:
    """Yield poses with a view of each, where there is one."""
    half, high = model.width / 2 + MARGIN, model.height + MARGIN
    for pose in poses:
        patch = view_patch(shot, pose, (-half, half, -MARGIN, high), GLANCE_RESOLUTION)
        if not isinstance(patch, Reason):
            yield pose, patch


def _line_yaw(
    shot: Shot, candidate: Candidate, source: YawSource, config: LocalizerConfig
) -> tuple[LevelPose, tuple[object, ...]]:
    """Turn the start by the boundary line next to the view's centre, found by Hough and measured by its peaks.

    Returns it with the view and the lines that were found.
    """
    start = candidate.start
    if source is YawSource.FACE:
        return start, ()
    seen = view_horizontal(shot, start, candidate.model, source, config.yaw)
    lines = find_lines(seen, config.yaw)
    line = nearest_line(lines)
    if line is None:
        return start, (seen, *lines)
    fit = measure_line(shot, seen, line, candidate.model, config.yaw)
    turn = line.turn if fit is None else float(np.arctan(fit.slope))
    return replace(start, yaw=wrap_angle(start.yaw + turn)), (seen, *lines)


def nearest_line(lines: list[BoundaryLine]) -> BoundaryLine | None:
    """Return the line nearest to the view's centre among those that are nearly as long as the longest."""
    if not lines:
        return None
    longest = max(line.votes for line in lines)
    return min((line for line in lines if line.votes >= LONG * longest), key=lambda line: abs(line.up))


def _voted_yaw(
    shot: Shot, model: PalletModel, source: YawSource, start: FitStart, config: LocalizerConfig
) -> FitStart:
    """Measure the yaw by all level edges, twice: the second plane is placed by the first's result."""
    if source is YawSource.FACE:
        return start
    voted, pose, steps = start, start.pose, start.steps
    for _ in range(2):
        seen = view_horizontal(shot, pose, model, source, config.yaw)
        estimate = measure_yaw(shot, seen, pose, model, config.yaw)
        if isinstance(estimate, Reason):
            return replace(start, pose=pose, steps=steps)
        steps = (*steps, seen)
        turned = abs(wrap_angle(estimate.yaw - pose.yaw))
        pose = replace(pose, yaw=estimate.yaw)
        up = model.height if estimate.source is YawSource.TOP else 0.0
        voted = FitStart(pose, estimate.source, YawPrior(estimate.sigma, up), (*steps, estimate))
        if turned < np.radians(SMALL_TURN_DEG):
            break
    return voted


def measure_as_in_paper(shot: Shot, candidate: Candidate, config: LocalizerConfig) -> Fit | Refusal:
    """Measure a candidate as the paper states it: Hough's angle twice, then the sweep without a height prior.

    Parameters
    ----------
    shot : Shot
        The shot.
    candidate : Candidate
        Where a pallet may stand.
    config : LocalizerConfig
        Parameters.

    Returns
    -------
    Fit or Refusal
        The paper has no pose for a pallet level with the camera.
    """
    camera = shot.camera_in(candidate.start)
    hidden = out_of_sight(camera, config.farthest_start)
    if hidden is not None:
        return Refusal(candidate, Stage.START, hidden)
    model = candidate.model
    source = horizontal_source(model, camera, config.yaw)
    if source is YawSource.FACE:
        return Refusal(candidate, Stage.YAW, Reason.NO_LINE)
    pose = candidate.start
    views: tuple[object, ...] = ()
    lines: tuple[BoundaryLine, ...] = ()
    for _ in range(2):
        seen = view_horizontal(shot, pose, model, source, config.yaw)
        views = (*views, seen)
        line = nearest_line(find_lines(seen, config.yaw))
        if line is None:
            return Refusal(candidate, Stage.YAW, Reason.NO_LINE, None, (*views, *lines))
        lines = (line,)
        pose = replace(pose, yaw=wrap_angle(pose.yaw + line.turn))
    steps = (*views, *lines)
    swept = sweep(shot, pose, model, None, True, config.position)
    if isinstance(swept, Reason):
        return Refusal(candidate, Stage.POSITION, swept, None, steps)
    depth = swept.depth[swept.score >= NEAR_PEAK * swept.best]
    # one pixel of the edge image over the face's width is what the Hough transform resolves
    yaw_sigma = max(config.yaw.resolution / model.width, np.radians(config.yaw.hough_step_deg))
    covariance = _spread(
        shot, swept.peaks[0], float(np.ptp(depth)), config.position.sweep_resolution, float(yaw_sigma)
    )
    covariance += _second_moment([peak.as_array() for peak in swept.peaks], swept.agreement)
    scored = replace(candidate, score=swept.best)
    return _checked(shot, Fit(scored, swept.peaks[0], covariance, source, steps=(*steps, swept)), config)


def measure_jointly(shot: Shot, candidate: Candidate, config: LocalizerConfig) -> Fit | Refusal:
    """Measure a candidate by the joint search over yaw and distance.

    Parameters
    ----------
    shot : Shot
        The shot.
    candidate : Candidate
        Where a pallet may stand.
    config : LocalizerConfig
        Parameters.

    Returns
    -------
    Fit or Refusal
        With the joint search among its steps.
    """
    hidden = out_of_sight(shot.camera_in(candidate.start), config.farthest_start)
    if hidden is not None:
        return Refusal(candidate, Stage.START, hidden)
    found = search_jointly(shot, candidate.start, candidate.model, config.joint_search)
    if isinstance(found, Reason):
        return Refusal(candidate, Stage.POSITION, found)
    pose = found.forklift_from_pallet
    covariance = _second_moment(found.poses.reshape(-1, 4), found.score.ravel())
    step = float(found.turns[1] - found.turns[0]) / 2
    covariance += np.diag([*[config.joint_search.resolution**2] * 3, step**2])
    fit = Fit(replace(candidate, score=found.best), pose, covariance, YawSource.FACE, steps=(found,))
    return _checked(shot, fit, config)


def _second_moment(poses: ArrayLike, agreement: ArrayLike) -> FloatArray:
    """Return the (4, 4) second moment of hypotheses about the best one, each weighted by its agreement.

    One that agrees less by the part that `NEAR_PEAK` leaves weighs less by a factor e.
    """
    tried, score = np.asarray(poses, float), np.asarray(agreement, float)
    apart = tried - tried[score.argmax()]
    apart[:, 3] = wrap_angle(apart[:, 3])
    weight = np.exp((score / score.max() - 1) / (1 - NEAR_PEAK))
    return np.asarray((weight[:, None] * apart).T @ apart / weight.sum())


def _checked(shot: Shot, fit: Fit, config: LocalizerConfig) -> Fit | Refusal:
    """Refuse a pose on no level, one that shows no pallet at a glance, and one whose place is too uncertain."""
    candidate, model = fit.candidate, fit.candidate.model

    def given_up(reason: Reason) -> Refusal:
        return Refusal(candidate, Stage.VERIFICATION, reason, fit, fit.steps)

    height = candidate.height
    if height is not None:
        sigma = float(np.hypot(height.sigma, np.sqrt(fit.covariance[2, 2])))
        if abs(fit.pose.z - height.z) > MOST_OFF_LEVEL * sigma:
            return given_up(Reason.OFF_LEVEL)
    seen = next(_surroundings(shot, model, [fit.pose]), None)
    if seen is not None and not may_be_pallet(seen[1], fit.pose, candidate, config):
        return given_up(Reason.LOW_CONTRAST)
    # the joint search tells the yaw to degrees only: that is no reason to keep it back
    limits = replace(config.verification, max_yaw_sigma_deg=math.inf)
    return fit if of_use(fit.covariance, limits) else given_up(Reason.UNCERTAIN)


def _spread(shot: Shot, pose: LevelPose, depth_range: float, resolution: float, yaw_sigma: float) -> FloatArray:
    """Return the covariance of a pose that is uncertain along its viewing ray, by a pixel across it, and in yaw."""
    ray = np.array([pose.x, pose.y, pose.z]) - shot.mounting.center
    into = np.array([np.cos(pose.yaw), np.sin(pose.yaw), 0.0])
    along_ray = ray / max(float(ray @ into), 0.1) * max(depth_range / np.sqrt(12.0), resolution)
    covariance = np.zeros((4, 4))
    covariance[:3, :3] = np.outer(along_ray, along_ray) + resolution**2 * np.eye(3)
    covariance[3, 3] = yaw_sigma**2
    return covariance
