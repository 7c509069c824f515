"""Which observation of a shot belongs to which track: the cheapest of all assignments."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.optimize import linear_sum_assignment

from tracking.config import GateConfig
from tracking.filter import Innovation, PalletFilter
from tracking.gate import chi_square_limit, covariance_scale
from tracking.observation import Observation
from tracking.track import Track

FORBIDDEN = 1e9
"""Cost of a pair outside the gate."""


class Pairing(NamedTuple):
    """An observation beside a track."""

    innovation: Innovation
    """How far they are apart."""
    scale: float
    """Factor on the observation's covariance that the track's innovations ask for."""
    limit: float
    """Up to which distance they may belong together."""

    @property
    def passes(self) -> bool:
        """Whether they may belong together."""
        return self.innovation.distance <= self.limit


class Assignment(NamedTuple):
    """Tracks and observations of a shot that belong together."""

    pairs: dict[int, int]
    """Track of each observation, by their indices."""
    pairings: dict[tuple[int, int], Pairing]
    """All pairs that were compared: (observation, track)."""


def assign(
    tracks: Sequence[Track], observations: Sequence[Observation], engine: PalletFilter, config: GateConfig
) -> Assignment:
    """Assign observations to tracks by the Hungarian method.

    The cost of a pair is NIS + ln|S|, minus twice the logarithm of its likelihood: without the second part, a
    track that knows little would draw the measurements of its neighbours.

    Parameters
    ----------
    tracks : sequence of Track
        Predicted to the time of the shot.
    observations : sequence of Observation
        Of the shot.
    engine : PalletFilter
        Compares them.
    config : GateConfig
        The gate.

    Returns
    -------
    Assignment
        Each track and each observation at most once, only pairs inside the gate.
    """
    pairings = {
        (i, j): _pairing(track, observation, engine, config)
        for i, observation in enumerate(observations)
        for j, track in enumerate(tracks)
        if _comparable(track, observation, config)
    }
    passing = {pair: one for pair, one in pairings.items() if one.passes}
    if not passing:
        return Assignment({}, pairings)
    cost = np.full((len(observations), len(tracks)), FORBIDDEN)
    for pair, one in passing.items():
        cost[pair] = one.innovation.distance + one.innovation.log_volume
    rows, columns = linear_sum_assignment(cost)
    found = zip(rows.tolist(), columns.tolist(), strict=True)
    pairs = {i: j for i, j in found if (i, j) in passing}
    return Assignment(pairs, pairings)


def _comparable(track: Track, observation: Observation, config: GateConfig) -> bool:
    if observation.model != track.model:
        return False
    if observation.place is None:
        return True
    x, y, z = observation.place
    mean = track.state.mean
    return math.hypot(mean[0] - x, mean[1] - y, mean[2] - z) <= config.max_distance_m


def _pairing(track: Track, observation: Observation, engine: PalletFilter, config: GateConfig) -> Pairing:
    scale = covariance_scale(track.ratios, config)
    limit = chi_square_limit(config.probability, len(observation.components))
    return Pairing(engine.innovation(track.state, observation, scale), scale, limit)
