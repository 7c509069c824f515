"""The methods to compare with: the paper's chain as it is written, and the joint search before it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from palletloc.candidate import Candidate, ShotView
from palletloc.config import LocalizerConfig
from palletloc.geometry import FloatArray, LevelPose, wrap_angle
from palletloc.horizontal_view import view_horizontal
from palletloc.joint_search import search_jointly
from palletloc.measurement import Reason, Stage, YawSource
from palletloc.pipeline import horizontal_plane_for, nearest_line, out_of_sight
from palletloc.position import sweep
from palletloc.yaw import find_lines

NEAR_PEAK = 0.95
"""Hypotheses that score this part of the best one are taken for as good: the spread of the covariance."""


def measure_as_in_paper(shot: ShotView, candidate: Candidate, config: LocalizerConfig) -> None:
    """Measure a candidate as the paper states it: Hough's angle twice, then the sweep without a height prior.

    Parameters
    ----------
    shot : ShotView
        The shot.
    candidate : Candidate
        Gets the results, or its refusal; the paper has none for a pallet level with the camera.
    config : LocalizerConfig
        Parameters.
    """
    hidden = out_of_sight(shot, candidate, config)
    if hidden is not None:
        return candidate.refuse(Stage.START, hidden)
    source = horizontal_plane_for(shot, candidate, config)
    if source is YawSource.FACE:
        return candidate.refuse(Stage.YAW, Reason.NO_LINE)
    pose = candidate.start
    for _ in range(2):
        seen = view_horizontal(
            shot.projector, shot.image, shot.camera_from_forklift, pose, candidate.model, source, config.yaw
        )
        candidate.horizontal.append(seen)
        line = nearest_line(find_lines(seen, config.yaw))
        if line is None:
            return candidate.refuse(Stage.YAW, Reason.NO_LINE)
        candidate.lines = [line]
        pose = replace(pose, yaw=wrap_angle(pose.yaw + line.turn))
    swept = sweep(
        shot.projector,
        shot.image,
        shot.camera_from_forklift,
        pose,
        candidate.model,
        None,
        True,
        config.position,
    )
    if isinstance(swept, Reason):
        return candidate.refuse(Stage.POSITION, swept)
    candidate.sweep, candidate.pose, candidate.yaw_from = swept, swept.peaks[0], source
    candidate.score = swept.best
    depth = swept.depth[swept.score >= NEAR_PEAK * swept.best]
    # one pixel of the edge image over the face's width is what the Hough transform resolves
    yaw_sigma = max(config.yaw.resolution / candidate.model.width, np.radians(config.yaw.hough_step_deg))
    candidate.covariance = _spread(
        shot, candidate.pose, float(np.ptp(depth)), config.position.sweep_resolution, float(yaw_sigma)
    )
    return None


def measure_jointly(shot: ShotView, candidate: Candidate, config: LocalizerConfig) -> None:
    """Measure a candidate by the joint search over yaw and distance.

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
    found = search_jointly(
        shot.projector,
        shot.image,
        shot.camera_from_forklift,
        candidate.start,
        candidate.model,
        config.joint_search,
    )
    if isinstance(found, Reason):
        return candidate.refuse(Stage.POSITION, found)
    candidate.joint, candidate.pose, candidate.score = found, found.forklift_from_pallet, found.best
    good = found.score >= NEAR_PEAK * found.best
    turns, depths = found.turns[good.any(axis=1)], found.depths[good.any(axis=0)]
    yaw_sigma = max(float(np.ptp(turns)) / np.sqrt(12.0), float(found.turns[1] - found.turns[0]) / 2)
    candidate.covariance = _spread(
        shot, candidate.pose, float(np.ptp(depths)), config.joint_search.resolution, yaw_sigma
    )
    return None


def _spread(shot: ShotView, pose: LevelPose, depth_range: float, resolution: float, yaw_sigma: float) -> FloatArray:
    """Return the covariance of a pose that is uncertain along its viewing ray, by a pixel across it, and in yaw."""
    ray = np.array([pose.x, pose.y, pose.z]) - shot.mounting.center
    into = np.array([np.cos(pose.yaw), np.sin(pose.yaw), 0.0])
    along_ray = ray / max(float(ray @ into), 0.1) * max(depth_range / np.sqrt(12.0), resolution)
    covariance = np.zeros((4, 4))
    covariance[:3, :3] = np.outer(along_ray, along_ray) + resolution**2 * np.eye(3)
    covariance[3, 3] = yaw_sigma**2
    return covariance
