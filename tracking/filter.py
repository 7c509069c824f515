r"""The Kalman filter of one pallet.

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
from scipy.linalg.lapack import dgesv, dposv

from palletloc.geometry import FloatArray, wrap_angle
from tracking import stacked
from tracking.config import TrackerConfig
from tracking.motion import Motion
from tracking.observation import YAW, Observation
from tracking.stacked import symmetric
from tracking.state import COMMON, CONSTANTS, POSE, SIZE, Gaussian

FEW = 4
"""States up to which one by one is faster than all at once."""


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

    Without memory: every call gets a state and returns another one. `predict` is filterpy's; `updated` has the
    equations of its `update` without what that keeps for others and its general inverse, which take most of its time.

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
        self._floor = (1e-3 * config.odometry.floor_mm_per_sqrt_m) ** 2
        wander, of_yaw = config.errors.wander_m**2, math.radians(config.errors.wander_yaw_deg) ** 2
        self._wander = np.diag([wander, wander, wander + self._floor, of_yaw, *[0.0] * 6])
        self._fading = np.diag([*[0.0] * COMMON.start, *[1.0] * 4])
        self.estimated = config.estimate_odometry
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
        alike, found = self.alike(motion), []
        if len(states) > FEW:
            x, P = _stacked(states)
            F, B, x = stacked.transitions(x, motion, alike[0])
            P = stacked.carried(P, F, stacked.noise(B, motion, alike[1]))
            return [Prediction(Gaussian(*state), by_state) for *state, by_state in zip(x, P, F, strict=True)]
        for self.x, self.P in states:
            self.predict((motion, *alike))
            found.append(Prediction(Gaussian(self.x, symmetric(self.P)), self.F))
        return found

    def predict_x(self, u: tuple[Motion, FloatArray, FloatArray]) -> None:  # called by predict()
        """Move the state, and set the matrices F and Q of that motion."""
        self.F, self.Q, self.x = _transition(self.x, *u)

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
        return _transition(mean, motion, *self.alike(motion))

    def alike(self, motion: Motion) -> tuple[FloatArray, FloatArray]:
        """Return those parts of F and Q, (10, 10) each, that are the same for all states."""
        stays = math.exp(-motion.path / self._common_path)
        F = self._I - (1 - stays) * self._fading
        return F, motion.path * self._wander + (1 - stays**2) * self._fading

    def height_noise(self, motion: Motion) -> float:
        """Return the variance of how a motion lifts the forklift, and all pallets alike."""
        return self._floor * motion.path

    def model(self, observation: Observation, scale: float = 1.0) -> MeasurementModel:
        """Return how a state leads to a measurement.

        Parameters
        ----------
        observation : Observation
            The measurement.
        scale : float
            Factor on its covariance.
        """
        if scale == 1.0:
            return MeasurementModel(observation.H, observation.own)
        H = observation.H.copy()
        H[:, COMMON] *= math.sqrt(scale)
        return MeasurementModel(H, scale * observation.own)

    def innovation(self, state: Gaussian, observation: Observation, scale: float = 1.0) -> Innovation:
        """Return how far a measurement is from a state, before any update.

        Parameters
        ----------
        state : Gaussian
            Before it.
        observation : Observation
            The measurement.
        scale : float
            Factor on its covariance.
        """
        H, R = self.model(observation, scale)
        mean, P = state
        S = H.dot(P).dot(H.T) + R
        away = _away(observation, H, mean)
        root, solved, failed = dposv(S, away)
        if failed:  # rounding has made it so: it belongs to nothing
            return Innovation(math.inf, math.inf)
        return Innovation(float(away.dot(solved)), 2 * math.log(math.prod(root.diagonal().tolist())))

    def innovations(
        self, states: Sequence[Gaussian], observations: Sequence[Observation], scales: Sequence[float]
    ) -> list[Innovation]:
        """Return the same of many states and measurements, all with the same components."""
        if len(states) <= FEW:
            return [self.innovation(*one) for one in zip(states, observations, scales, strict=True)]
        H, R = self.models(observations, scales)
        x, P = _stacked(states)
        found = stacked.distances(P, H, R, all_away(observations, H, x))
        return [Innovation(*pair) for pair in zip(*(one.tolist() for one in found), strict=True)]

    def updated(self, state: Gaussian, observation: Observation, scale: float = 1.0, weight: float = 1.0) -> Gaussian:
        """Return a state after a measurement, by Joseph's form of the update.

        Where the odometry's constants are not estimated, only allowed for, their rows of the gain are zero: Schmidt's
        gain.

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
        if weight != 1.0:
            R = R / weight
        mean, P = state
        of_state = H.dot(P)
        K = dgesv(of_state.dot(H.T) + R, of_state)[2].T  # the same as by the inverse of S, which is symmetric
        if not self.estimated:
            K[CONSTANTS] = 0.0
        mean = mean + K.dot(_away(observation, H, mean))
        mean[YAW] = wrap_angle(float(mean[YAW]))
        stays = self._I - K.dot(H)
        return Gaussian(mean, symmetric(stays.dot(P).dot(stays.T) + K.dot(R).dot(K.T)))

    def updates(
        self,
        states: Sequence[Gaussian],
        observations: Sequence[Observation],
        scales: Sequence[float],
        weights: Sequence[float],
    ) -> list[Gaussian]:
        """Return the same of many states and measurements, all with the same components."""
        if len(states) <= FEW:
            return [self.updated(*one) for one in zip(states, observations, scales, weights, strict=True)]
        H, R = self.models(observations, scales)
        x, P = _stacked(states)
        R = R / np.array(weights)[:, None, None]
        found = stacked.corrected(x, P, H, R, all_away(observations, H, x), self.estimated)
        return [Gaussian(*state) for state in zip(*found, strict=True)]

    def models(self, observations: Sequence[Observation], scales: Sequence[float]) -> tuple[FloatArray, FloatArray]:
        """Return the matrices H, (n, k, 10), and R, (n, k, k), of measurements with the same components."""
        H, factors = np.array([one.H for one in observations]), np.array(scales)[:, None, None]
        H[:, :, COMMON] *= np.sqrt(factors)
        return H, factors * np.array([one.own for one in observations])


def _transition(
    mean: FloatArray, motion: Motion, F: FloatArray, Q: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return what a motion does to a state; F and Q come as they are alike for all states."""
    dx, dy, turn = (motion.increment + motion.constants.dot(mean[CONSTANTS])).tolist()
    x, y, z, yaw = mean[POSE].tolist()
    cos, sin = math.cos(turn), math.sin(turn)
    x, y = cos * (x - dx) + sin * (y - dy), cos * (y - dy) - sin * (x - dx)
    after = mean * F.diagonal()
    after[POSE] = x, y, z, wrap_angle(yaw - turn)
    B = np.zeros((SIZE, 3))  # number by number: slices of so small an array take longer
    B[0, 0] = B[1, 1] = -cos
    B[0, 1], B[1, 0], B[0, 2], B[1, 2], B[YAW, 2] = -sin, sin, y, -x, -1.0
    F = F.copy()
    F[0, 0] = F[1, 1] = cos
    F[0, 1], F[1, 0] = sin, -sin
    F[POSE, CONSTANTS] = B[POSE].dot(motion.constants)
    return F, Q + B.dot(motion.covariance).dot(B.T), after


def _away(observation: Observation, H: FloatArray, mean: FloatArray) -> FloatArray:
    """Return the innovation, an angle the short way round."""
    away: FloatArray = observation.values - H.dot(mean)
    if observation.components[-1] == YAW:
        away[-1] = wrap_angle(float(away[-1]))
    return away


def _stacked(states: Sequence[Gaussian]) -> tuple[FloatArray, FloatArray]:
    return np.array([state.mean for state in states]), np.array([state.covariance for state in states])


def all_away(observations: Sequence[Observation], H: FloatArray, means: FloatArray) -> FloatArray:
    """Return (n, k) innovations of states and measurements with the same components, angles the short way round."""
    away = np.array([one.values for one in observations]) - (H @ means[:, :, None])[:, :, 0]
    if observations[0].components[-1] == YAW:
        away[:, -1] = wrap_angle(away[:, -1])
    return away
