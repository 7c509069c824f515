"""The error of a measured pose: what was measured, what is true, and how sure both are.

Poses are compared in the forklift frame at the time of the shot; how they were made plays no part.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy.spatial.transform import RigidTransform

from palletloc.choices import MAX_RANGE
from palletloc.errors import PalletLocError, nearest_name
from palletloc.evaluation.statistics import nees, normalised
from palletloc.geometry import FloatArray, LevelPose, level_pose
from palletloc.measurement import PalletMeasurement

COMPONENTS = ("depth", "along", "height", "yaw")
"""Of an error in the true pallet's axes, in the order of all arrays: three in metres, one in radians."""


class EvaluationError(PalletLocError):
    """Truth and measurements that do not belong together; names the time or the model, and what was expected."""


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
class Visibility:
    """Which true pallets count as visible in a shot: those a method can be blamed for missing."""

    max_range: float = MAX_RANGE
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


def true_faces(
    pallets: Iterable[PlacedPallet],
    widths: Mapping[str, float],
    world_from_forklift: LevelPose,
    forklift_from_camera: RigidTransform,
    visibility: Visibility | None = None,
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
    visibility : Visibility
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
        distance, visible = _seen(pose, widths[pallet.model], forklift_from_camera, visibility or Visibility())
        below = float(forklift_from_camera.translation[2]) - pose.z
        faces.append(TrueFace(pallet.id, pallet.model, pose, distance, below, visible))
    return faces


def _seen(
    pose: LevelPose, width: float, forklift_from_camera: RigidTransform, visibility: Visibility
) -> tuple[float, bool]:
    """Return a face's range, and whether all of it lies on one side, within the bearings and the range."""
    edge = np.array([[0.0, side * width / 2, 0.0] for side in (-1, 0, 1)])
    points = forklift_from_camera.inv().apply(pose.transform().apply(edge))
    bearing = np.degrees(np.arctan2(points[:, 1], points[:, 0]))
    turned = np.copysign(1.0, bearing[1]) * bearing
    distance = float(np.linalg.norm(points[1]))
    within = turned.min() > visibility.min_bearing_deg and turned.max() < visibility.max_bearing_deg
    return distance, bool(within and distance <= visibility.max_range)


@dataclass(frozen=True, slots=True, eq=False)
class PalletEstimate:
    """A row of measurements.csv or tracks.csv, as far as the evaluation needs it."""

    time: float
    """When it holds, in seconds."""
    model: str
    """Name of the pallet model."""
    forklift_from_pallet: LevelPose
    """The pallet's pose at that time."""
    covariance: FloatArray
    """(4, 4) covariance of (x, y, z, yaw) in the forklift frame, in metres and radians."""
    track: str = ""
    """Name of the track; empty for a single shot."""
    state: str = ""
    """State of the track; empty for a single shot."""
    file: str = ""
    """The shot's image; empty where it is not known."""


def from_measurements(measurements: Iterable[PalletMeasurement]) -> list[PalletEstimate]:
    """Return single-shot measurements as estimates, in their order."""
    return [
        PalletEstimate(
            measured.time, measured.model, measured.forklift_from_pallet, measured.covariance, file=measured.file
        )
        for measured in measurements
    ]


@dataclass(frozen=True, slots=True, eq=False)
class PoseError:
    """An estimate minus the pallet that it belongs to, in the true pallet's axes."""

    time: float
    """The shot's, in seconds: the same for all runs of a recording."""
    estimate: PalletEstimate
    """The estimate."""
    face: TrueFace
    """The pallet."""
    offset: FloatArray
    """(4,) errors of depth, along and height in metres, and of yaw in radians, -pi to pi."""
    nees: float
    """Squared error in units of the estimate's covariance alone, as if the truth were exact: 4 on average where the
    covariance is true, infinite where it is none."""
    estimate_covariance: FloatArray
    """(4, 4) that the estimate states of depth, along, height and yaw."""
    truth_covariance: FloatArray | None
    """(4, 4) that the truth states of the same; None where the truth states none."""

    @property
    def depth(self) -> float:
        """Into the pallet, in metres."""
        return float(self.offset[0])

    @property
    def along(self) -> float:
        """Along its front to the pallet's left, in metres."""
        return float(self.offset[1])

    @property
    def height(self) -> float:
        """Up, in metres."""
        return float(self.offset[2])

    @property
    def yaw(self) -> float:
        """In radians, -pi to pi."""
        return float(self.offset[3])

    @property
    def same_model(self) -> bool:
        """Whether the estimate's model is the right one."""
        return self.estimate.model == self.face.model

    @property
    def covariance(self) -> FloatArray:
        """(4, 4) covariance of the offset: the estimate's, with the truth's where there is one."""
        if self.truth_covariance is None:
            return self.estimate_covariance
        return self.estimate_covariance + self.truth_covariance

    @property
    def normalised(self) -> FloatArray:
        """(4,) errors in units of their standard deviation, the truth's included."""
        return normalised(self.offset, np.diag(self.covariance))

    @property
    def nees_with_truth(self) -> float:
        """The same in units of the sum of both covariances; `nees` where the truth states none."""
        return nees(self.offset, self.covariance)


def pose_error(
    time: float, estimate: PalletEstimate, face: TrueFace, truth_covariance: FloatArray | None = None
) -> PoseError:
    """Compare an estimate with the pallet that it belongs to.

    Parameters
    ----------
    time : float
        The shot's, in seconds.
    estimate : PalletEstimate
        With its covariance.
    face : TrueFace
        The truth.
    truth_covariance : (4, 4) array, optional
        Of the true (x, y, z, yaw) in the forklift frame, in metres and radians; the errors of truth and
        estimate are taken as independent.

    Returns
    -------
    PoseError
        In the true pallet's axes.
    """
    true = face.forklift_from_pallet
    error = estimate.forklift_from_pallet.minus(true)
    cos, sin = math.cos(true.yaw), math.sin(true.yaw)
    turn = _pallet_from_forklift(true.yaw)
    return PoseError(
        time,
        estimate,
        face,
        np.array([cos * error[0] + sin * error[1], cos * error[1] - sin * error[0], error[2], error[3]]),
        nees(error, estimate.covariance),
        turn @ estimate.covariance @ turn.T,
        None if truth_covariance is None else turn @ truth_covariance @ turn.T,
    )


def _pallet_from_forklift(yaw: float) -> FloatArray:
    """Return the (4, 4) rotation of a difference (x, y, z, yaw) into the axes of a pallet with that yaw."""
    cos, sin = np.cos(yaw), np.sin(yaw)
    return np.array([[cos, sin, 0, 0], [-sin, cos, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])


def squared_errors(errors: Sequence[PoseError]) -> FloatArray:
    """Return (n,) `PoseError.nees_with_truth`; NaN where an estimate states no usable covariance."""
    squares = np.array([error.nees_with_truth for error in errors], dtype=np.float64)
    return np.where(np.isfinite(squares), squares, np.nan)


def offsets(errors: Sequence[PoseError]) -> FloatArray:
    """Return the (n, 4) errors of depth, along and height in metres, and of yaw in radians."""
    return np.array([error.offset for error in errors]).reshape(-1, 4)
