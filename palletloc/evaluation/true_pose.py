"""The true pose of a pallet in the forklift frame, from whatever source, with what it leaves uncertain."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

from palletloc.evaluation.errors import PlacedPallet
from palletloc.geometry import FloatArray, LevelPose, level_pose, wrap_angle
from palletloc.trajectory import Trajectory


@dataclass(frozen=True, slots=True, eq=False)
class TruePose:
    """Where a pallet truly is to the forklift."""

    id: str
    """Name of the pallet in the scene."""
    forklift_from_pallet: LevelPose
    """Its pose."""
    covariance: FloatArray = field(default_factory=lambda: np.zeros((4, 4)))
    """(4, 4) covariance of (x, y, z, yaw), in metres and radians; zero where the truth is exact."""

    @property
    def yaw_sigma(self) -> float:
        """Standard deviation of the yaw, in radians."""
        return math.sqrt(self.covariance[3, 3])

    def normalized_error(self, pose: LevelPose, covariance: FloatArray | None = None) -> FloatArray:
        """Return the error of a pose in standard deviations of both together.

        Parameters
        ----------
        pose : LevelPose
            A measured ``forklift_from_pallet``.
        covariance : (4, 4) array, optional
            Its own; None for an exact one.

        Returns
        -------
        (4,) array
            Of x, y, z and yaw.
        """
        both = self.covariance + (0.0 if covariance is None else covariance)
        return self.error(pose) / np.sqrt(np.diag(both))

    def nees(self, pose: LevelPose, covariance: FloatArray | None = None) -> float:
        """Return the squared error of a pose in units of both covariances: 4 on average where they are true."""
        both = self.covariance + (0.0 if covariance is None else covariance)
        error = self.error(pose)
        return float(error @ np.linalg.solve(both, error))

    def error(self, pose: LevelPose) -> FloatArray:
        """Return a pose minus the true one: (4,) of x, y, z and yaw, the yaw in [-pi, pi)."""
        error = pose.as_array() - self.forklift_from_pallet.as_array()
        error[3] = wrap_angle(float(error[3]))
        return error


def continuous_poses(
    world_from_forklift: Trajectory, pallets: Iterable[PlacedPallet], time: float
) -> tuple[TruePose, ...]:
    """Return the true poses at any time of a continuous truth, taken as exact.

    Parameters
    ----------
    world_from_forklift : Trajectory
        The forklift's true path.
    pallets : iterable of PlacedPallet
        Where the pallets stand.
    time : float
        In seconds.

    Returns
    -------
    tuple of TruePose
        In the pallets' order, without covariance.

    Raises
    ------
    TrajectoryError
        If the path does not cover the time.
    """
    forklift_from_world = world_from_forklift.pose_at(time).transform().inv()
    return tuple(
        TruePose(pallet.id, level_pose(forklift_from_world * pallet.world_from_pallet.transform()))
        for pallet in pallets
    )
