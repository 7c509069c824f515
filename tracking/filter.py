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
from typing import NamedTuple

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter

from palletloc.geometry import FloatArray, wrap_angle
from tracking.config import TrackerConfig
from tracking.motion import Motion
from tracking.observation import Observation, picked

SIZE = 10
"""Numbers in the state."""
POSE, CONSTANTS, COMMON = slice(0, 4), slice(4, 6), slice(6, 10)
"""Where its parts are."""
YAW = 3
"""Where the yaw is."""


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
        self.x = np.zeros(SIZE)
        self._common_path = config.errors.common_path_m
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

    def predicted(self, state: Gaussian, motion: Motion) -> Prediction:
        """Return a state after a motion of the forklift."""
        self.x, self.P = state
        self.predict(motion)
        return Prediction(Gaussian(self.x, _symmetric(self.P)), self.F)

    def predict_x(self, u: Motion) -> None:  # called by predict()
        """Move the state, and set the matrices F and Q of that motion."""
        self.F, self.Q, self.x = self.transition(self.x, u)

    def transition(self, mean: FloatArray, motion: Motion) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return what a motion does to a state.

        Parameters
        ----------
        mean : (10,) array
            The state before.
        motion : Motion
            As odometry has it; the state's constants mend it.

        Returns
        -------
        F : (10, 10) array
            Derivative by the state before.
        Q : (10, 10) array
            Covariance of the motion's noise in the state after.
        mean : (10,) array
            The state after.
        """
        dx, dy, turn = motion.increment + motion.constants @ mean[CONSTANTS]
        cos, sin = math.cos(turn), math.sin(turn)
        x, y = mean[0] - dx, mean[1] - dy
        after = mean.copy()
        after[0], after[1] = cos * x + sin * y, cos * y - sin * x
        after[YAW] = wrap_angle(float(mean[YAW] - turn))
        by_motion = np.array([[-cos, -sin, after[1]], [sin, -cos, -after[0]], [0, 0, 0], [0, 0, -1.0]])
        stays = math.exp(-motion.path / self._common_path)
        after[COMMON] *= stays
        F = np.eye(SIZE)
        F[0, 0] = F[1, 1] = cos
        F[0, 1], F[1, 0] = sin, -sin
        F[POSE, CONSTANTS] = by_motion @ motion.constants
        Q = np.zeros((SIZE, SIZE))
        Q[POSE, POSE] = by_motion @ motion.covariance @ by_motion.T
        common = range(COMMON.start, COMMON.stop)
        F[common, common] = stays
        Q[common, common] = 1 - stays**2
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
        H, R = self.model(observation, scale)
        S = H @ state.covariance @ H.T + R
        root = np.linalg.cholesky(S)
        away = np.linalg.solve(root, _residual(observation, observation.values, H @ state.mean))
        return Innovation(float(away @ away), 2 * float(np.log(np.diag(root)).sum()))

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
        self.x, self.P = state
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
