r"""What the tracks have learnt of odometry's constant errors, wheel scale and gyro bias, taken together.

Every track begins from the same prior :math:`\Lambda_0` and adds the information of its pallet,
:math:`G_i = P_i^{-1} - \Lambda_0`. The prior counts once. The gains are not independent, either: all tracks see the
same random noise of the odometry, to an extent that is not kept. They are fused by covariance intersection,

.. math:: P^{-1} = \Lambda_0 + \sum_i \omega_i G_i, \quad \sum_i \omega_i = 1,

which is consistent however much the gains have in common (Julier, Uhlmann, A non-divergent estimation algorithm in
the presence of unknown correlations, 1997), with the weights that make the determinant of P smallest.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from palletloc.geometry import FloatArray
from tracking.config import TrackerConfig
from tracking.state import CONSTANTS, Gaussian

ROUNDS = 30
"""Rounds of the search for the weights; each one comes closer."""


@dataclass(frozen=True, slots=True, eq=False)
class OdometryErrors:
    """Odometry's constant errors: what has to be added to its values."""

    wheel_scale_percent: float
    """By how much ways are longer than by odometry."""
    gyro_bias_deg_s: float
    """By how much the forklift turns faster to the left than by odometry, in degrees per second."""
    covariance: FloatArray
    """(2, 2) covariance of both, in these units."""
    tracks: int
    """How many tracks know something of them."""

    @property
    def wheel_scale_sigma_percent(self) -> float:
        """Standard deviation of the scale."""
        return math.sqrt(self.covariance[0, 0])

    @property
    def gyro_bias_sigma_deg_s(self) -> float:
        """Standard deviation of the bias, in degrees per second."""
        return math.sqrt(self.covariance[1, 1])


def odometry_errors(states: Sequence[Gaussian], config: TrackerConfig) -> OdometryErrors:
    """Take together what tracks know of odometry's constant errors.

    Parameters
    ----------
    states : sequence of Gaussian
        Of the tracks, all at the same time or not: the errors are constant.
    config : TrackerConfig
        With what was known before.

    Returns
    -------
    OdometryErrors
        What was known before where there are no tracks, or they do not estimate the errors.
    """
    sigmas = config.odometry.constants
    estimated = [i for i, sigma in enumerate(sigmas) if sigma > 0]
    mean, covariance = np.zeros(2), np.zeros((2, 2))
    used = states if config.estimate_odometry else ()
    if estimated:
        scale = sigmas[estimated]
        block = np.ix_(estimated, estimated)
        gains, weighted = _gains(used, estimated, scale)
        weights = _weights(gains)
        known = np.linalg.inv(np.eye(len(estimated)) + np.einsum("n,nab->ab", weights, gains))
        mean[estimated] = scale * (known @ (weights @ weighted))
        covariance[block] = known * np.outer(scale, scale)
    units = np.array([100.0, math.degrees(1.0)])
    percent, bias = (float(value) for value in units * mean)
    return OdometryErrors(percent, bias, covariance * np.outer(units, units), len(used))


def _gains(states: Sequence[Gaussian], estimated: list[int], scale: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the tracks' (n, k, k) information beyond the prior and (n, k) vectors of it, in units of the prior."""
    size = len(estimated)
    gains, weighted = np.zeros((len(states), size, size)), np.zeros((len(states), size))
    for i, state in enumerate(states):
        own = state.covariance[CONSTANTS, CONSTANTS][np.ix_(estimated, estimated)] / np.outer(scale, scale)
        information = np.linalg.inv(own)
        weighted[i] = information @ (state.mean[CONSTANTS][estimated] / scale)
        values, vectors = np.linalg.eigh(information - np.eye(size))
        gains[i] = (vectors * np.maximum(values, 0.0)) @ vectors.T  # rounding may leave less than the prior
    return gains, weighted


def _weights(gains: FloatArray) -> FloatArray:
    """Return the weights, of sum 1, that make the information's determinant largest.

    The multiplicative rounds of optimal design: each weight grows with what its gain adds (Titterington, Optimal
    design, some geometrical aspects of D-optimality, 1975).
    """
    count = len(gains)
    if count == 0:
        return np.zeros(0)
    weights = np.full(count, 1 / count)
    prior = np.eye(gains.shape[1])
    for _ in range(ROUNDS):
        covariance = np.linalg.inv(prior + np.einsum("n,nab->ab", weights, gains))
        slopes = np.einsum("ab,nba->n", covariance, gains)
        total = float(weights @ slopes)
        if total <= 0:
            break
        weights = weights * slopes / total
    return weights
