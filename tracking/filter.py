r"""The Kalman filter of one pallet.

The state is the pallet's pose in the forklift frame with what errs alike in many steps:

====== =========================================================================================
0 - 3  x, y, z in metres and yaw in radians: ``forklift_from_pallet``
4      the wheels' relative scale error
5      the rate that the gyroscope misses, in rad/s
6 - 9  the error that this pallet's measurements share, in units of its standard deviation
====== =========================================================================================

A motion :math:`(d, \theta)` of the forklift moves the pallet to :math:`p' = R(-\theta) (p - d)`, its yaw to
:math:`\psi - \theta`. A measurement is :math:`z = p + L \beta + v` with :math:`L L^T` the shared part of its
covariance and :math:`v` the rest: coloured noise by state augmentation (Bar-Shalom, Li, Kirubarajan, Estimation
with Applications to Tracking and Navigation, 2001, section 8.2).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter

from palletloc.geometry import FloatArray, wrap_angle
from tracking.config import TrackerConfig
from tracking.motion import Motion
from tracking.observation import YAW, Observation, picked

SIZE = 10
"""Numbers in the state."""
POSE, CONSTANTS, COMMON = slice(0, 4), slice(4, 6), slice(6, 10)
"""Where its parts are."""
_SHARED = np.array([0.0] * COMMON.start + [1.0] * 4)
_CARRIED = 1.0 - _SHARED
_ALL = np.arange(SIZE)


class Gaussian(NamedTuple):
    """What is known of a state."""

    mean: FloatArray
    """(10,) the state."""
    covariance: FloatArray
    """(10, 10) its covariance."""


class Prediction(NamedTuple):
    """A state carried on by a motion."""

    state: Gaussian
    """The state after it."""
    F: FloatArray
    """(10, 10) its derivative by the state before."""


class Innovation(NamedTuple):
    """How far a measurement is from a state."""

    distance: float
    """Squared Mahalanobis distance: the normalised innovation squared, NIS."""
    log_volume: float
    """Logarithm of the determinant of the innovation's covariance."""


class MeasurementModel(NamedTuple):
    """How a state leads to a measurement."""

    H: FloatArray
    """(k, 10) derivative of the measurement by the state."""
    R: FloatArray
    """(k, k) covariance of what no other measurement shares."""


class PalletFilter(ExtendedKalmanFilter):
    """Extended Kalman filter of `filterpy` for a pallet seen from a moving forklift.

    Without memory: every call gets a state and returns another one.

    Parameters
    ----------
    config : TrackerConfig
        Noise of odometry and measurements.
    """

    def __init__(self, config: TrackerConfig) -> None:
        super().__init__(dim_x=SIZE, dim_z=4)
        self.x: FloatArray = np.zeros(SIZE)
        self.P: FloatArray = np.eye(SIZE)
        self._common_path = config.errors.common_path_m
        self._floor = 1e-3 * config.odometry.floor_mm_per_sqrt_m
        self._estimated = config.estimate_odometry
        self._constants = np.diag(config.odometry.constants**2)

    def begin(self, observation: Observation) -> Gaussian:
        """Return the state after a first measurement of a whole pose."""
        mean, covariance = np.zeros(SIZE), np.zeros((SIZE, SIZE))
        mean[POSE] = observation.values
        covariance[POSE, POSE] = observation.covariance
        covariance[CONSTANTS, CONSTANTS] = self._constants
        covariance[COMMON, COMMON] = np.eye(4)
        covariance[POSE, COMMON], covariance[COMMON, POSE] = -observation.common, -observation.common.T
        return Gaussian(mean, covariance)

    def predicted(self, states: Sequence[Gaussian], motion: Motion) -> list[Prediction]:
        """Return states after a motion of the forklift."""
        if not states:
            return []
        steps = self.transitions(np.array([state.mean for state in states]), motion)
        found = []
        for state, *step in zip(states, *steps, strict=True):
            self.x, self.P = state.mean, state.covariance
            self.predict(step)
            found.append(Prediction(Gaussian(self.x, _symmetric(self.P)), self.F))
        return found

    def predict_x(self, u: Sequence[FloatArray]) -> None:  # called by predict()
        """Move the state, and set the matrices F and Q of that motion."""
        self.F, self.Q, self.x = u

    def transitions(self, means: FloatArray, motion: Motion) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return what a motion does to states.

        Parameters
        ----------
        means : (n, 10) array
            The states before.
        motion : Motion
            As odometry has it; the states' constants mend it.

        Returns
        -------
        F : (n, 10, 10) array
            Derivatives by the states before.
        Q : (n, 10, 10) array
            Covariances of the motion's noise in the states after.
        means : (n, 10) array
            The states after.
        """
        dx, dy, turn = motion.increment[:, None] + motion.constants @ means[:, CONSTANTS].T
        cos, sin = np.cos(turn), np.sin(turn)
        x, y = means[:, 0] - dx, means[:, 1] - dy
        stays = math.exp(-motion.path / self._common_path)
        after = means.copy()
        after[:, 0], after[:, 1] = cos * x + sin * y, cos * y - sin * x
        after[:, YAW] = wrap_angle(means[:, YAW] - turn)
        after[:, COMMON] *= stays
        by_motion = np.zeros((len(means), 4, 3))
        by_motion[:, 0, 0] = by_motion[:, 1, 1] = -cos
        by_motion[:, 0, 1], by_motion[:, 1, 0] = -sin, sin
        by_motion[:, 0, 2], by_motion[:, 1, 2] = after[:, 1], -after[:, 0]
        by_motion[:, YAW, 2] = -1.0
        F = np.zeros((len(means), SIZE, SIZE))
        F[:, _ALL, _ALL] = _CARRIED + stays * _SHARED
        F[:, 0, 0] = F[:, 1, 1] = cos
        F[:, 0, 1], F[:, 1, 0] = sin, -sin
        F[:, POSE, CONSTANTS] = by_motion @ motion.constants
        Q = np.zeros_like(F)
        Q[:, _ALL, _ALL] = (1 - stays**2) * _SHARED
        Q[:, POSE, POSE] = by_motion @ motion.covariance @ by_motion.transpose(0, 2, 1)
        Q[:, 2, 2] = self._floor**2 * motion.path
        return F, Q, after

    def model(self, observation: Observation, scale: float = 1.0) -> MeasurementModel:
        """Return how a state leads to a measurement.

        Parameters
        ----------
        observation : Observation
            The measurement.
        scale : float
            Factor on its covariance.
        """
        H = np.zeros((len(observation.components), SIZE))
        H[:, POSE] = picked(observation.components)
        H[:, COMMON] = math.sqrt(scale) * observation.common
        return MeasurementModel(H, scale * observation.own)

    def innovation(self, state: Gaussian, observation: Observation, scale: float = 1.0) -> Innovation:
        """Return how far a measurement is from a state, before any update."""
        return self.innovations([state], [observation], [scale])[0]

    def innovations(
        self, states: Sequence[Gaussian], observations: Sequence[Observation], scales: Sequence[float]
    ) -> list[Innovation]:
        """Return how far measurements are from states, before any update.

        Parameters
        ----------
        states : sequence of Gaussian
            One for each measurement.
        observations : sequence of Observation
            All with the same components.
        scales : sequence of float
            Factors on their covariances.
        """
        components = list(observations[0].components)
        factor = np.array(scales)[:, None, None]
        H = np.zeros((len(states), len(components), SIZE))
        H[:, :, POSE] = picked(observations[0].components)
        H[:, :, COMMON] = np.sqrt(factor) * np.array([one.common for one in observations])
        P = np.array([state.covariance for state in states])
        S = H @ P @ H.transpose(0, 2, 1) + factor * np.array([one.own for one in observations])
        expected = (H @ np.array([state.mean for state in states])[:, :, None])[:, :, 0]
        away = np.array([one.values for one in observations]) - expected
        if components[-1] == YAW:
            away[:, -1] = wrap_angle(away[:, -1])
        roots = np.linalg.cholesky(S)
        whitened = np.linalg.solve(roots, away[:, :, None])[:, :, 0]
        distances = (whitened * whitened).sum(axis=1)
        volumes = 2 * np.log(np.diagonal(roots, axis1=1, axis2=2)).sum(axis=1)
        return [Innovation(*pair) for pair in zip(distances.tolist(), volumes.tolist(), strict=True)]

    def updated(self, state: Gaussian, observation: Observation, scale: float = 1.0, weight: float = 1.0) -> Gaussian:
        """Return a state after a measurement.

        Parameters
        ----------
        state : Gaussian
            Before it.
        observation : Observation
            The measurement.
        scale : float
            Factor on its covariance.
        weight : float
            How much it counts, up to 1: a robust weight.
        """
        H, R = self.model(observation, scale)
        R = R / weight
        if not self._estimated:
            return self._considered(state, observation, H, R)
        self.x, self.P = state.mean, state.covariance
        self.update(
            observation.values,
            HJacobian=lambda _: H,
            Hx=lambda mean: H @ mean,
            R=R,
            residual=lambda z, expected: _residual(observation, z, expected),
        )
        self.x[YAW] = wrap_angle(float(self.x[YAW]))
        return Gaussian(self.x, _symmetric(self.P))

    def _considered(self, state: Gaussian, observation: Observation, H: FloatArray, R: FloatArray) -> Gaussian:
        """Return the state after an update that leaves the odometry's constants alone: Schmidt's gain."""
        mean, P = state
        K = np.linalg.solve(H @ P @ H.T + R, H @ P).T
        K[CONSTANTS] = 0.0
        mean = mean + K @ _residual(observation, observation.values, H @ mean)
        mean[YAW] = wrap_angle(float(mean[YAW]))
        stays = np.eye(SIZE) - K @ H
        return Gaussian(mean, _symmetric(stays @ P @ stays.T + K @ R @ K.T))


def _residual(observation: Observation, z: FloatArray, expected: FloatArray) -> FloatArray:
    """Return the innovation, an angle the short way round."""
    away = z - expected
    if observation.components[-1] == YAW:
        away[-1] = wrap_angle(float(away[-1]))
    return away


def _symmetric(matrix: FloatArray) -> FloatArray:
    return (matrix + matrix.T) / 2
