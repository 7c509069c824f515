"""The camera's pose on the forklift from surveyed targets, with the covariance of all six numbers."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from calibration.bearing_dlt import cross_matrices
from calibration.network import CAMERA, Network, Poses
from palletloc.geometry import BoolArray, FloatArray
from palletloc.mounting import Mounting

_ROUNDS = 3
_GATE = 4.0
_LEAST_SIGHT_SCALE = 0.5
_LEVEL = 0.01


@dataclass(frozen=True, slots=True, eq=False)
class Extrinsics:
    """A solution of the network."""

    network: Network
    """The observations that it rests on, with the scales that their residuals tell."""
    poses: Poses
    """The camera's pose and those of the targets."""
    full_covariance: FloatArray
    """(6 + 6 k, 6 + 6 k) of all unknowns, in metres and radians."""
    kept: tuple[BoolArray, ...]
    """Of each sight the corners that were used."""
    sight_factor: float
    """How much larger bearings' errors are than stated."""
    survey_factor: float
    """How much larger the survey's errors are than stated."""

    frame_covariance: FloatArray = field(default_factory=lambda: np.zeros((CAMERA, CAMERA)))
    """(6, 6) what an error of the forklift frame adds to the camera's."""

    def with_frame_errors(self, covariance: FloatArray) -> Extrinsics:
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


def solve(network: Network, start: Poses) -> Extrinsics:
    """Fit camera and targets to all observations.

    A robust fit comes first. Corners that contradict it are left out; a linear fit of the rest follows, in
    which the two kinds of observations are weighed by what their own residuals tell.

    Parameters
    ----------
    network : Network
        The observations, with scales of one.
    start : Poses
        Rough values.

    Raises
    ------
    numpy.linalg.LinAlgError
        If the observations leave a direction entirely free.
    """
    poses = _fit(network, start, "soft_l1")
    kept = _inliers(network, poses)
    network = network.kept(kept)
    sight_factor = survey_factor = 1.0
    for _ in range(_ROUNDS):
        poses = _fit(network, poses, "linear")
        jacobian = network.jacobian(poses)
        inverse = _inverse(jacobian)
        sight_factor, survey_factor = _factors(network, poses, jacobian, inverse)
        network = replace(network, sight_scale=sight_factor, survey_scale=survey_factor)
    jacobian = network.jacobian(poses)
    return Extrinsics(network, poses, _inverse(jacobian), kept, sight_factor, survey_factor)


def resolve(solution: Extrinsics, network: Network) -> Extrinsics:
    """Return the solution for fewer observations, with the same weights, from the solution for all."""
    poses = _fit(network, solution.poses, "linear")
    return replace(solution, network=network, poses=poses, full_covariance=_inverse(network.jacobian(poses)))


def _inverse(jacobian: FloatArray) -> FloatArray:
    """Return the covariance that derivatives in units of standard deviations give."""
    covariance = np.asarray(np.linalg.inv(jacobian.T @ jacobian), dtype=np.float64)
    return (covariance + covariance.T) / 2


def extra_parameter(solution: Extrinsics, column: FloatArray) -> tuple[float, float]:
    """Return the value of one more unknown, and its standard deviation, by one step of the fit.

    Parameters
    ----------
    solution : Extrinsics
        Where it is zero.
    column : (m,) array
        Derivatives of the residuals by it.

    Returns
    -------
    value, sigma : float
        The standard deviation is infinite where the observations do not tell.
    """
    jacobian = solution.network.jacobian(solution.poses)
    residuals = solution.network.residuals(solution.poses)
    free = column - jacobian @ (solution.full_covariance @ (jacobian.T @ column))
    information = float(free @ free)
    if not information > 1e-12 * float(column @ column):
        return 0.0, np.inf
    return float(-(free @ residuals) / information), information**-0.5


def _fit(network: Network, start: Poses, loss: Literal["linear", "soft_l1"]) -> Poses:
    def residuals(step: FloatArray) -> FloatArray:
        return network.residuals(start.moved(step))

    def jacobian(step: FloatArray) -> FloatArray:
        return network.jacobian(start.moved(step)) @ _step_derivative(step)

    size = CAMERA * (1 + len(network.surveys))
    scale = np.tile([0.001, 0.001, 0.001, 0.0005, 0.0005, 0.0005], size // CAMERA)
    result = least_squares(
        residuals, np.zeros(size), jacobian, loss=loss, f_scale=2.0, x_scale=scale, max_nfev=40, xtol=1e-9
    )
    return start.moved(result.x)


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


def _inliers(network: Network, poses: Poses) -> tuple[BoolArray, ...]:
    """Return of each sight the corners within four robust standard deviations."""
    residuals = network.residuals(poses)[: network.image_rows].reshape(-1, 2)
    length = np.linalg.norm(residuals, axis=-1)
    # The median length of two unit normal numbers is 1.1774.
    gate = _GATE * max(1.0, float(np.median(length)) / 1.1774)
    ends = np.cumsum([len(sight.points) for sight in network.sights])
    return tuple(np.split(length < gate, ends[:-1]))


def _factors(network: Network, poses: Poses, jacobian: FloatArray, inverse: FloatArray) -> tuple[float, float]:
    """Return the factors on the standard deviations of both kinds that their residuals tell.

    The redundancy of a kind is its number of residuals less what the unknowns take from it. Bearings always
    get their own factor; the survey is believed unless its residuals contradict it at one in a hundred.
    """
    residuals, split = network.residuals(poses), network.image_rows
    squares = residuals**2
    taken = np.einsum("ij,jk,ik->i", jacobian, inverse, jacobian)
    sight, survey = (
        (float(squares[part].sum()), float((1 - taken[part]).sum())) for part in (slice(split), slice(split, None))
    )
    sight_factor = network.sight_scale * np.sqrt(sight[0] / sight[1]) if sight[1] > 20 else 1.0
    total = survey[0] * network.survey_scale**2
    wrong = survey[1] > 1 and total > chi2.isf(_LEVEL, survey[1])
    survey_factor = max(1.0, np.sqrt(total / survey[1])) if wrong else 1.0
    return float(max(sight_factor, _LEAST_SIGHT_SCALE)), float(survey_factor)


def turn_to(one: Rotation, other: Rotation) -> FloatArray:
    """Return the rotation vector, about the target's axes, that takes one orientation to another, (3,)."""
    return np.asarray((other * one.inv()).as_rotvec())
