"""A drive past targets as one least-squares problem: mounting, targets, the way, and odometry's faults."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from calibration.bearings import tangent_axes
from calibration.degeneracy import LIMITS
from calibration.drive import Drive, DriveNoise, relative
from calibration.mounting.problem import CAMERA
from calibration.targets.observations import CornerObservation
from palletloc.geometry import FloatArray, wrap_angle
from palletloc.trajectory import Trajectory

_FAULTS = 3
"""Faults of the odometry: scale, bias of the yaw rate, time offset."""
SCALE_PRIOR, DELAY_PRIOR = 0.05, 0.2
"""How far wheel scale and time offset may be off, one standard deviation; relative, and in seconds."""
_SMOOTH = 0.5
"""Rates of the odometry are taken over this time to either side, in seconds: shorter, their noise tells the delay."""
_HOLD = 0.02
"""How firmly lost directions stay as stated, in units of `LIMITS`: far more than noise moves them."""
CAMERA_PRIOR = np.array([0.5, 0.5, 0.5, *np.radians([20.0, 20.0, 20.0])])
"""How far the stated mounting may be off, in metres and radians: wide, only to keep the equations solvable."""


@dataclass(frozen=True, slots=True)
class Height:
    """How high the upper left corner of a target's pattern hangs."""

    above_floor: float
    """In metres."""
    sigma: float
    """Its standard deviation, in metres."""


@dataclass(frozen=True, slots=True, eq=False)
class _CornerRows:
    """Corners of all observations, one after the other."""

    shot: NDArray[np.intp]
    """(m,) which shot."""
    target: NDArray[np.intp]
    """(m,) which target."""
    points: FloatArray
    """(m, 3) in the board frame."""
    origins: FloatArray
    """(m, 3) where the bearings start, in the camera frame."""
    across: FloatArray
    """(m, 2, 3) unit vectors across the bearings, over their standard deviations."""


def _joined(observations: tuple[CornerObservation, ...], shot_of: tuple[int, ...]) -> _CornerRows:
    counts = [len(corners.points) for corners in observations]
    sigma = np.concatenate([corners.sigma for corners in observations])
    return _CornerRows(
        np.repeat(np.array(shot_of, np.intp), counts),
        np.repeat(np.array([corners.target for corners in observations], np.intp), counts),
        np.concatenate([corners.points for corners in observations]),
        np.concatenate([corners.origins for corners in observations]),
        tangent_axes(np.concatenate([corners.bearings for corners in observations])) / sigma[:, None, None],
    )


def odometry_at(path: Trajectory, times: FloatArray) -> FloatArray:
    """Return x, y and yaw at any times, (n, 3); beyond the ends the motion goes on."""
    inside = np.clip(times, *path.span)
    ends = np.where(times > inside, path.times[-1] - _SMOOTH, path.times[0])
    columns = []
    for values in (path.x, path.y, path.yaw):
        rate = (np.interp(ends + _SMOOTH, path.times, values) - np.interp(ends, path.times, values)) / _SMOOTH
        columns.append(np.interp(inside, path.times, values) + rate * (times - inside))
    return np.stack(columns, axis=1)


@dataclass(frozen=True, slots=True, eq=False)
class MotionProblem:
    """All observations of one drive."""

    times: FloatArray
    """(n,) of the shots, increasing, by the camera's clock, in seconds."""
    odometry: Trajectory
    """``odom_from_forklift`` by its own clock."""
    noise: DriveNoise
    """How far the odometry may be off."""
    observations: tuple[CornerObservation, ...]
    """Of targets in shots."""
    shot_of: tuple[int, ...]
    """Which shot each of them is from."""
    targets: int
    """How many targets there are."""
    stated: RigidTransform
    """The mounting as it is stated."""
    heights: Mapping[int, Height] = field(default_factory=dict)
    """Of targets whose height is known."""
    bearing_scale: float = 1.0
    """Factor on the bearings' standard deviations."""
    drive_scale: float = 1.0
    """Factor on those of the odometry's increments."""
    lag: float = 0.0
    """A delay near which the true one is, in seconds."""
    scale_sigma: float = SCALE_PRIOR
    """How far the wheels' scale may be off from one, one standard deviation."""
    held: FloatArray = field(default_factory=lambda: np.zeros((CAMERA, 0)))
    """(6, j) directions of the mounting, in units of `LIMITS`, that stay about as stated."""
    rows: _CornerRows = field(init=False)
    """The corners of all observations."""

    def __post_init__(self) -> None:
        """Join the observations."""
        object.__setattr__(self, "rows", _joined(self.observations, self.shot_of))

    @property
    def size(self) -> int:
        """How many unknowns there are."""
        return CAMERA * (1 + self.targets) + _FAULTS + 3 * (len(self.times) - 1)

    @property
    def image_rows(self) -> int:
        """How many residuals belong to bearings; they come first."""
        return 2 * sum(len(corners.points) for corners in self.observations)

    def steps(self, delay: float) -> FloatArray:
        """Return the odometry's increments between shots, (n - 1, 3), if its clock is late by a delay in seconds."""
        poses = self.way(delay)
        return relative(poses[:-1], poses[1:])

    def way(self, delay: float | None = None) -> FloatArray:
        """Return the poses at the shots as the odometry has them, (n, 3): x, y, yaw.

        Around `lag` the way changes with smoothed rates: the odometry's noise must not tell the delay.
        """
        later = 0.0 if delay is None else delay - self.lag
        at = self.times + self.lag
        before, now, after = (odometry_at(self.odometry, at + shift) for shift in (-_SMOOTH, 0.0, _SMOOTH))
        return now + (after - before) / (2 * _SMOOTH) * later

    def residuals(self, state: MotionState) -> FloatArray:
        """Return the residuals in standard deviations: bearings, increments, heights, priors."""
        return np.concatenate(
            [self._bearings(state).ravel(), self.slips(state).ravel(), self._heights(state), self._priors(state)]
        )

    def _bearings(self, state: MotionState) -> FloatArray:
        pose, board = state.poses[self.rows.shot], state.boards[self.rows.target]
        x, y, z = (np.einsum("nij,nj->ni", board[:, :3, :3], self.rows.points) + board[:, :3, 3]).T
        x, y, cos, sin = x - pose[:, 0], y - pose[:, 1], np.cos(pose[:, 2]), np.sin(pose[:, 2])
        local = np.stack([cos * x + sin * y, cos * y - sin * x, z], axis=1)
        camera = state.camera.as_matrix()
        rays = (local - camera[:3, 3]) @ camera[:3, :3] - self.rows.origins
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        return np.asarray(np.einsum("nij,nj->ni", self.rows.across, rays)) / self.bearing_scale

    def slips(self, state: MotionState) -> FloatArray:
        """Return how the way differs from the corrected increments, (n - 1, 3), in standard deviations."""
        drive = Drive(
            self.odometry.pose_at(self.odometry.span[0]), self.steps(state.delay), np.diff(self.times), self.noise
        )
        off = relative(state.poses[:-1], state.poses[1:]) - drive.corrected(state.scale, state.bias)
        off[:, 2] = wrap_angle(off[:, 2])
        return off / (self.drive_scale * drive.sigma)

    def _heights(self, state: MotionState) -> FloatArray:
        return np.array(
            [(state.boards[k][2, 3] - height.above_floor) / height.sigma for k, height in self.heights.items()]
        )

    def _priors(self, state: MotionState) -> FloatArray:
        faults = [
            (state.scale - 1) / self.scale_sigma,
            state.bias / self.noise.bias,
            (state.delay - self.lag) / DELAY_PRIOR,
        ]
        moved = state.camera.translation - self.stated.translation
        turned = (state.camera.rotation * self.stated.rotation.inv()).as_rotvec()
        away = np.concatenate([moved, turned])
        return np.concatenate([faults, away / CAMERA_PRIOR, self.held.T @ (away / LIMITS) / _HOLD])


@dataclass(frozen=True, slots=True, eq=False)
class MotionState:
    """Values of the unknowns."""

    camera: RigidTransform
    """``forklift_from_camera``."""
    boards: FloatArray
    """(k, 4, 4) ``odom_from_board`` of each target."""
    poses: FloatArray
    """(n, 3) ``odom_from_forklift`` at the shots; the first is held."""
    scale: float = 1.0
    """True distance over the odometry's."""
    bias: float = 0.0
    """What its yaw rate has too much, in radians per second."""
    delay: float = 0.0
    """What the odometry's clock shows more than the camera's for the same moment, in seconds."""

    def moved(self, step: FloatArray) -> MotionState:
        """Return the state after a step: camera, faults, poses but the first, targets."""
        ends = np.cumsum([CAMERA, _FAULTS, 3 * (len(self.poses) - 1)])
        camera, faults, poses, boards = np.split(step, ends)
        by = boards.reshape(-1, CAMERA)
        matrices = self.boards.copy()
        matrices[:, :3, :3] = Rotation.from_rotvec(by[:, 3:]).as_matrix() @ matrices[:, :3, :3]
        matrices[:, :3, 3] += by[:, :3]
        rotation = Rotation.from_rotvec(camera[3:]) * self.camera.rotation
        return replace(
            self,
            camera=RigidTransform.from_components(self.camera.translation + camera[:3], rotation),
            boards=matrices,
            poses=self.poses + np.concatenate([np.zeros((1, 3)), poses.reshape(-1, 3)]),
            scale=self.scale + float(faults[0]),
            bias=self.bias + float(faults[1]),
            delay=self.delay + float(faults[2]),
        )
