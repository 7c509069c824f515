"""Which observation of a shot belongs to which track: the cheapest of all assignments."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cached_property
from itertools import groupby
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from palletloc.geometry import BoolArray, FloatArray
from tracking.config import GateConfig
from tracking.filter import Innovation, PalletFilter
from tracking.gate import chi_square_limit, covariance_scale
from tracking.observation import Observation
from tracking.state import COMMON
from tracking.track import Track

FORBIDDEN = 1e9
"""Cost of a pair outside the gate."""
FEW = 4
"""Pairs that are compared without a look at how far they are apart."""


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


class Comparison:
    """Tracks as a shot finds them beside its observations; remembers what was compared while more of them come.

    Parameters
    ----------
    tracks : sequence of Track
        Predicted to the time of the shot.
    engine : PalletFilter
        Compares them.
    config : GateConfig
        The gate.
    """

    def __init__(self, tracks: Sequence[Track], engine: PalletFilter, config: GateConfig) -> None:
        self.tracks = tuple(tracks)
        self._engine = engine
        self._config = config
        self._known: dict[str, dict[int, Pairing]] = {}

    @cached_property
    def _scales(self) -> list[float]:
        return [covariance_scale(track.ratios, self._config) for track in self.tracks]

    @cached_property
    def _models(self) -> NDArray[np.object_]:
        return np.array([track.model for track in self.tracks], dtype=object)

    @cached_property
    def _places(self) -> FloatArray:
        return np.array([track.state.mean[:3] for track in self.tracks]).reshape(-1, 3)

    @cached_property
    def _variances(self) -> FloatArray:
        return np.array([_place_variance(track.state.covariance) for track in self.tracks])

    @cached_property
    def _shared(self) -> FloatArray:
        means = np.array([track.state.mean for track in self.tracks])[:, COMMON]
        return np.asarray((means**2).sum(axis=1))

    def pairings(self, observations: Sequence[Observation]) -> list[dict[int, Pairing]]:
        """Return for each observation how it compares with the tracks that it may belong to.

        Pairs that are too far apart to pass the gate are left out.
        """
        fresh = [one for one in observations if one.order not in self._known]
        if fresh:
            self._compare(self._near(fresh))
            for one in fresh:
                self._known.setdefault(one.order, {})
        return [self._known[one.order] for one in observations]

    def pairing(self, observation: Observation, track: int) -> Pairing | None:
        """Return how an observation compares with a track however far it is; None where it cannot belong to it."""
        if observation.model != self.tracks[track].model:
            return None
        known = self._known.setdefault(observation.order, {})
        if track not in known:
            self._compare([(observation, track)])
        return known[track]

    def nearest(self, observation: Observation) -> int | None:
        """Return the track of an observation's model that it fits best, however badly; None where all are too far."""
        possible = self._possible_of(observation)
        self._compare([(observation, j) for j in possible])
        known = self._known.get(observation.order, {})
        return min(possible, key=lambda j: known[j].innovation.distance, default=None)

    def _near(self, observations: Sequence[Observation]) -> list[tuple[Observation, int]]:
        """Return the pairs of observations and tracks that may pass the gate.

        The Mahalanobis distance is at least that of the place alone, and that at least the squared distance over the
        trace of its covariance.
        """
        if len(observations) * len(self.tracks) <= FEW:  # comparing them is as cheap
            return [(one, j) for one in observations for j in self._possible_of(one)]
        possible, away = self._possible(observations)
        placed = np.array([one.place is not None and one.components[:3] == (0, 1, 2) for one in observations])
        stated = np.array([_place_variance(one.covariance) for one in observations])
        shared = np.array([np.vdot(one.common, one.common) for one in observations])
        limits = np.array([self._limit(one) for one in observations])
        scales = np.array(self._scales)
        moved = np.sqrt(shared[:, None] * (scales * self._shared))
        spread = 2 * (self._variances + scales * stated[:, None])
        near = possible & ((np.maximum(away - moved, 0.0) ** 2 <= limits[:, None] * spread) | ~placed[:, None])
        return [(observations[i], j) for i, j in zip(*(at.tolist() for at in np.nonzero(near)), strict=True)]

    def _possible(self, observations: Sequence[Observation]) -> tuple[BoolArray, FloatArray]:
        """Return which tracks are of the observations' models and not too far, and how far they are.

        Where an observation is only said to be near some place, it may belong to the nearest track alone.
        """
        placed = np.array([one.place is not None for one in observations])
        places = np.array([one.place or (0.0, 0.0, 0.0) for one in observations])
        away = self._places - places[:, None]
        distances = np.sqrt((away * away).sum(axis=2))
        alike = np.array([one.model for one in observations], dtype=object)[:, None] == self._models
        possible = alike.astype(np.bool_) & ((distances <= self._config.max_distance_m) | ~placed[:, None])
        for i, one in enumerate(observations):
            if one.place is not None and one.components[:3] != (0, 1, 2) and possible[i].any():
                nearest = np.where(possible[i], distances[i], np.inf).argmin()
                possible[i] = np.arange(len(self.tracks)) == nearest
        return possible, distances

    def _possible_of(self, observation: Observation) -> list[int]:
        """Return the same of a single observation."""
        alike = [j for j, track in enumerate(self.tracks) if track.model == observation.model]
        if observation.place is None:
            return alike
        away = [math.dist(self.tracks[j].state.mean[:3].tolist(), observation.place) for j in alike]
        possible = [(far, j) for far, j in zip(away, alike, strict=True) if far <= self._config.max_distance_m]
        if observation.components[:3] != (0, 1, 2):
            possible = [min(possible)] if possible else []
        return [j for _, j in possible]

    def _limit(self, observation: Observation) -> float:
        return chi_square_limit(self._config.probability, len(observation.components))

    def _compare(self, pairs: Sequence[tuple[Observation, int]]) -> None:
        for _, alike in groupby(pairs, key=lambda pair: pair[0].components):
            group = list(alike)
            observations = [one for one, _ in group]
            scales = [self._scales[j] for _, j in group]
            found = self._engine.innovations([self.tracks[j].state for _, j in group], observations, scales)
            limit = self._limit(observations[0])
            for (one, j), innovation, scale in zip(group, found, scales, strict=True):
                self._known.setdefault(one.order, {})[j] = Pairing(innovation, scale, limit)


def _place_variance(covariance: FloatArray) -> float:
    return math.fsum(covariance.diagonal().tolist()[:3])


def assign(comparison: Comparison, observations: Sequence[Observation]) -> dict[int, tuple[int, Pairing]]:
    """Assign observations to tracks by the Hungarian method.

    The cost of a pair is NIS + ln|S|, minus twice the logarithm of its likelihood: without the second part, a
    track that knows little would draw the measurements of its neighbours.

    Parameters
    ----------
    comparison : Comparison
        The tracks.
    observations : sequence of Observation
        Of the shot.

    Returns
    -------
    dict
        Track of each observation, by their indices, and how they compare: each at most once, only inside the gate.
    """
    rows = comparison.pairings(observations)
    passing = {(i, j): one for i, row in enumerate(rows) for j, one in row.items() if one.passes}
    if not passing:
        return {}
    if len(passing) == 1:
        ((i, j), one) = next(iter(passing.items()))
        return {i: (j, one)}
    cost = np.full((len(observations), len(comparison.tracks)), FORBIDDEN)
    for pair, one in passing.items():
        cost[pair] = one.innovation.distance + one.innovation.log_volume
    found = zip(*(indices.tolist() for indices in linear_sum_assignment(cost)), strict=True)
    return {i: (j, passing[i, j]) for i, j in found if (i, j) in passing}
