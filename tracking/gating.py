"""Whether a measurement may belong to a track, and how much it counts."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

from scipy.special import gammaincinv

from tracking.config import GateConfig
from tracking.observation import Observation


class Association(NamedTuple):
    """A measurement with the track that it may belong to."""

    observation: Observation
    """The measurement."""
    scale: float = 1.0
    """Factor on its covariance that the track's earlier innovations ask for."""
    weight: float = 1.0
    """How much it counts, up to 1: a robust weight."""
    distance: float = 0.0
    """Squared Mahalanobis distance from the track, before the measurement."""
    log_volume: float = 0.0
    """Logarithm of the determinant of the innovation's covariance."""
    limit: float = math.inf
    """The gate: the largest distance at which they may belong together."""

    @property
    def passes(self) -> bool:
        """Whether they may belong together."""
        return self.distance <= self.limit


@lru_cache(maxsize=256)
def chi_square_limit(probability: float, dof: int) -> float:
    """Return what a chi-square variable stays below with a probability.

    Parameters
    ----------
    probability : float
        Between 0 and 1.
    dof : int
        Degrees of freedom.

    Examples
    --------
    >>> round(chi_square_limit(0.99, 4), 2)
    13.28
    """
    return float(2 * gammaincinv(dof / 2, probability))


@lru_cache(maxsize=256)
def _mean_band(probability: float, dof: int, count: int) -> tuple[float, float]:
    """Return between what the mean of chi-square variables over their degrees of freedom is with a probability.

    Parameters
    ----------
    probability : float
        Between 0 and 1; above the band and below it is half of the rest each.
    dof : int
        Degrees of freedom of each variable.
    count : int
        How many there are.
    """
    outside, total = (1 - probability) / 2, dof * count
    return chi_square_limit(outside, total) / total, chi_square_limit(1 - outside, total) / total


def huber_weight(distance: float, dof: int, config: GateConfig) -> float:
    """Return how much a measurement counts: 1 for ordinary ones, less the farther off it is.

    Huber's weight of the Mahalanobis distance (Huber, Robust Statistics, 1981, section 8.4).

    Parameters
    ----------
    distance : float
        Squared Mahalanobis distance.
    dof : int
        Numbers in the measurement.
    config : GateConfig
        With the part of measurements that counts in full.
    """
    limit = chi_square_limit(config.robust_probability, dof)
    return 1.0 if distance <= limit else float((limit / distance) ** 0.5)


def covariance_scale(ratios: Sequence[float], config: GateConfig) -> float:
    """Return by what factor measurements' covariances are wrong, as their innovations say.

    The mean of n normalised innovations squared over their degrees of freedom is 1 where covariances are honest,
    and a chi-square variable of 4 n degrees over 4 n. Within its band nothing is changed. Large innovations are
    believed early, before the gate shuts good measurements out; small ones only when the window is full, because
    measurements with a common error agree with each other, too.

    Parameters
    ----------
    ratios : sequence of float
        Normalised innovation squared over its degrees of freedom, of the last measurements, each times the factor
        that its covariance had: where the factor is right, that is its mean.
    config : GateConfig
        The window, and bounds of the factor.

    Returns
    -------
    float
        Between the bounds; 1 where there is nothing to change.
    """
    last = ratios[-config.adapt_over :] if config.adapt_over > 0 else ()
    count = len(last)
    if count < config.adapt_from or count == 0:
        return 1.0
    mean = sum(last) / count
    low, high = _mean_band(config.adapt_probability, 4, count)
    if mean > high:
        return min(mean, config.max_scale)
    if mean < low and count == config.adapt_over:
        return max(mean, config.min_scale)
    return 1.0
