"""A start for the fit: where most targets agree that the camera is, and how each survey has to be read.

Each target's own pose in the image, with its survey, says where the camera is. Survey corners may be named for
a board that hangs upside down, or left and right may be swapped: every reading is tried.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np
from scipy.spatial.transform import RigidTransform

from calibration.bearing_dlt import pose_from_bearings, refine_pose
from calibration.network import Network, Poses, Sight, Survey
from palletloc.geometry import FloatArray


class Reading(StrEnum):
    """How the three surveyed corners of a target belong to its pattern."""

    AS_NAMED = "as_named"
    UPSIDE_DOWN = "upside_down"
    LEFT_RIGHT = "left_right_swapped"
    TOP_BOTTOM = "top_bottom_swapped"


_PROPER = (Reading.AS_NAMED, Reading.UPSIDE_DOWN)
_GATE, _SIGMAS, _FAR = 0.05, 5.0, 0.5


@dataclass(frozen=True, slots=True, eq=False)
class Consensus:
    """What most targets agree on."""

    network: Network
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


def read_as(survey: Survey, reading: Reading) -> Survey:
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


def agree(network: Network) -> Consensus | None:
    """Find where the camera is by a vote of the targets, then by a robust fit to what they say.

    Each target alone proposes a pose, and so do the linear equations for all of them together.

    Parameters
    ----------
    network : Network
        All observations.

    Returns
    -------
    Consensus, optional
        None where nothing proposes a pose.
    """
    proposals = _proposals(network)
    if not proposals:
        return None
    scores = [float(np.minimum(_misfits(network, pose).min(1), _FAR).sum()) for pose in proposals]
    camera = proposals[int(np.argmin(scores))]
    for _ in range(2):
        readings = tuple(_reading(row) for row in _misfits(network, camera))
        surveys = tuple(read_as(one, how) for one, how in zip(network.surveys, readings, strict=True))
        camera = _refined(replace(network, surveys=surveys), camera)
    network = replace(network, surveys=surveys)
    misfit = _misfits(network, camera)[:, 0]
    poses = Poses(camera, tuple(one.pose() for one in surveys))
    tolerance = _tolerance(network, poses)
    seen = own_poses(network.sights, len(surveys))
    boards = [
        camera * own if off and own is not None else pose
        for pose, own, off in zip(poses.boards, seen, misfit >= tolerance, strict=True)
    ]
    return Consensus(network, Poses(camera, tuple(boards)), readings, misfit, tolerance)


def _proposals(network: Network) -> list[RigidTransform]:
    """Return all that may be ``forklift_from_camera``."""
    proposals = []
    for survey, own in zip(network.surveys, own_poses(network.sights, len(network.surveys)), strict=True):
        if own is not None:
            proposals += [read_as(survey, reading).pose() * own.inv() for reading in _PROPER]
    found = pose_from_bearings(*_points_and_bearings(network)[:2]) if network.sights else None
    return proposals if found is None else [*proposals, found.inv()]


def _points_and_bearings(network: Network) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return all corners as surveyed, with their bearings, origins and standard deviations."""
    poses = [survey.pose() for survey in network.surveys]
    points = np.concatenate([poses[s.target].apply(s.points) for s in network.sights])
    names = ("bearings", "origins", "sigma")
    bearings, origins, sigma = (np.concatenate([getattr(s, name) for s in network.sights]) for name in names)
    return points, bearings, origins, sigma


def _refined(network: Network, camera: RigidTransform) -> RigidTransform:
    """Return the camera's pose by a robust fit to the corners as surveyed, each target within its tolerance."""
    points, bearings, origins, noise = _points_and_bearings(network)
    distance = np.linalg.norm(points - camera.translation, axis=-1)
    inexact = np.concatenate([np.full(len(s.points), network.surveys[s.target].sigma) for s in network.sights])
    sigma = np.hypot(np.maximum(inexact, 0.1 * _GATE) / distance, noise)
    return refine_pose(camera.inv(), points, bearings, origins, sigma).inv()


def _tolerance(network: Network, poses: Poses) -> FloatArray:
    tolerance = np.zeros(len(network.surveys))
    for sight in network.sights:
        survey = network.surveys[sight.target]
        distance = float(np.linalg.norm(survey.points[0] - poses.camera.translation))
        spread = np.hypot(survey.sigma, distance * float(np.median(sight.sigma)))
        tolerance[sight.target] = max(tolerance[sight.target], _GATE + _SIGMAS * spread)
    return tolerance


def own_poses(sights: Sequence[Sight], count: int) -> list[RigidTransform | None]:
    """Return ``camera_from_board`` of each target, from its own corners in the shot that shows most of them."""
    best: list[Sight | None] = [None] * count
    for sight in sights:
        known = best[sight.target]
        if known is None or len(sight.points) > len(known.points):
            best[sight.target] = sight
    return [None if sight is None else _own_pose(sight) for sight in best]


def _own_pose(sight: Sight) -> RigidTransform | None:
    pose = pose_from_bearings(sight.points, sight.bearings)
    if pose is None:
        return None
    start = RigidTransform.from_components(pose.translation + sight.origins.mean(0), pose.rotation)
    return refine_pose(start, sight.points, sight.bearings, sight.origins, sight.sigma)


def _misfits(network: Network, camera: RigidTransform) -> FloatArray:
    """Return how far off each target is across the line of sight, for each reading, (k, 4), in metres."""
    misfits = np.zeros((len(network.surveys), len(Reading)))
    for sight in network.sights:
        for i, reading in enumerate(Reading):
            pose = read_as(network.surveys[sight.target], reading).pose()
            rays = camera.inv().apply(pose.apply(sight.points)) - sight.origins
            off = rays - np.linalg.norm(rays, axis=-1, keepdims=True) * sight.bearings
            distance = float(np.sqrt((off**2).sum(-1).mean()))
            misfits[sight.target, i] = max(misfits[sight.target, i], distance)
    return misfits


def _reading(misfits: FloatArray) -> Reading:
    """Return the reading that fits; as named unless another is far better."""
    best = int(np.argmin(misfits))
    return tuple(Reading)[best if misfits[best] < 0.3 * misfits[0] else 0]
