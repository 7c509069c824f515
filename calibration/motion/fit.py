"""The mounting that a drive past targets tells, and which of its directions no such drive can tell."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from calibration.bearings import cross_matrices
from calibration.degeneracy import LIMITS
from calibration.least_squares import descend, error_factor, inverse_normal, redundancies, within_gate
from calibration.motion.problem import CAMERA_PRIOR, DELAY_PRIOR, MotionProblem, MotionState
from calibration.mounting.fit import LEAST_BEARING_SCALE
from calibration.mounting.problem import CAMERA
from palletloc.geometry import FloatArray

_NOTICED = np.array([0.001, 0.001, 0.001, *np.radians([0.03, 0.03, 0.03])])
"""Changes of the mounting that a drive notices at best, in metres and radians: smaller ones count as not seen."""
_SECOND_ORDER = np.array([0.0005, 0.0005, 0.0005, *np.radians([0.01, 0.01, 0.01])])
"""What a lost turn that is held at a wrong value does to the others, in metres and radians."""
_OPEN = 10.0
"""How far a stated mounting may be off along a lost direction, times 50 mm and 2 degrees."""
_BOARD_STEP, _POSE_STEP = (0.01, 0.01, 0.01, 0.005, 0.005, 0.005), (0.01, 0.01, 0.005)
"""Small steps of a target's pose and of the forklift's, in metres and radians: they scale the unknowns."""
_DIFFERENCE = 1e-6
"""Step of the derivatives, in metres and radians: far above rounding, far below any curvature."""


@dataclass(frozen=True, slots=True, eq=False)
class MotionFit:
    """What a drive tells."""

    problem: MotionProblem
    """The observations that it rests on."""
    state: MotionState
    """Values; along lost directions they are about as stated."""
    covariance: FloatArray
    """(6, 6) of the camera, in metres and radians; half a metre or 20 degrees along lost directions."""
    fault_sigma: FloatArray
    """(3,) standard deviations of wheel scale, yaw rate's bias and delay."""
    kernel: FloatArray
    """(6, j) directions that the motion loses, whatever the noise; columns."""

    @property
    def sigma(self) -> FloatArray:
        """(6,) standard deviations of the six numbers."""
        return np.sqrt(np.diag(self.covariance))

    def split(self) -> tuple[FloatArray, FloatArray]:
        """Return the known and the lost directions as columns, in units of `LIMITS`."""
        values, vectors = np.linalg.eigh(self.covariance / np.outer(LIMITS, LIMITS))
        return vectors[:, values <= 1], vectors[:, values > 1]


def fit_motion(problem: MotionProblem, start: MotionState) -> MotionFit:
    """Fit mounting, targets, way and the odometry's faults together.

    Parameters
    ----------
    problem : MotionProblem
        With scales of one.
    start : MotionState
        Rough values.

    Returns
    -------
    MotionFit
        With the scales that the residuals tell.
    """
    # What the motion cannot tell must not wander: far away, the equations bend the rest along.
    problem = replace(problem, held=lost_by_motion(problem, start))
    state = _descend(problem, start, "soft_l1")
    problem = _inliers(problem, state)
    state = _descend(problem, state, "linear")
    jacobian = _jacobian(problem, state)
    problem = _weighed(problem, state, jacobian)
    state = _descend(problem, state, "linear")
    jacobian = _jacobian(problem, state)
    covariance = inverse_normal(jacobian)
    kernel = problem.held
    camera = covariance[:CAMERA, :CAMERA]
    huge = LIMITS[:, None] * kernel * _OPEN
    faults = np.sqrt(np.diag(covariance)[CAMERA : CAMERA + 3])
    camera = camera + huge @ huge.T
    if kernel.shape[1] > 1:
        # A turn that is held at a wrong value bends the others in second order; a height does not.
        camera = camera + np.diag(_SECOND_ORDER**2)
    return MotionFit(problem, state, camera, faults, kernel)


def lost_by_motion(problem: MotionProblem, state: MotionState) -> FloatArray:
    """Return the directions of the mounting that commute with all motions, (6, j), in units of `LIMITS`.

    A turn and shift of the camera is not seen if it is the same before and after each motion of the forklift, for
    then the targets may have moved instead: ``(Ad(V) - 1) xi = 0``. Targets of known height may not.
    """
    x, y, yaw = (state.poses - state.poses[0]).T
    first = state.poses[0, 2]
    cos, sin = np.cos(yaw), np.sin(yaw)
    place = np.stack([np.cos(first) * x + np.sin(first) * y, np.cos(first) * y - np.sin(first) * x, 0 * x], axis=1)
    turn = np.zeros((len(x), 3, 3))
    turn[:, 0, 0], turn[:, 0, 1], turn[:, 1, 0], turn[:, 1, 1], turn[:, 2, 2] = cos, -sin, sin, cos, 1.0
    change = np.zeros((len(x), 6, 6))
    change[:, :3, :3], change[:, 3:, 3:] = turn, turn
    change[:, :3, 3:] = cross_matrices(place) @ turn
    change = (change - np.eye(6)) / _NOTICED[:, None] / np.sqrt(len(x))
    rows = [change.reshape(-1, 6)]
    for k, height in problem.heights.items():
        lever = _in_forklift(state.poses[0], state.boards[k][:3, 3])
        rows.append(np.array([[0.0, 0.0, 1.0, lever[1], -lever[0], 0.0]]) / max(height.sigma, _NOTICED[2]))
    # As steps of the camera: a turn about the forklift's origin carries the camera along.
    carried = np.eye(6)
    carried[:3, 3:] = cross_matrices(state.camera.translation)
    matrix = np.concatenate(rows) @ carried * LIMITS
    _, values, directions = np.linalg.svd(matrix)
    return np.asarray(directions[values < 1].T)


def _in_forklift(pose: FloatArray, point: FloatArray) -> FloatArray:
    x, y, yaw = pose
    across, along = point[0] - x, point[1] - y
    return np.array(
        [np.cos(yaw) * across + np.sin(yaw) * along, np.cos(yaw) * along - np.sin(yaw) * across, point[2]]
    )


def _descend(problem: MotionProblem, start: MotionState, loss: Literal["linear", "soft_l1"]) -> MotionState:
    faults = [problem.scale_sigma / 5, problem.noise.bias, DELAY_PRIOR / 5]
    poses = np.tile(_POSE_STEP, len(problem.times) - 1)
    scale = np.concatenate([CAMERA_PRIOR / 10, faults, poses, np.tile(_BOARD_STEP, problem.targets)])
    return descend(problem.residuals, start, scale, loss, evaluations=30)


def _jacobian(problem: MotionProblem, state: MotionState) -> FloatArray:
    steps = _DIFFERENCE * np.eye(problem.size)
    return np.stack(
        [
            (problem.residuals(state.moved(step)) - problem.residuals(state.moved(-step))) / (2 * _DIFFERENCE)
            for step in steps
        ],
        axis=1,
    )


def _inliers(problem: MotionProblem, state: MotionState) -> MotionProblem:
    """Return the problem without corners beyond four robust standard deviations."""
    good = within_gate(problem.residuals(state)[: problem.image_rows].reshape(-1, 2))
    ends = np.cumsum([len(corners.points) for corners in problem.observations])[:-1]
    parts = zip(problem.observations, np.split(good, ends), strict=True)
    return replace(problem, observations=tuple(corners.kept(chosen) for corners, chosen in parts))


def _weighed(problem: MotionProblem, state: MotionState, jacobian: FloatArray) -> MotionProblem:
    """Return the problem with the factors on standard deviations that the residuals tell."""
    squares = problem.residuals(state) ** 2
    left = redundancies(jacobian, inverse_normal(jacobian))
    split = problem.image_rows
    drive = slice(split, split + 3 * (len(problem.times) - 1))
    bearing = float(np.sqrt(squares[:split].sum() / left[:split].sum()))
    return replace(
        problem,
        bearing_scale=max(bearing, LEAST_BEARING_SCALE),
        drive_scale=error_factor(float(squares[drive].sum()), float(left[drive].sum())),
    )
