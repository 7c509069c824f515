"""Errors of measured poses: which pallets a shot should show, and which measurement belongs to which.

Poses are compared in the forklift frame at the time of the shot; how they were made plays no part.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Protocol, TypeVar

import numpy as np
from scipy.spatial.transform import RigidTransform

from palletloc.errors import PalletLocError, nearest_name
from palletloc.evaluation.estimate import EstimatedPallet
from palletloc.evaluation.normalised import nees
from palletloc.geometry import LevelPose, level_pose, wrap_angle
from palletloc.measurement import PalletMeasurement
from palletloc.trajectory import Trajectory

PAIRING_DISTANCE = 0.5
"""Farthest that a measurement may lie from the pallet it belongs to, in metres."""
SAME_TIME = 1e-3
"""Within which a measurement's time is a shot's, in seconds."""


_Estimate = TypeVar("_Estimate", bound=EstimatedPallet)


class EvaluationError(PalletLocError):
    """Truth and measurements that do not belong together; says which time or model, and what was expected."""


class PlacedPallet(Protocol):
    """A pallet whose true place is known."""

    @property
    def id(self) -> str:
        """Its name in the scene."""

    @property
    def model(self) -> str:
        """Name of its model."""

    @property
    def world_from_pallet(self) -> LevelPose:
        """Where it stands."""


@dataclass(frozen=True, slots=True)
class Sight:
    """Which true pallets count as visible in a shot: those a method can be blamed for missing."""

    max_range: float = 4.5
    """Farthest middle of the lower edge from the camera, in metres."""
    min_bearing_deg: float = 6.0
    """Least angle of the face's ends from the camera's forward axis, in degrees."""
    max_bearing_deg: float = 116.0
    """Largest such angle, in degrees."""


@dataclass(frozen=True, slots=True)
class TrueFace:
    """A true pallet as one shot should show it."""

    id: str
    """Its name in the scene."""
    model: str
    """Name of its model."""
    forklift_from_pallet: LevelPose
    """Its pose at the shot's time."""
    range: float
    """Distance of the camera from the middle of its lower edge, in metres."""
    below: float
    """Height of the camera above its lower edge, in metres; negative for a pallet above the camera."""
    visible: bool
    """Whether it has to be found."""


@dataclass(frozen=True, slots=True)
class PoseError:
    """How far a measurement is off; positions in the true pallet's axes."""

    face: TrueFace
    """The pallet."""
    depth: float
    """Into the pallet, in metres."""
    along: float
    """Along its front to the pallet's left, in metres."""
    height: float
    """Up, in metres."""
    yaw: float
    """In radians, -pi to pi."""
    nees: float
    """Squared error in the covariance's units: 4 on average where that is true, infinite where it is none."""
    same_model: bool
    """Whether the model is the right one."""


@dataclass(frozen=True, slots=True)
class ShotErrors:
    """One shot against the truth."""

    time: float
    """When it was exposed, in seconds."""
    errors: tuple[PoseError, ...]
    """Of the visible pallets that were found."""
    missed: tuple[TrueFace, ...]
    """The visible pallets that were not."""
    false: tuple[PalletMeasurement, ...]
    """Measurements that belong to no pallet."""
    camera_height: float
    """Of the camera in the forklift frame, in metres."""

    def between(self, low: float, high: float) -> ShotErrors:
        """Return only what lies at least ``low`` and less than ``high`` metres below the camera.

        Pallets count where they truly are, false measurements where they say.
        """
        return replace(
            self,
            errors=tuple(one for one in self.errors if low <= one.face.below < high),
            missed=tuple(face for face in self.missed if low <= face.below < high),
            false=tuple(one for one in self.false if low <= self.camera_height - one.forklift_from_pallet.z < high),
        )


def true_faces(
    pallets: Iterable[PlacedPallet],
    widths: Mapping[str, float],
    world_from_forklift: LevelPose,
    forklift_from_camera: RigidTransform,
    sight: Sight | None = None,
) -> list[TrueFace]:
    """Return every true pallet as it stands to the forklift, and whether the camera should show it.

    Parameters
    ----------
    pallets : iterable of PlacedPallet
        The truth.
    widths : mapping of str to float
        Width of each model's front face, in metres.
    world_from_forklift : LevelPose
        The forklift's true pose.
    forklift_from_camera : RigidTransform
        The camera's mounting.
    sight : Sight
        What counts as visible.

    Returns
    -------
    list of TrueFace
        In the given order.

    Raises
    ------
    EvaluationError
        If a pallet's model has no width.
    """
    forklift_from_world = world_from_forklift.transform().inv()
    faces = []
    for pallet in pallets:
        if pallet.model not in widths:
            hint = nearest_name(pallet.model, widths)
            raise EvaluationError(f"true pallet '{pallet.id}': unknown model '{pallet.model}'{hint}")
        pose = level_pose(forklift_from_world * pallet.world_from_pallet.transform())
        distance, visible = _seen(pose, widths[pallet.model], forklift_from_camera, sight or Sight())
        below = float(forklift_from_camera.translation[2]) - pose.z
        faces.append(TrueFace(pallet.id, pallet.model, pose, distance, below, visible))
    return faces


def _seen(pose: LevelPose, width: float, forklift_from_camera: RigidTransform, sight: Sight) -> tuple[float, bool]:
    """Return a face's range, and whether all of it lies on one side, within the bearings and the range."""
    edge = np.array([[0.0, side * width / 2, 0.0] for side in (-1, 0, 1)])
    points = forklift_from_camera.inv().apply(pose.transform().apply(edge))
    bearing = np.degrees(np.arctan2(points[:, 1], points[:, 0]))
    beside = np.copysign(1.0, bearing[1]) * bearing
    distance = float(np.linalg.norm(points[1]))
    within = beside.min() > sight.min_bearing_deg and beside.max() < sight.max_bearing_deg
    return distance, bool(within and distance <= sight.max_range)


def pair(measured: Sequence[EstimatedPallet], faces: Sequence[TrueFace]) -> list[tuple[int, int]]:
    """Give each measurement the pallet that it belongs to, and no pallet two of them; the closest go first.

    Parameters
    ----------
    measured : sequence of EstimatedPallet
        Of one shot, like `PalletMeasurement`.
    faces : sequence of TrueFace
        Of the same shot, visible or not.

    Returns
    -------
    list of (int, int)
        Indices of a measurement and its face, closest first, none farther apart than `PAIRING_DISTANCE`.
    """
    if not measured or not faces:
        return []
    found, true = (
        np.array([one.forklift_from_pallet.as_array()[:3] for one in group]) for group in (measured, faces)
    )
    apart = np.linalg.norm(found[:, None] - true, axis=2)
    pairs = []
    for _ in range(min(apart.shape)):
        row, column = (int(index) for index in np.unravel_index(int(apart.argmin()), apart.shape))
        if not apart[row, column] < PAIRING_DISTANCE:
            break
        pairs.append((row, column))
        apart[row, :] = apart[:, column] = np.inf
    return pairs


def pose_error(measured: EstimatedPallet, face: TrueFace) -> PoseError:
    """Compare a measurement with the pallet that it belongs to.

    Parameters
    ----------
    measured : EstimatedPallet
        With its covariance, like `PalletMeasurement`.
    face : TrueFace
        The truth.

    Returns
    -------
    PoseError
        Measured minus true.
    """
    true = face.forklift_from_pallet
    error = measured.forklift_from_pallet.as_array() - true.as_array()
    error[3] = wrap_angle(float(error[3]))
    cos, sin = math.cos(true.yaw), math.sin(true.yaw)
    return PoseError(
        face,
        depth=float(cos * error[0] + sin * error[1]),
        along=float(cos * error[1] - sin * error[0]),
        height=float(error[2]),
        yaw=float(error[3]),
        nees=nees(error, measured.covariance),
        same_model=measured.model == face.model,
    )


def shot_errors(
    time: float, measured: Sequence[PalletMeasurement], faces: Sequence[TrueFace], camera_height: float
) -> ShotErrors:
    """Compare the measurements of one shot with the truth.

    A measurement of a pallet that need not be found is neither counted nor held against the method.

    Parameters
    ----------
    time : float
        The shot's, in seconds.
    measured : sequence of PalletMeasurement
        What was found in it.
    faces : sequence of TrueFace
        Every pallet there is.
    camera_height : float
        Of the camera in the forklift frame, in metres.

    Returns
    -------
    ShotErrors
        Errors in the order of the faces.
    """
    pairs = pair(measured, faces)
    found = {column: measured[row] for row, column in pairs}
    used = {row for row, _ in pairs}
    visible = [column for column, face in enumerate(faces) if face.visible]
    return ShotErrors(
        time,
        tuple(pose_error(found[column], faces[column]) for column in visible if column in found),
        tuple(faces[column] for column in visible if column not in found),
        tuple(one for row, one in enumerate(measured) if row not in used),
        camera_height,
    )


def by_shot(times: Sequence[float], measured: Iterable[_Estimate]) -> list[list[_Estimate]]:
    """Return the measurements of each shot; ``times`` are the shots', in seconds.

    Raises
    ------
    EvaluationError
        If a measurement's time is no shot's.
    """
    shots: list[list[_Estimate]] = [[] for _ in times]
    moments = np.array(times)
    for one in measured:
        nearest = int(np.abs(moments - one.time).argmin())
        if abs(times[nearest] - one.time) > SAME_TIME:
            raise EvaluationError(
                f"a measurement at {one.time:.6g} s is of no shot; the nearest is {times[nearest]:.6g} s"
            )
        shots[nearest].append(one)
    return shots


def recording_errors(
    times: Sequence[float],
    measured: Iterable[PalletMeasurement],
    pallets: Sequence[PlacedPallet],
    widths: Mapping[str, float],
    world_from_forklift: Trajectory,
    forklift_from_camera: RigidTransform,
    sight: Sight | None = None,
) -> list[ShotErrors]:
    """Compare the measurements of a recording with the truth, shot by shot.

    Parameters
    ----------
    times : sequence of float
        Of every shot, in seconds: one without a measurement counts, too.
    measured : iterable of PalletMeasurement
        In any order.
    pallets, widths, forklift_from_camera, sight
        As for `true_faces`.
    world_from_forklift : Trajectory
        The forklift's true path.

    Returns
    -------
    list of ShotErrors
        One for each time, in order.

    Raises
    ------
    EvaluationError
        If a measurement's time is no shot's, or a pallet's model has no width.
    TrajectoryError
        If the true path does not cover a shot.
    """
    height = float(forklift_from_camera.translation[2])
    return [
        shot_errors(
            time,
            found,
            true_faces(pallets, widths, world_from_forklift.pose_at(time), forklift_from_camera, sight),
            height,
        )
        for time, found in zip(times, by_shot(times, measured), strict=True)
    ]
