"""Which measurement of a shot belongs to which track, and which pallets stand in each other's place."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.optimize import linear_sum_assignment

from palletloc.footprint import outline, overlaps
from palletloc.geometry import BoolArray, FloatArray
from palletloc.pallet import PalletModel
from palletloc.pallet_library import load_library
from tracking.config import GateConfig
from tracking.filter import GroupFilter
from tracking.gating import Association, chi_square_limit, covariance_scale, huber_weight
from tracking.observation import Observation
from tracking.state import COMMON, SIZE, IntArray
from tracking.track import Track

FORBIDDEN = 1e9
"""Cost of a pair outside the gate: more than any pair inside it can cost."""
FEW = 4
"""Pairs up to which comparing all is as cheap as finding those that are near."""
UNSURE = 3.0
"""Standard deviations by which heights may be off: an error beyond it is rare, one pallet above another is not."""


class Comparison:
    """Compares the predicted tracks with the observations of a shot; keeps the results while more observations come.

    Parameters
    ----------
    tracks : sequence of Track
        Predicted to the time of the shot.
    group_filter : GroupFilter
        Compares them.
    config : GateConfig
        The gate.
    """

    def __init__(self, tracks: Sequence[Track], group_filter: GroupFilter, config: GateConfig) -> None:
        self.tracks = tuple(tracks)
        self._filter = group_filter
        self._config = config
        self._limits = [0.0, *(chi_square_limit(config.probability, dof) for dof in range(1, 5))]
        """The gate by the numbers in a measurement."""
        self._known: dict[str, dict[int, Association]] = {}

    @cached_property
    def _scales(self) -> list[float]:
        return [covariance_scale(track.ratios, self._config) for track in self.tracks]

    @cached_property
    def _models(self) -> tuple[dict[str, int], IntArray]:
        """Return numbers of the models, and those of the tracks."""
        numbers = {model: i for i, model in enumerate(dict.fromkeys(track.model for track in self.tracks))}
        return numbers, np.array([numbers[track.model] for track in self.tracks], dtype=np.intp)

    @cached_property
    def _means(self) -> FloatArray:
        return np.array([track.state.mean for track in self.tracks]).reshape(-1, SIZE)

    @cached_property
    def _variances(self) -> FloatArray:
        """(n,) sums of the variances of the tracks' places."""
        covariances = np.array([track.state.covariance for track in self.tracks]).reshape(-1, SIZE, SIZE)
        return np.asarray(np.einsum("nii->n", covariances[:, :3, :3]))

    def associations(self, observations: Sequence[Observation]) -> list[dict[int, Association]]:
        """Return for each observation how it compares with the tracks that it may belong to.

        Pairs that are too far from each other to pass the gate are left out.
        """
        fresh = [observation for observation in observations if observation.order not in self._known]
        if fresh:
            for observation, track in self._near(fresh):
                self._compare(observation, track)
            for observation in fresh:
                self._known.setdefault(observation.order, {})
        return [self._known[observation.order] for observation in observations]

    def association(self, observation: Observation, track: int) -> Association | None:
        """Return how an observation compares with a track however far it is; None where it cannot belong to it."""
        if observation.model != self.tracks[track].model:
            return None
        known = self._known.setdefault(observation.order, {})
        return known[track] if track in known else self._compare(observation, track)

    def nearest(self, observation: Observation) -> int | None:
        """Return the track of an observation's model that it fits best, however badly; None where all are too far."""
        possible = {track: self._compare(observation, track) for track in self._possible_of(observation)}
        return min(possible, key=lambda track: possible[track].distance, default=None)

    def _near(self, observations: Sequence[Observation]) -> list[tuple[Observation, int]]:
        """Return the pairs of observations and tracks that may pass the gate.

        The Mahalanobis distance is at least that of the place alone, and that at least the squared distance over the
        trace of its covariance.
        """
        if len(observations) * len(self.tracks) <= FEW:
            return [(observation, j) for observation in observations for j in self._possible_of(observation)]
        possible, distances = self._possible(observations)
        placed = np.array([each.place is not None and each.components[:3] == (0, 1, 2) for each in observations])
        stated = np.array([each.place_variance for each in observations])
        common = np.array([each.common_variance for each in observations])
        limits = np.array([self._limits[len(each.components)] for each in observations])
        scales = np.array(self._scales)
        shared = (self._means[:, COMMON] ** 2).sum(axis=1)
        moved = np.sqrt(common[:, None] * (scales * shared))
        spread = 2 * (self._variances + scales * stated[:, None])
        reach = np.maximum(distances - moved, 0.0) ** 2 <= limits[:, None] * spread
        rows, columns = np.nonzero(possible & (reach | ~placed[:, None]))
        return [(observations[i], j) for i, j in zip(rows.tolist(), columns.tolist(), strict=True)]

    def _possible(self, observations: Sequence[Observation]) -> tuple[BoolArray, FloatArray]:
        """Return which tracks are of the observations' models and not too far, and how far they are.

        Where an observation is only said to be near some place, it may belong to the nearest track alone.
        """
        placed = np.array([each.place is not None for each in observations])
        places = np.array([each.place or (0.0, 0.0, 0.0) for each in observations])
        offsets = self._means[:, :3] - places[:, None]
        distances = np.sqrt((offsets * offsets).sum(axis=2))
        numbers, of_tracks = self._models
        same_model = np.array([numbers.get(each.model, -1) for each in observations])[:, None] == of_tracks
        possible = same_model & ((distances <= self._config.max_distance_m) | ~placed[:, None])
        for i, observation in enumerate(observations):
            vague = observation.place is not None and observation.components[:3] != (0, 1, 2)
            if vague and possible[i].any():
                nearest = np.where(possible[i], distances[i], np.inf).argmin()
                possible[i] = np.arange(len(self.tracks)) == nearest
        return possible, distances

    def _possible_of(self, observation: Observation) -> list[int]:
        """Return the same of a single observation."""
        same_model = [j for j, track in enumerate(self.tracks) if track.model == observation.model]
        place = observation.place
        if place is None:
            return same_model
        distances = [(math.dist(self.tracks[j].state.mean[:3].tolist(), place), j) for j in same_model]
        possible = [(distance, j) for distance, j in distances if distance <= self._config.max_distance_m]
        if observation.components[:3] != (0, 1, 2):
            possible = [min(possible)] if possible else []
        return [j for _, j in possible]

    def _compare(self, observation: Observation, track: int) -> Association:
        scale = self._scales[track]
        distance, log_volume = self._filter.innovation(self.tracks[track].state, observation, scale)
        dof = len(observation.components)
        weight = huber_weight(distance, dof, self._config)
        found = Association(observation, scale, weight, distance, log_volume, self._limits[dof])
        self._known.setdefault(observation.order, {})[track] = found
        return found


def assign(comparison: Comparison, observations: Sequence[Observation]) -> dict[int, tuple[int, Association]]:
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
    rows = comparison.associations(observations)
    passing = {(i, j): pair for i, row in enumerate(rows) for j, pair in row.items() if pair.passes}
    if not passing:
        return {}
    if len(passing) == 1:
        ((i, j), pair) = next(iter(passing.items()))
        return {i: (j, pair)}
    cost = np.full((len(observations), len(comparison.tracks)), FORBIDDEN)
    for place, pair in passing.items():
        cost[place] = pair.distance + pair.log_volume
    found = zip(*(indices.tolist() for indices in linear_sum_assignment(cost)), strict=True)
    return {i: (j, passing[i, j]) for i, j in found if (i, j) in passing}


class Standing(NamedTuple):
    """A pallet that stands somewhere."""

    pose: FloatArray
    """(4,) x, y, z and yaw, in metres and radians."""
    covariance: FloatArray
    """(4, 4) or larger: its covariance."""
    model: str
    """Name of the pallet model."""


class Footprints:
    """Sizes of the pallets that may be measured.

    Parameters
    ----------
    models : iterable of PalletModel, optional
        The pallets of the site: others are rejected. If left out, the library's sizes are used and any name is
        taken.
    """

    def __init__(self, models: Iterable[PalletModel] | None = None) -> None:
        self._strict = models is not None
        self._models = load_library() if models is None else {model.name: model for model in models}
        self._outlines = {name: outline(model) for name, model in self._models.items()}
        self._smallest = outline(min(load_library().values(), key=lambda model: model.width))

    @property
    def names(self) -> tuple[str, ...]:
        """TrackNumbers of the known models."""
        return tuple(self._models)

    def accepts(self, model: str) -> bool:
        """Tell whether measurements of a model are taken."""
        return not self._strict or model in self._models

    def same_place(self, pallet: Standing, others: Sequence[Standing]) -> BoolArray:
        """Tell which pallets would stand in another one: at most one of them is there.

        Parameters
        ----------
        pallet : Standing
            A pallet.
        others : sequence of Standing
            The others.

        Returns
        -------
        (n,) array of bool
            Whether it stands in each of them.
        """
        poses, outlines, variances = self._stacked((pallet, *others))
        return _overlap(poses, outlines, variances, np.zeros(len(others), dtype=np.intp), np.arange(len(others)) + 1)

    def sharing(self, pallets: Sequence[Standing]) -> list[tuple[int, int]]:
        """Return the pairs of pallets that stand in each other."""
        if len(pallets) < 2:
            return []
        poses, outlines, variances = self._stacked(pallets)
        width, height, depth = outlines.max(axis=0)
        floor, heights = poses[:, :2], poses[:, 2]
        squares = (floor * floor).sum(axis=1)
        squared_distances = squares[:, None] + squares - 2 * floor @ floor.T
        reach = height + UNSURE * math.sqrt(2 * variances.max())
        near = (squared_distances < 1.001 * (width**2 + depth**2)) & (np.abs(heights[:, None] - heights) < reach)
        first, second = np.nonzero(np.triu(near, 1))
        found = _overlap(poses, outlines, variances, first, second)
        return list(zip(first[found].tolist(), second[found].tolist(), strict=True))

    def _stacked(self, pallets: Sequence[Standing]) -> tuple[FloatArray, FloatArray, FloatArray]:
        poses = np.array([pallet.pose for pallet in pallets])
        models = [pallet.model for pallet in pallets]
        outlines = np.array([self._outlines.get(model, self._smallest) for model in dict.fromkeys(models)])
        if len(outlines) > 1:
            outlines = np.array([self._outlines.get(model, self._smallest) for model in models])
        outlines = np.broadcast_to(outlines, (len(models), 3))
        return poses, outlines, np.array([pallet.covariance[2, 2] for pallet in pallets])


def _overlap(
    poses: FloatArray, outlines: FloatArray, variances: FloatArray, first: IntArray, second: IntArray
) -> BoolArray:
    """Tell which pairs stand in each other at the heights, within their errors, that are nearest to each other.

    A pallet is low: an error of a few centimetres would put one above itself.
    """
    others = poses[second]
    up = others[:, 2] - poses[first, 2]
    unsure = UNSURE * np.sqrt(variances[first] + variances[second])
    others[:, 2] = poses[first, 2] + np.sign(up) * np.maximum(np.abs(up) - unsure, 0.0)
    # seen from either of them: they may be turned against each other
    seen = overlaps(poses[first], outlines[first], others, outlines[second])
    return seen | overlaps(others, outlines[second], poses[first], outlines[first])
