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
_GATE, _NEAR = 0.05, 0.5


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
    """(k,) distance between each target's corners as seen from the agreed pose and as surveyed, in metres."""

    @property
    def agrees(self) -> tuple[bool, ...]:
        """Whether each target is where it was surveyed, within centimetres."""
        return tuple(bool(distance < _GATE) for distance in self.misfit)


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
    """Find where the camera is by a vote of the targets, then by the linear equations for those that agree.

    Parameters
    ----------
    network : Network
        All observations.

    Returns
    -------
    Consensus, optional
        None where no target alone has a pose.
    """
    own = own_poses(network.sights, len(network.surveys))
    best, best_score, best_misfits = None, np.inf, np.zeros((0, 0))
    for k, camera_from_board in enumerate(own):
        for reading in _PROPER if camera_from_board is not None else ():
            pose = read_as(network.surveys[k], reading).pose() * _inverse(camera_from_board)
            misfits = _misfits(network.surveys, own, pose)
            score = float(np.minimum(misfits.min(1), _NEAR).sum())
            if score < best_score - 1e-9:
                best, best_score, best_misfits = pose, score, misfits
    if best is None:
        return None
    readings = tuple(_reading(row) for row in best_misfits)
    surveys = tuple(read_as(one, how) for one, how in zip(network.surveys, readings, strict=True))
    network = replace(network, surveys=surveys)
    camera = _linear(network, best, best_misfits.min(1))
    misfit = _misfits(surveys, own, camera)[:, 0]
    return Consensus(network, Poses(camera, tuple(one.pose() for one in surveys)), readings, misfit)


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


def _inverse(transform: RigidTransform | None) -> RigidTransform:
    return RigidTransform.identity() if transform is None else transform.inv()


def _misfits(surveys: Sequence[Survey], own: Sequence[RigidTransform | None], pose: RigidTransform) -> FloatArray:
    """Return the distances of the corners of each target for each reading, (k, 4), in metres."""
    misfits = np.full((len(surveys), len(Reading)), np.inf)
    for k, (survey, camera_from_board) in enumerate(zip(surveys, own, strict=True)):
        if camera_from_board is None:
            continue
        seen = (pose * camera_from_board).apply(survey.outline)
        for i, reading in enumerate(Reading):
            off = seen - read_as(survey, reading).points
            misfits[k, i] = np.sqrt((off**2).sum(-1).mean())
    return misfits


def _reading(misfits: FloatArray) -> Reading:
    """Return the reading that fits; as named unless another is far better."""
    best = int(np.argmin(misfits))
    return tuple(Reading)[best if misfits[best] < 0.3 * misfits[0] else 0]


def _linear(network: Network, voted: RigidTransform, misfit: FloatArray) -> RigidTransform:
    """Return the pose by the linear equations for the targets that agree, or the voted one where it is better."""
    sights = [sight for sight in network.sights if misfit[sight.target] < _NEAR]
    if not sights:
        return voted
    points = np.concatenate([network.surveys[s.target].pose().apply(s.points) for s in sights])
    bearings, origins = (np.concatenate([getattr(s, name) for s in sights]) for name in ("bearings", "origins"))
    found = pose_from_bearings(points, bearings)
    poses = [voted] if found is None else [voted, found.inv()]
    return min(poses, key=lambda pose: _median_angle(pose, points, bearings, origins))


def _median_angle(
    forklift_from_camera: RigidTransform, points: FloatArray, bearings: FloatArray, origins: FloatArray
) -> float:
    rays = forklift_from_camera.inv().apply(points) - origins
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    return float(np.median(np.linalg.norm(rays - bearings, axis=-1)))
