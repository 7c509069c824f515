r"""The Kalman filter of pallets that share one estimate.

A motion :math:`(d, \theta)` of the forklift moves a pallet to :math:`p' = R(-\theta) (p - d)` and its yaw to
:math:`\psi - \theta`. One motion moves all pallets: with :math:`B_i` the derivative of pallet i's pose by the motion
and :math:`B = (B_1, \dots, B_m)`, its noise enters as :math:`B \Sigma B^T`, also between the pallets.

A measurement is :math:`z = p + L \beta + v` with :math:`L L^T` the shared part of its covariance and :math:`v` the
rest: coloured noise by state augmentation (Bar-Shalom, Li, Kirubarajan, Estimation with Applications to Tracking and
Navigation, 2001, section 8.2). A measurement of one pallet corrects all of its group.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from scipy.linalg.lapack import dposv

from palletloc.geometry import FloatArray, wrap_angle
from tracking.config import TrackerConfig
from tracking.gating import Association
from tracking.motion import Motion
from tracking.observation import YAW, Observation
from tracking.state import COMMON, CONSTANTS, OWN, POSE, SIZE, Gaussian, IntArray, Predicted, TrackGroup, places_of

X, Y, HEIGHT = 0, 1, 2
"""Indices of the place in a pose."""


class Innovation(NamedTuple):
    """How far a measurement is from a state."""

    distance: float
    """Squared Mahalanobis distance: the normalised innovation squared, NIS."""
    log_volume: float
    """Logarithm of the determinant of the innovation's covariance."""


class MeasurementModel(NamedTuple):
    """How a state leads to a measurement."""

    H: FloatArray
    """(k, n) derivative of the measurement by the state."""
    R: FloatArray
    """(k, k) covariance of what no other measurement shares."""


class GroupFilter:
    """Extended Kalman filter of pallets seen from a moving forklift, for groups of one and more.

    Without memory: every call gets a state and returns another one.

    Parameters
    ----------
    config : TrackerConfig
        Noise of odometry and measurements.
    """

    def __init__(self, config: TrackerConfig) -> None:
        self._common_path = config.errors.common_path_m
        self._floor = (1e-3 * config.odometry.floor_mm_per_sqrt_m) ** 2
        self._wander = (config.errors.wander_m**2, math.radians(config.errors.wander_yaw_deg) ** 2)
        self._estimated = config.estimate_odometry
        self._constants = np.diag(config.odometry.constants**2)

    def begin(self, observation: Observation) -> Gaussian:
        """Return the state of one pallet after a first measurement of its whole pose."""
        mean, covariance = np.zeros(SIZE), np.zeros((SIZE, SIZE))
        mean[POSE] = observation.values
        covariance[POSE, POSE] = observation.covariance
        covariance[CONSTANTS, CONSTANTS] = self._constants
        covariance[COMMON, COMMON] = np.eye(4)
        covariance[POSE, COMMON], covariance[COMMON, POSE] = -observation.common, -observation.common.T
        return Gaussian(mean, covariance)

    def predict(self, states: Sequence[Gaussian], motion: Motion) -> list[Gaussian]:
        """Return states of groups after a motion of the forklift."""
        noise = self._noise(motion)
        return [self._step(state, motion, noise)[0] for state in states]

    def predict_groups(self, groups: Sequence[TrackGroup], motion: Motion) -> list[TrackGroup]:
        """Return groups after a motion of the forklift, with their predictions."""
        noise, found = self._noise(motion), []
        for group in groups:
            state, F = self._step(group.state, motion, noise)
            found.append(TrackGroup(group.keys, state, Predicted(group.keys, state, F), group.keys))
        return found

    def transition(self, mean: FloatArray, motion: Motion) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return what a motion does to the state of a group.

        Parameters
        ----------
        mean : (n,) array
            The state before.
        motion : Motion
            By odometry; the state's constants mend it.

        Returns
        -------
        F : (n, n) array
            Derivative by the state before.
        Q : (n, n) array
            Covariance of the motion's noise in the state after.
        mean : (n,) array
            The state after.
        """
        noise = self._noise(motion)
        F, B, after = _moved(mean, motion, noise.stays)
        return F, B.dot(noise.shared).dot(B.T) + np.diag(noise.own.take(_layout(len(mean)).own)), after

    def _noise(self, motion: Motion) -> _Noise:
        stays = math.exp(-motion.path / self._common_path)
        shared = np.zeros((4, 4))
        shared[:3, :3] = motion.covariance
        shared[3, 3] = motion.path * self._floor
        place, yaw = self._wander
        return _Noise(stays, shared, np.array((0.0, motion.path * place, motion.path * yaw, 1 - stays**2)))

    def _step(self, state: Gaussian, motion: Motion, noise: _Noise) -> tuple[Gaussian, FloatArray]:
        """Return a state after a motion, and its derivative by the state before."""
        mean, P = state
        F, B, after = _moved(mean, motion, noise.stays)
        P = F.dot(P).dot(F.T)
        P += B.dot(noise.shared).dot(B.T)
        P.ravel()[:: len(mean) + 1] += noise.own.take(_layout(len(mean)).own)
        return Gaussian(after, _symmetric(P)), F

    def innovation(self, state: Gaussian, observation: Observation, scale: float = 1.0) -> Innovation:
        """Return how far a measurement is from the state of its pallet, before any update.

        Parameters
        ----------
        state : Gaussian
            Of the pallet alone.
        observation : Observation
            The measurement.
        scale : float
            Factor on its covariance.
        """
        mean, P = state
        H, R = (observation.H, observation.own) if scale == 1.0 else model_of(observation, scale)
        S = H.dot(P).dot(H.T)
        S += R
        residual = _residual(observation, H, mean)
        root, solved, failed = dposv(S, residual)
        if failed:  # rounding has made it so: it belongs to nothing
            return Innovation(math.inf, math.inf)
        return Innovation(float(residual.dot(solved)), 2 * math.log(math.prod(root.diagonal().tolist())))

    def update(self, state: Gaussian, hits: Sequence[tuple[int, Association]]) -> Gaussian:
        """Return the state of a group after measurements, by Joseph's form of the update.

        Where the odometry's constants are not estimated, only allowed for, their rows of the gain are zero: Schmidt's
        gain.

        Parameters
        ----------
        state : Gaussian
            Before them.
        hits : sequence of (int, Association)
            Which of the group's pallets were measured, and how; at most once each.
        """
        mean, P = state
        H, R, residual = _stacked(mean, hits)
        of_state = P.dot(H.T)
        S = H.dot(of_state)
        S += R
        _, solved, failed = dposv(S.T, of_state.T)
        if failed:
            return self._one_by_one(state, hits)
        K = solved.T
        if not self._estimated:
            K[CONSTANTS] = 0.0
        mean = mean + K.dot(residual)
        layout = _layout(len(mean))
        for yaw in layout.yaws:
            mean[yaw] = wrap_angle(float(mean[yaw]))
        stays = layout.identity - K.dot(H)
        P = stays.dot(P).dot(stays.T)
        P += K.dot(R).dot(K.T)
        return Gaussian(mean, _symmetric(P))

    def update_group(self, group: TrackGroup, hits: Sequence[tuple[int, Association]]) -> TrackGroup:
        """Return a group after measurements; see `update`."""
        return TrackGroup(group.keys, self.update(group.state, hits), group.predicted, group.carried)

    def _one_by_one(self, state: Gaussian, hits: Sequence[tuple[int, Association]]) -> Gaussian:
        """Return a state that rounding has spoilt after one measurement at a time, without what is of no use."""
        if len(hits) > 1:
            for hit in hits:
                state = self.update(state, [hit])
        return state


class _Noise(NamedTuple):
    """What a motion adds to a state, the same for all groups."""

    stays: float
    """Part of a shared error that remains."""
    shared: FloatArray
    """(4, 4) covariance of the motion (x, y, yaw) and of how the floor lifts the forklift: it moves all pallets."""
    own: FloatArray
    """(4,) variances of each pallet's own: none, of the place, of the yaw, of a shared error."""


class _Layout(NamedTuple):
    """Where things are in the state of a group, and in its matrices."""

    begins: tuple[tuple[int, int], ...]
    """Where each pallet's pose and its shared error begin."""
    yaws: tuple[int, ...]
    """Indices of the yaws."""
    F: IntArray
    """(n, n) which of the numbers in `_moved` stands there."""
    shift: IntArray
    """(n,) which of them the motion takes off."""
    B: IntArray
    """(n, 4) which of them stands there."""
    turned: IntArray
    """(2 m,) rows of B that a turn moves: all x, then all y."""
    levers: IntArray
    """(2 m,) indices of the places by which it moves them: all y, then all x."""
    sides: FloatArray
    """(2 m,) to which side: 1, then -1."""
    own: IntArray
    """(n,) which of `_Noise.own` belongs there."""
    identity: FloatArray
    """(n, n) the unit matrix."""


@lru_cache(maxsize=64)
def _layout(size: int) -> _Layout:
    """Return where things are in a state of so many numbers."""
    count = 1 + (size - SIZE) // len(OWN)
    places = places_of(count)
    x, y, z, yaw = places[:, X], places[:, Y], places[:, HEIGHT], places[:, YAW]
    common = places[:, COMMON]
    zero, plus, minus, cos, sin, minus_cos, minus_sin, stays, ahead, left, turn = range(11)
    F, B = np.full((size, size), zero), np.full((size, 4), zero)
    np.fill_diagonal(F, plus)
    F[x, x], F[y, y], F[x, y], F[y, x], F[common, common] = cos, cos, sin, minus_sin, stays
    B[x, 0], B[y, 1], B[x, 1], B[y, 0], B[yaw, 2], B[z, 3] = minus_cos, minus_cos, minus_sin, sin, minus, plus
    shift, own = np.full(size, zero), np.zeros(size, dtype=np.intp)
    shift[x], shift[y], shift[yaw] = ahead, left, turn
    own[x], own[y], own[z], own[yaw], own[common] = 1, 1, 1, 2, 3
    begins = tuple(zip(x.tolist(), common[:, 0].tolist(), strict=True))
    turned, levers = np.concatenate((x, y)), np.concatenate((y, x))
    sides = np.repeat([1.0, -1.0], count)
    return _Layout(begins, tuple(yaw.tolist()), F, shift, B, turned, levers, sides, own, np.eye(size))


def _moved(mean: FloatArray, motion: Motion, stays: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return F, the derivative B of the state by (x, y, yaw, height) of the motion, and the state after it."""
    layout = _layout(len(mean))
    dx, dy, turn = (motion.increment + motion.constants.dot(mean[CONSTANTS])).tolist()
    cos, sin = math.cos(turn), math.sin(turn)
    ahead, left = cos * dx + sin * dy, cos * dy - sin * dx
    numbers = np.array((0.0, 1.0, -1.0, cos, sin, -cos, -sin, stays, ahead, left, turn))
    F, B = numbers.take(layout.F), numbers.take(layout.B)
    after = F.dot(mean)
    after -= numbers.take(layout.shift)
    for yaw in layout.yaws:
        after[yaw] = wrap_angle(float(after[yaw]))
    B[layout.turned, 2] = after.take(layout.levers) * layout.sides
    F[:, CONSTANTS] += B[:, :3].dot(motion.constants)
    return F, B, after


def model_of(observation: Observation, scale: float = 1.0) -> MeasurementModel:
    """Return how the state of a pallet leads to a measurement.

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


def _residual(observation: Observation, H: FloatArray, mean: FloatArray) -> FloatArray:
    """Return the innovation, an angle the short way round."""
    residual: FloatArray = observation.values - H.dot(mean)
    if observation.components[-1] == YAW:
        residual[-1] = wrap_angle(float(residual[-1]))
    return residual


def _stacked(mean: FloatArray, hits: Sequence[tuple[int, Association]]) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return H, R and the innovation of measurements of a group, one below the other."""
    begins = _layout(len(mean)).begins
    if len(begins) == 1:
        ((_, (observation, scale, weight, *_)),) = hits
        own = model_of(observation, scale)
        return own.H, own.R if weight == 1.0 else own.R / weight, _residual(observation, own.H, mean)
    rows = sum(len(hit.observation.components) for _, hit in hits)
    H, R, residual = np.zeros((rows, len(mean))), np.zeros((rows, rows)), np.empty(rows)
    end = 0
    for member, (observation, scale, weight, *_) in hits:
        part = slice(end, end := end + len(observation.components))
        pose, common = begins[member]
        own = model_of(observation, scale)
        H[part, pose : pose + 4] = own.H[:, POSE]
        H[part, common : common + 4] = own.H[:, COMMON]
        R[part, part] = own.R if weight == 1.0 else own.R / weight
        residual[part] = _residual(observation, H[part], mean)
    return H, R, residual


def _symmetric(matrix: FloatArray) -> FloatArray:
    """Return the symmetric part of a matrix."""
    found = matrix + matrix.T
    found *= 0.5
    return found
