"""A start for the fit: where most targets agree that the camera is, and how each survey has to be read.

Each target's own pose in the image, with its survey, says where the camera is. Its corners may be named for a
board that hangs upside down, or left and right may be swapped: every reading is tried.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np
from scipy.spatial.transform import RigidTransform

from calibration.bearings import pose_from_bearings, refine_pose
from calibration.mounting.problem import MountingProblem, Poses, SurveyedTarget
from calibration.targets.observations import CornerObservation
from palletloc.geometry import FloatArray


class Reading(StrEnum):
    """How the three surveyed corners of a target belong to its pattern."""

    AS_NAMED = "as_named"
    UPSIDE_DOWN = "upside_down"
    LEFT_RIGHT = "left_right_swapped"
    TOP_BOTTOM = "top_bottom_swapped"


_PROPER = (Reading.AS_NAMED, Reading.UPSIDE_DOWN)
"""Readings that a rotation can make; the others mirror the target."""
_GATE = 0.05
"""A target that is off by less does not yet contradict the others, in metres: starts are as good as that."""
_SIGMAS = 5.0
"""What is added to it for inexact surveys and bearings, in standard deviations."""
_FAR = 0.5
"""A target that is farther off counts no more in the vote, in metres."""
_BETTER = 0.3
"""Another reading than the named one has to be off by less than this part of it."""


@dataclass(frozen=True, slots=True, eq=False)
class SurveyConsensus:
    """What most targets agree on."""

    problem: MountingProblem
    """The observations, with the surveys as they have to be read."""
    poses: Poses
    """Start of the fit."""
    readings: tuple[Reading, ...]
    """Of each target."""
    misfit: FloatArray
    """(k,) distance across the line of sight between each target as surveyed and as seen, in metres."""
    tolerance: FloatArray
    """(k,) what is not yet a contradiction: some centimetres, more for inexact surveys and bearings."""

    @property
    def agrees(self) -> tuple[bool, ...]:
        """Whether each target is seen where it was surveyed, roughly."""
        return tuple((self.misfit < self.tolerance).tolist())


def read_as(survey: SurveyedTarget, reading: Reading) -> SurveyedTarget:
    """Return the survey with its corners named for another reading."""
    left, right, lower = survey.points
    fourth = right + lower - left
    match reading:
        case Reading.UPSIDE_DOWN:
            points = (fourth, lower, right)
        case Reading.LEFT_RIGHT:
            points = (right, left, fourth)
        case Reading.TOP_BOTTOM:
            points = (lower, fourth, left)
        case _:
            points = (left, right, lower)
    return replace(survey, points=np.array(points))


def agree(problem: MountingProblem) -> SurveyConsensus | None:
    """Find where the camera is by a vote of the targets, then by a robust fit to what they say.

    Each target alone proposes a pose, and so do the linear equations for all of them together; None where nothing
    proposes one.
    """
    proposals = _proposals(problem)
    if not proposals:
        return None
    scores = [float(np.minimum(_misfits(problem, pose).min(1), _FAR).sum()) for pose in proposals]
    camera = proposals[int(np.argmin(scores))]
    for _ in range(2):
        readings = tuple(_reading(row) for row in _misfits(problem, camera))
        surveys = tuple(read_as(survey, how) for survey, how in zip(problem.surveys, readings, strict=True))
        camera = _refined(replace(problem, surveys=surveys), camera)
    problem = replace(problem, surveys=surveys)
    misfit = _misfits(problem, camera)[:, 0]
    poses = Poses(camera, tuple(survey.pose() for survey in surveys))
    tolerance = _tolerance(problem, poses)
    seen = own_poses(problem.observations, len(surveys))
    boards = [
        camera * own if off and own is not None else pose
        for pose, own, off in zip(poses.boards, seen, misfit >= tolerance, strict=True)
    ]
    return SurveyConsensus(problem, Poses(camera, tuple(boards)), readings, misfit, tolerance)


def _proposals(problem: MountingProblem) -> list[RigidTransform]:
    """Return all that may be ``forklift_from_camera``."""
    proposals = []
    for survey, own in zip(problem.surveys, own_poses(problem.observations, len(problem.surveys)), strict=True):
        if own is not None:
            proposals += [read_as(survey, reading).pose() * own.inv() for reading in _PROPER]
    found = pose_from_bearings(*_points_and_bearings(problem)[:2]) if problem.observations else None
    return proposals if found is None else [*proposals, found.inv()]


def _points_and_bearings(problem: MountingProblem) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return all corners as surveyed, with their bearings, origins and standard deviations."""
    poses = [survey.pose() for survey in problem.surveys]
    points = np.concatenate([poses[s.target].apply(s.points) for s in problem.observations])
    names = ("bearings", "origins", "sigma")
    bearings, origins, sigma = (np.concatenate([getattr(s, name) for s in problem.observations]) for name in names)
    return points, bearings, origins, sigma


def _refined(problem: MountingProblem, camera: RigidTransform) -> RigidTransform:
    """Return the camera's pose by a robust fit to the corners as surveyed, each target within its tolerance."""
    points, bearings, origins, noise = _points_and_bearings(problem)
    distance = np.linalg.norm(points - camera.translation, axis=-1)
    inexact = np.concatenate([np.full(len(s.points), problem.surveys[s.target].sigma) for s in problem.observations])
    sigma = np.hypot(np.maximum(inexact, 0.1 * _GATE) / distance, noise)
    return refine_pose(camera.inv(), points, bearings, origins, sigma).inv()


def _tolerance(problem: MountingProblem, poses: Poses) -> FloatArray:
    tolerance = np.zeros(len(problem.surveys))
    for corners in problem.observations:
        survey = problem.surveys[corners.target]
        distance = float(np.linalg.norm(survey.points[0] - poses.camera.translation))
        spread = np.hypot(survey.sigma, distance * float(np.median(corners.sigma)))
        tolerance[corners.target] = max(tolerance[corners.target], _GATE + _SIGMAS * spread)
    return tolerance


def own_poses(observations: Sequence[CornerObservation], count: int) -> list[RigidTransform | None]:
    """Return ``camera_from_board`` of each target, from its own corners in the shot that shows most of them."""
    best: list[CornerObservation | None] = [None] * count
    for corners in observations:
        known = best[corners.target]
        if known is None or len(corners.points) > len(known.points):
            best[corners.target] = corners
    return [None if corners is None else _own_pose(corners) for corners in best]


def _own_pose(corners: CornerObservation) -> RigidTransform | None:
    pose = pose_from_bearings(corners.points, corners.bearings)
    if pose is None:
        return None
    start = RigidTransform.from_components(pose.translation + corners.origins.mean(0), pose.rotation)
    return refine_pose(start, corners.points, corners.bearings, corners.origins, corners.sigma)


def _misfits(problem: MountingProblem, camera: RigidTransform) -> FloatArray:
    """Return how far off each target is across the line of sight, for each reading, (k, 4), in metres."""
    misfits = np.zeros((len(problem.surveys), len(Reading)))
    for corners in problem.observations:
        for i, reading in enumerate(Reading):
            pose = read_as(problem.surveys[corners.target], reading).pose()
            rays = camera.inv().apply(pose.apply(corners.points)) - corners.origins
            off = rays - np.linalg.norm(rays, axis=-1, keepdims=True) * corners.bearings
            distance = float(np.sqrt((off**2).sum(-1).mean()))
            misfits[corners.target, i] = max(misfits[corners.target, i], distance)
    return misfits


def _reading(misfits: FloatArray) -> Reading:
    """Return the reading that fits; as named unless another is far better."""
    best = int(np.argmin(misfits))
    return tuple(Reading)[best if misfits[best] < _BETTER * misfits[0] else 0]
