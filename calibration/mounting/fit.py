"""The camera's pose on the forklift from surveyed targets, with the covariance of all six numbers."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from scipy.spatial.transform import Rotation

from calibration.bearings import cross_matrices
from calibration.least_squares import descend, error_factor, inverse_normal, redundancies, within_gate
from calibration.mounting.problem import CAMERA, MountingProblem, Poses
from palletloc.geometry import BoolArray, FloatArray
from palletloc.mounting import Mounting

LEAST_BEARING_SCALE = 0.5
"""Factor that bearings' standard deviations are not divided below: few corners scatter little by chance."""
_ROUNDS = 3
"""How often bearings and survey are weighed anew by what their residuals tell; each round is one linear fit."""
_LEAST_REDUNDANCY = 20.0
"""With fewer redundant bearings their scatter tells nothing: its own error would be beyond 15 %."""
_STEP = np.array([0.001, 0.001, 0.001, 0.0005, 0.0005, 0.0005])
"""A small step of a pose, in metres and radians: it scales the unknowns."""


@dataclass(frozen=True, slots=True, eq=False)
class MountingFit:
    """A solution of the problem."""

    problem: MountingProblem
    """The observations that it rests on, with the scales that their residuals tell."""
    poses: Poses
    """The camera's pose and those of the targets."""
    full_covariance: FloatArray
    """(6 + 6 k, 6 + 6 k) of all unknowns, in metres and radians."""
    kept: tuple[BoolArray, ...]
    """Of each observation the corners that were used."""
    bearing_factor: float
    """How much larger bearings' errors are than stated."""
    survey_factor: float
    """How much larger the survey's errors are than stated."""
    frame_covariance: FloatArray = field(default_factory=lambda: np.zeros((CAMERA, CAMERA)))
    """(6, 6) what an error of the forklift frame adds to the camera's."""

    def with_frame_errors(self, covariance: FloatArray) -> MountingFit:
        """Return the solution with what an independent error of the forklift frame adds, (6, 6)."""
        return replace(self, frame_covariance=covariance)

    @property
    def covariance(self) -> FloatArray:
        """(6, 6) of the camera's translation and rotation, along and about the forklift's axes."""
        return self.full_covariance[:CAMERA, :CAMERA] + self.frame_covariance

    @property
    def sigma(self) -> FloatArray:
        """(6,) standard deviations: three translations in metres, three rotations in radians."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def correlation(self) -> FloatArray:
        """(6, 6) correlations."""
        return self.covariance / np.outer(self.sigma, self.sigma)

    @property
    def mounting(self) -> Mounting:
        """The pose as the localization takes it."""
        x, y, z, roll, pitch, yaw = (float(value) for value in self.sigma)
        return Mounting(self.poses.camera, (x, y, z), (roll, pitch, yaw))


def fit_mounting(problem: MountingProblem, start: Poses) -> MountingFit:
    """Fit camera and targets to all observations.

    A robust fit comes first. Corners that contradict it are left out; a linear fit of the rest follows, in
    which the two kinds of observations are weighed by what their own residuals tell.

    Parameters
    ----------
    problem : MountingProblem
        The observations, with scales of one.
    start : Poses
        Rough values.

    Raises
    ------
    numpy.linalg.LinAlgError
        If the observations leave a direction entirely free.
    """
    poses = _fit(problem, start, "soft_l1")
    good = within_gate(problem.residuals(poses)[: problem.image_rows].reshape(-1, 2))
    kept = tuple(np.split(good, np.cumsum([len(seen.points) for seen in problem.observations])[:-1]))
    problem = problem.kept(kept)
    bearing_factor = survey_factor = 1.0
    for _ in range(_ROUNDS):
        poses = _fit(problem, poses, "linear")
        jacobian = problem.jacobian(poses)
        inverse = inverse_normal(jacobian)
        bearing_factor, survey_factor = _factors(problem, poses, jacobian, inverse)
        problem = replace(problem, bearing_scale=bearing_factor, survey_scale=survey_factor)
    jacobian = problem.jacobian(poses)
    return MountingFit(problem, poses, inverse_normal(jacobian), kept, bearing_factor, survey_factor)


def refit(solution: MountingFit, problem: MountingProblem) -> MountingFit:
    """Return the solution for fewer observations, with the same weights, from the solution for all."""
    poses = _fit(problem, solution.poses, "linear")
    return replace(solution, problem=problem, poses=poses, full_covariance=inverse_normal(problem.jacobian(poses)))


def extra_parameter(solution: MountingFit, column: FloatArray) -> tuple[float, float]:
    """Return the value of one more unknown, and its standard deviation, by one step of the fit.

    Parameters
    ----------
    solution : MountingFit
        Where it is zero.
    column : (m,) array
        Derivatives of the residuals by it.

    Returns
    -------
    value, sigma : float
        The standard deviation is infinite where the observations do not tell.
    """
    jacobian = solution.problem.jacobian(solution.poses)
    residuals = solution.problem.residuals(solution.poses)
    free = column - jacobian @ (solution.full_covariance @ (jacobian.T @ column))
    information = float(free @ free)
    if not information > 1e-12 * float(column @ column):
        return 0.0, np.inf
    return float(-(free @ residuals) / information), information**-0.5


def _fit(problem: MountingProblem, start: Poses, loss: Literal["linear", "soft_l1"]) -> Poses:
    def derivatives(poses: Poses, step: FloatArray) -> FloatArray:
        return problem.jacobian(poses) @ _step_derivative(step)

    scale = np.tile(_STEP, 1 + len(problem.surveys))
    return descend(problem.residuals, start, scale, loss, derivatives, tolerance=1e-9)


def _step_derivative(step: FloatArray) -> FloatArray:
    """Return how a small further step about the moved poses follows from a change of a step, block by block."""
    matrix = np.eye(len(step))
    for first in range(3, len(step), CAMERA):
        rotation = step[first : first + 3]
        matrix[first : first + 3, first : first + 3] = _left_jacobian(rotation)
    return matrix


def _left_jacobian(rotation: FloatArray) -> FloatArray:
    angle = float(np.linalg.norm(rotation))
    cross = cross_matrices(rotation)
    if angle < 1e-6:
        near: FloatArray = np.eye(3) + cross / 2
        return near
    matrix: FloatArray = (
        np.eye(3) + (1 - np.cos(angle)) / angle**2 * cross + (angle - np.sin(angle)) / angle**3 * cross @ cross
    )
    return matrix


def _factors(
    problem: MountingProblem, poses: Poses, jacobian: FloatArray, inverse: FloatArray
) -> tuple[float, float]:
    """Return the factors on the standard deviations of both kinds that their residuals tell.

    The redundancy of a kind is its number of residuals less what the unknowns take from it. Bearings always
    get their own factor; the survey is believed unless its residuals contradict it.
    """
    squares, left = problem.residuals(poses) ** 2, redundancies(jacobian, inverse)
    bearings, surveys = (
        (float(squares[part].sum()), float(left[part].sum()))
        for part in (slice(problem.image_rows), slice(problem.image_rows, None))
    )
    told = bearings[1] > _LEAST_REDUNDANCY
    bearing_factor = problem.bearing_scale * np.sqrt(bearings[0] / bearings[1]) if told else 1.0
    survey_factor = error_factor(surveys[0] * problem.survey_scale**2, surveys[1])
    return float(max(bearing_factor, LEAST_BEARING_SCALE)), survey_factor


def turn_to(start: Rotation, end: Rotation) -> FloatArray:
    """Return the rotation vector, about the target's axes, that takes one orientation to another, (3,)."""
    return np.asarray((end * start.inv()).as_rotvec())
