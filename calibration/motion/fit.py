"""The mounting that a drive past targets tells, and which of its directions no such drive can tell."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from scipy.optimize import least_squares
from scipy.stats import chi2

from calibration.bearing_dlt import cross_matrices
from calibration.degeneracy import LIMITS
from calibration.motion.network import CAMERA_PRIOR, DELAY_PRIOR, MotionNetwork, MotionState
from calibration.network import CAMERA
from palletloc.geometry import FloatArray

_GATE, _LEAST_SIGHT_SCALE, _LEVEL = 4.0, 0.5, 0.01
_NOTICED = np.array([0.001, 0.001, 0.001, *np.radians([0.03, 0.03, 0.03])])
_SECOND_ORDER = np.array([0.0005, 0.0005, 0.0005, *np.radians([0.01, 0.01, 0.01])])
_OPEN = 10.0  # times 50 mm and 2 degrees: how far a stated mounting may be off at all


@dataclass(frozen=True, slots=True, eq=False)
class MotionFit:
    """What a drive tells."""

    network: MotionNetwork
    """The observations that it rests on."""
    state: MotionState
    """Values; along lost directions they are about as stated."""
    covariance: FloatArray
    """(6, 6) of the camera, in metres and radians; half a metre or
     20 degrees along directions that the motion loses."""
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


def fit_motion(network: MotionNetwork, start: MotionState) -> MotionFit:
    """Fit mounting, targets, way and the odometry's faults together.

    Parameters
    ----------
    network : MotionNetwork
        With scales of one.
    start : MotionState
        Rough values.

    Returns
    -------
    MotionFit
        With the scales that the residuals tell.
    """
    # What the motion cannot tell must not wander: far away, the equations bend the rest along.
    network = replace(network, held=lost_by_motion(network, start))
    state = _descend(network, start, "soft_l1")
    network = _inliers(network, state)
    state = _descend(network, state, "linear")
    jacobian = _jacobian(network, state)
    network = _weighed(network, state, jacobian)
    state = _descend(network, state, "linear")
    jacobian = _jacobian(network, state)
    covariance = np.linalg.inv(jacobian.T @ jacobian)
    kernel = network.held
    camera = covariance[:CAMERA, :CAMERA]
    huge = LIMITS[:, None] * kernel * _OPEN
    faults = np.sqrt(np.diag(covariance)[CAMERA : CAMERA + 3])
    camera = camera + huge @ huge.T
    if kernel.shape[1] > 1:
        # A turn that is held at a wrong value bends the others in second order; a height does not.
        camera = camera + np.diag(_SECOND_ORDER**2)
    return MotionFit(network, state, camera, faults, kernel)


def lost_by_motion(network: MotionNetwork, state: MotionState) -> FloatArray:
    """Return the directions of the mounting that commute with all motions, (6, j), in units of `LIMITS`.

    A turn and shift of the camera is not seen if it is the same before and after each motion of the forklift, for
    then the targets may have moved instead: ``(Ad(V) - 1) xi = 0``. Targets of known height may not.

    Parameters
    ----------
    network : MotionNetwork
        With the heights.
    state : MotionState
        With the way.
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
    for k, height in network.heights.items():
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


def _descend(network: MotionNetwork, start: MotionState, loss: Literal["linear", "soft_l1"]) -> MotionState:
    shots, targets = len(network.times), network.targets
    board = [0.01, 0.01, 0.01, 0.005, 0.005, 0.005]
    faults = [network.scale_sigma / 5, network.noise.bias, DELAY_PRIOR / 5]
    scale = np.concatenate(
        [CAMERA_PRIOR / 10, faults, np.tile([0.01, 0.01, 0.005], shots - 1), np.tile(board, targets)]
    )

    def residuals(step: FloatArray) -> FloatArray:
        return network.residuals(start.moved(step))

    found = least_squares(
        residuals,
        np.zeros(network.size),
        loss=loss,
        f_scale=2.0,
        x_scale=scale,
        max_nfev=30,
        xtol=1e-8,
        ftol=1e-8,
    )
    return start.moved(np.asarray(found.x))


def _jacobian(network: MotionNetwork, state: MotionState) -> FloatArray:
    columns = []
    for index in range(network.size):
        step = np.zeros(network.size)
        step[index] = 1e-6
        columns.append((network.residuals(state.moved(step)) - network.residuals(state.moved(-step))) / 2e-6)
    return np.stack(columns, axis=1)


def _inliers(network: MotionNetwork, state: MotionState) -> MotionNetwork:
    """Return the network without corners beyond four robust standard deviations."""
    off = network.residuals(state)[: network.image_rows].reshape(-1, 2)
    length = np.linalg.norm(off, axis=1)
    gate = _GATE * max(1.0, float(np.median(length)) / 1.1774)
    ends = np.cumsum([len(sight.points) for sight in network.sights])[:-1]
    sights = tuple(
        replace(s, points=s.points[c], bearings=s.bearings[c], origins=s.origins[c], sigma=s.sigma[c])
        for s, c in zip(network.sights, np.split(length < gate, ends), strict=True)
    )
    return replace(network, sights=sights)


def _weighed(network: MotionNetwork, state: MotionState, jacobian: FloatArray) -> MotionNetwork:
    """Return the network with the factors on standard deviations that the residuals tell."""
    squares = network.residuals(state) ** 2
    inverse = np.linalg.inv(jacobian.T @ jacobian)
    left = 1 - np.einsum("ij,jk,ik->i", jacobian, inverse, jacobian)
    split = network.image_rows
    drive = slice(split, split + 3 * (len(network.times) - 1))
    sight = float(np.sqrt(squares[:split].sum() / left[:split].sum()))
    total, free = float(squares[drive].sum()), float(left[drive].sum())
    wrong = free > 1 and total > chi2.isf(_LEVEL, free)
    return replace(
        network,
        sight_scale=max(sight, _LEAST_SIGHT_SCALE),
        drive_scale=max(1.0, float(np.sqrt(total / free))) if wrong else 1.0,
    )
