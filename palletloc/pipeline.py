"""The order of the steps: the paper's chain with lines to a fraction of a pixel."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np

from palletloc.attempts import keep_best
from palletloc.boundary import BoundaryLine
from palletloc.candidate import Candidate, ShotView
from palletloc.config import LocalizerConfig
from palletloc.geometry import FloatArray, LevelPose, wrap_angle
from palletloc.horizontal_view import horizontal_source, view_horizontal
from palletloc.measurement import Reason, Stage, YawSource
from palletloc.position import sweep
from palletloc.refinement.patch import MIN_DISTANCE, FacePatch, view_patch
from palletloc.yaw import find_lines, measure_line, measure_yaw

GLANCE_RESOLUTION = 0.006
"""Metres per pixel of the view that tells most places from a pallet at a glance."""
RANGE_SLACK = 1.2
"""How much farther than detections a given start may be."""
MARGIN = 0.08
"""What that view shows beyond the face, in metres."""


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

    def ready(attempt: Candidate, peak: LevelPose) -> LevelPose:
        return _voted_yaw(shot, attempt, source, peak, config)

    return keep_best(shot, candidate, _surroundings(shot, candidate, swept.peaks), ready, weak, config)


def _surroundings(
    shot: ShotView, candidate: Candidate, poses: Iterable[LevelPose]
) -> Iterator[tuple[LevelPose, FacePatch]]:
    """Yield poses with a view of each, where there is one."""
    half, high = candidate.model.width / 2 + MARGIN, candidate.model.height + MARGIN
    for pose in poses:
        patch = view_patch(
            shot.projector,
            shot.image,
            shot.camera_from_forklift,
            pose,
            (-half, half, -MARGIN, high),
            GLANCE_RESOLUTION,
        )
        if not isinstance(patch, Reason):
            yield pose, patch


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
