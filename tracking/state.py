"""What is known of pallets that share one estimate.

The forklift sees all of its pallets, so what odometry gets wrong between two shots moves all of them in the same
way. The measurements of one pallet of a group correct the others. The state of one pallet alone is

====== =========================================================================================
0 - 3  x, y, z in metres and yaw in radians: ``forklift_from_pallet``
4      the wheels' relative scale error
5      the rate that the gyroscope misses, in rad/s
6 - 9  the error that this pallet's measurements share, in units of its standard deviation
====== =========================================================================================

Each further pallet of a group adds eight numbers behind it: x, y, z, yaw, and its own shared error. The odometry's
two constants are there once, so the state of m pallets has 2 + 8 m numbers, with one covariance over all of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from palletloc.geometry import FloatArray

IntArray = NDArray[np.intp]
"""Indices."""
SIZE = 10
"""Numbers in the state of one pallet."""
POSE, CONSTANTS, COMMON = slice(0, 4), slice(4, 6), slice(6, 10)
"""Where the parts of the state of one pallet are."""
OWN = np.r_[POSE, COMMON]
"""Where the numbers of that state are that belong to the pallet: all but the odometry's constants."""


class Gaussian(NamedTuple):
    """What is known of a state."""

    mean: FloatArray
    """(n,) the state."""
    covariance: FloatArray
    """(n, n) its covariance."""


class Key(NamedTuple):
    """Names a track by its first measurement, whatever order the inputs came in."""

    time: float
    """When that was, in seconds."""
    birth: str
    """That measurement's `Observation.order`."""


@lru_cache(maxsize=64)
def places_of(count: int) -> IntArray:
    """Return where the states of single pallets are in the state of a group.

    Parameters
    ----------
    count : int
        How many pallets the group has, m.

    Returns
    -------
    (m, 10) array of int
        Indices of x, y, z, yaw, the two constants, and the four shared errors.
    """
    places = np.tile(np.arange(SIZE), (count, 1))
    further = SIZE + len(OWN) * np.arange(count - 1)[:, None]
    places[1:, POSE], places[1:, COMMON] = further + np.arange(4), further + np.arange(4, 8)
    places.flags.writeable = False
    return places


@lru_cache(maxsize=64)
def _blocks_of(count: int) -> IntArray:
    """Return (m, 10, 10) indices of the covariances of single pallets in that of a group, row by row."""
    places = places_of(count)
    blocks = places[:, :, None] * size_of(count) + places[:, None, :]
    blocks.flags.writeable = False
    return blocks


def size_of(count: int) -> int:
    """Return how many numbers the state of a group of pallets has."""
    return SIZE + len(OWN) * (count - 1)


def members_of(state: Gaussian) -> tuple[Gaussian, ...]:
    """Return what is known of each pallet of a group alone."""
    mean, covariance = state
    if len(mean) == SIZE:
        return (state,)
    count = 1 + (len(mean) - SIZE) // len(OWN)
    return tuple(map(Gaussian, mean.take(places_of(count)), covariance.take(_blocks_of(count))))


@dataclass(frozen=True, slots=True, eq=False)
class Predicted:
    """A group as a step predicted it, before the measurements of the step."""

    keys: tuple[Key, ...]
    """Names of its tracks."""
    state: Gaussian
    """The prediction."""
    F: FloatArray
    """(n, n) its derivative by the state before."""


@dataclass(frozen=True, slots=True, eq=False)
class TrackGroup:
    """Tracks that share one estimate; a value that never changes."""

    keys: tuple[Key, ...]
    """Names of the tracks, at least one."""
    state: Gaussian
    """What is known of them together: (n,) and (n, n), n = 2 + 8 m."""
    predicted: Predicted | None = None
    """The prediction of the last step; None where the group began in it."""
    carried: tuple[Key, ...] = ()
    """Tracks that the last step carried over; the others began in it."""

    @property
    def members(self) -> dict[Key, Gaussian]:
        """What is known of each track alone."""
        return dict(zip(self.keys, members_of(self.state), strict=True))

    def kept(self, keys: Sequence[Key]) -> TrackGroup:
        """Return the group of some of its tracks; what the others have taught of the odometry remains.

        Parameters
        ----------
        keys : sequence of Key
            Those that stay, at least one, in the order that they shall have.
        """
        if tuple(keys) == self.keys:
            return self
        places = self.places(keys)
        mean, covariance = self.state
        carried = tuple(key for key in self.carried if key in keys)
        state = Gaussian(mean[places], covariance[np.ix_(places, places)])
        return TrackGroup(tuple(keys), state, self.predicted, carried)

    def joined(self, key: Key, state: Gaussian) -> TrackGroup:
        """Return the group with one more track, of which the others know nothing.

        Parameters
        ----------
        key : Key
            The track.
        state : Gaussian
            Its state alone; what it knows of the odometry is left out.
        """
        mean, covariance = self.state
        size = len(mean)
        both = np.zeros((size + len(OWN), size + len(OWN)))
        both[:size, :size] = covariance
        both[size:, size:] = state.covariance[np.ix_(OWN, OWN)]
        together = Gaussian(np.concatenate((mean, state.mean[OWN])), both)
        return TrackGroup((*self.keys, key), together, self.predicted, self.carried)

    def renewed(self, key: Key, state: Gaussian) -> TrackGroup:
        """Return the group in which one track began anew: it leaves, and joins again in another state."""
        others = [other for other in self.keys if other != key]
        return self.kept(others).joined(key, state) if others else TrackGroup((key,), state)

    def places(self, keys: Sequence[Key]) -> IntArray:
        """Return the indices of the state of some of the tracks, at least one, in that of all."""
        return places_among(self.keys, keys)


def places_among(keys: Sequence[Key], wanted: Sequence[Key]) -> IntArray:
    """Return the indices, in the state of a group, of the state of some of its tracks.

    Parameters
    ----------
    keys : sequence of Key
        All tracks of the group.
    wanted : sequence of Key
        Some of them, at least one.
    """
    places = places_of(len(keys))
    first, *others = (places[keys.index(key)] for key in wanted)
    return np.concatenate([first, *(place[OWN] for place in others)])


def regrouped(
    groups: Sequence[TrackGroup], began: Sequence[tuple[Key, Gaussian]], alive: set[Key], most: int
) -> list[TrackGroup]:
    """Return the groups after tracks have ended, begun and begun anew.

    Parameters
    ----------
    groups : sequence of TrackGroup
        After a shot.
    began : sequence of (Key, Gaussian)
        Tracks that began in it, or began anew.
    alive : set of Key
        All tracks that live on.
    most : int
        How many tracks a group has at most.

    Returns
    -------
    list of TrackGroup
        A new track goes to the first group that has room.
    """
    if sum(len(group.keys) for group in groups) == len(alive) and not began:
        return list(groups)
    living = [(group, [key for key in group.keys if key in alive]) for group in groups]
    found = [group.kept(keys) for group, keys in living if keys]
    for key, state in began:
        if key not in alive:
            continue
        known = next((i for i, group in enumerate(found) if key in group.keys), None)
        roomy = next((i for i, group in enumerate(found) if len(group.keys) < most), None)
        if known is not None:
            found[known] = found[known].renewed(key, state)
        elif roomy is not None:
            found[roomy] = found[roomy].joined(key, state)
        else:
            found.append(TrackGroup((key,), state))
    return found
