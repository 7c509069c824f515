"""The filter's equations for many states at once: many small matrices cost little more than one.

`tracking.filter` has them for a single state; both give the same to rounding.
"""

from __future__ import annotations

import numpy as np

from palletloc.geometry import FloatArray, wrap_angle
from tracking.motion import Motion
from tracking.observation import YAW
from tracking.state import CONSTANTS, DIAGONAL, POSE


def transitions(means: FloatArray, motion: Motion, F: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return what a motion does to states.

    Parameters
    ----------
    means : (n, 10) array
        The states before.
    motion : Motion
        As odometry has it; the states' constants mend it.
    F : (10, 10) array
        The part of the derivative that is the same for all states.

    Returns
    -------
    F : (n, 10, 10) array
        Derivatives by the states before.
    B : (n, 4, 3) array
        Derivatives of the poses after by the motion.
    means : (n, 10) array
        The states after.
    """
    count = len(means)
    moved = motion.increment + means[:, CONSTANTS] @ motion.constants.T
    turn = moved[:, 2]
    back = np.exp(-1j * turn)  # places on the floor are x + iy: this turns them
    place = back * (means[:, 0] - moved[:, 0] + 1j * (means[:, 1] - moved[:, 1]))
    by_floor = np.array([-back, -1j * back, -1j * place]).T
    by_motion = np.zeros((count, 4, 3))
    by_motion[:, 0], by_motion[:, 1], by_motion[:, YAW, 2] = by_floor.real, by_floor.imag, -1.0
    after = means * F.flat[DIAGONAL]
    after[:, 0], after[:, 1], after[:, YAW] = place.real, place.imag, wrap_angle(means[:, YAW] - turn)
    by_state = np.repeat(F[None], count, axis=0)
    by_state[:, :2, :2] = -by_motion[:, :2, :2]
    by_state[:, POSE, CONSTANTS] = by_motion @ motion.constants
    return by_state, by_motion, after


def noise(B: FloatArray, motion: Motion, Q: FloatArray) -> FloatArray:
    """Return (n, 10, 10) covariances of a motion's noise in states after it.

    Parameters
    ----------
    B : (n, 4, 3) array
        Derivatives of the poses by the motion.
    motion : Motion
        With its noise.
    Q : (10, 10) array
        The part that is the same for all states.
    """
    found = np.repeat(Q[None], len(B), axis=0)
    found[:, POSE, POSE] += B @ motion.covariance @ B.transpose(0, 2, 1)
    return found


def carried(P: FloatArray, F: FloatArray, Q: FloatArray) -> FloatArray:
    """Return (n, 10, 10) covariances after steps of derivatives F and noise Q."""
    return symmetric(F @ P @ F.transpose(0, 2, 1) + Q)


def distances(P: FloatArray, H: FloatArray, R: FloatArray, away: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return how far measurements are from states.

    Parameters
    ----------
    P : (n, 10, 10) array
        Covariances of the states.
    H : (n, k, 10) array
        Derivatives of the measurements by the states.
    R : (n, k, k) array
        Covariances of the measurements' noise.
    away : (n, k) array
        The innovations.

    Returns
    -------
    squared : (n,) array
        Squared Mahalanobis distances.
    volumes : (n,) array
        Logarithms of the determinants of the innovations' covariances.
    """
    S = H @ P @ H.transpose(0, 2, 1) + R
    squared = (away[:, None] @ np.linalg.inv(S) @ away[:, :, None])[:, 0, 0]
    signs, volumes = np.linalg.slogdet(S)
    sound = (signs > 0) & (squared >= 0)  # where rounding has left something else, it belongs to nothing
    return np.where(sound, squared, np.inf), np.where(sound, volumes, np.inf)


def corrected(
    means: FloatArray, P: FloatArray, H: FloatArray, R: FloatArray, away: FloatArray, estimated: bool
) -> tuple[FloatArray, FloatArray]:
    """Return states after measurements, in Joseph's form.

    Parameters
    ----------
    means, P : (n, 10), (n, 10, 10) array
        The states before.
    H, R, away : (n, k, 10), (n, k, k), (n, k) array
        As `distances` takes them.
    estimated : bool
        Whether the odometry's constants are; otherwise they are allowed for by Schmidt's gain.

    Returns
    -------
    means, P : (n, 10), (n, 10, 10) array
        The states after.
    """
    of_state = P @ H.transpose(0, 2, 1)
    K = of_state @ np.linalg.inv(H @ of_state + R)
    if not estimated:
        K[:, CONSTANTS] = 0.0
    means = means + (K @ away[:, :, None])[:, :, 0]
    means[:, YAW] = wrap_angle(means[:, YAW])
    stays = np.eye(means.shape[1]) - K @ H
    return means, symmetric(stays @ P @ stays.transpose(0, 2, 1) + K @ R @ K.transpose(0, 2, 1))


def symmetric(matrices: FloatArray) -> FloatArray:
    """Return the symmetric parts of matrices."""
    found = matrices + matrices.swapaxes(-1, -2)
    found *= 0.5
    return found
