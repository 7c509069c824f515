"""What is known of several pallets together.

All pallets are seen from one forklift: what odometry gets wrong between two shots moves all of them alike. Pallets
that share one estimate tell each other of it. The state of m pallets is

============ ====================================================================================
0 - 9        the first pallet's state (`tracking.state`), with the odometry's constants in 4 and 5
10 i, ...    for each further pallet eight numbers: x, y, z, yaw, and what its measurements share
============ ====================================================================================

with one covariance over all of it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from palletloc.geometry import FloatArray
from tracking.state import COMMON, CONSTANTS, POSE, SIZE, Gaussian
from tracking.track import Key

IntArray = NDArray[np.intp]

FURTHER = SIZE - (CONSTANTS.stop - CONSTANTS.start)
"""Numbers that each further pallet adds to the state."""


@dataclass(frozen=True, slots=True, eq=False)
class Foretold:
    """How a step found pallets, before its measurements."""

    keys: tuple[Key, ...]
    """Names of the pallets' tracks."""
    state: Gaussian
    """What was expected of them."""
    F: FloatArray
    """(n, n) its derivative by the state before."""


@dataclass(frozen=True, slots=True, eq=False)
class Joint:
    """Pallets that share one estimate; a value that is never changed."""

    keys: tuple[Key, ...]
    """Names of their tracks."""
    state: Gaussian
    """What is known of them: (n,) and (n, n), n = 2 + 8 m."""
    members: tuple[Gaussian, ...]
    """What is known of each alone."""
    foretold: Foretold | None = None
    """How the last step found them; None where they began there."""
    carried: tuple[Key, ...] = ()
    """Tracks that were carried through the last step; the others began in it."""


@lru_cache(maxsize=64)
def places_of(count: int) -> IntArray:
    """Return where the states of single pallets are in the state of several.

    Parameters
    ----------
    count : int
        How many there are.

    Returns
    -------
    (m, 10) array of int
        Indices of x, y, z, yaw, the two constants, and the four shared errors.
    """
    places = np.tile(np.arange(SIZE), (count, 1))
    further = FURTHER * np.arange(1, count)[:, None] + 2
    places[1:, POSE] = further + np.arange(4)
    places[1:, COMMON] = further + np.arange(4, 8)
    places.flags.writeable = False
    return places


def size_of(count: int) -> int:
    """Return how many numbers the state of several pallets has."""
    return SIZE + FURTHER * (count - 1)


def members_of(means: FloatArray, covariances: FloatArray, count: int) -> list[tuple[Gaussian, ...]]:
    """Return what is known of pallets alone.

    Parameters
    ----------
    means, covariances : (k, n), (k, n, n) array
        What is known of them together.
    count : int
        Of how many each.
    """
    places = places_of(count)
    own = covariances[:, places[:, :, None], places[:, None, :]]
    return [tuple(map(Gaussian, *ones)) for ones in zip(means[:, places], own, strict=True)]


def joint_of(
    keys: tuple[Key, ...], state: Gaussian, foretold: Foretold | None = None, carried: tuple[Key, ...] = ()
) -> Joint:
    """Return an estimate; the members' states are taken from that of all."""
    mean, covariance = state
    (members,) = ((state,),) if len(keys) == 1 else members_of(mean[None], covariance[None], len(keys))
    return Joint(keys, state, members, foretold, carried)


def alone(key: Key, state: Gaussian) -> Joint:
    """Return the estimate of a pallet that shares it with none."""
    return Joint((key,), state, (state,))


def kept(joint: Joint, keys: Sequence[Key]) -> Joint:
    """Return the estimate of some of its pallets, at least one; what the others have told remains.

    Parameters
    ----------
    joint : Joint
        Of all of them.
    keys : sequence of Key
        Those that stay, in the order in which they shall be.
    """
    if tuple(keys) == joint.keys:
        return joint
    wanted = picked(joint.keys, keys)
    mean, covariance = joint.state
    carried = tuple(key for key in joint.carried if key in keys)
    return joint_of(tuple(keys), Gaussian(mean[wanted], covariance[np.ix_(wanted, wanted)]), joint.foretold, carried)


def picked(keys: Sequence[Key], wanted: Sequence[Key]) -> IntArray:
    """Return the indices, in the state of all, of the state of some.

    Parameters
    ----------
    keys : sequence of Key
        All of them.
    wanted : sequence of Key
        Some of them, at least one.
    """
    places = places_of(len(keys))
    rows = [places[keys.index(key)] for key in wanted]
    return np.concatenate([rows[0], *(row[[0, 1, 2, 3, 6, 7, 8, 9]] for row in rows[1:])])


def joined(joint: Joint, key: Key, state: Gaussian) -> Joint:
    """Return an estimate with one more pallet, of which the others know nothing.

    Parameters
    ----------
    joint : Joint
        Of the others.
    key : Key
        The track.
    state : Gaussian
        Its state alone; what it knows of the odometry is left out.
    """
    mean, covariance = joint.state
    size = len(mean)
    own = np.r_[POSE, COMMON]
    both = np.zeros((size + FURTHER, size + FURTHER))
    both[:size, :size] = covariance
    both[size:, size:] = state.covariance[np.ix_(own, own)]
    together = Gaussian(np.concatenate((mean, state.mean[own])), both)
    return joint_of((*joint.keys, key), together, joint.foretold, joint.carried)


def renewed(joint: Joint, key: Key, state: Gaussian) -> Joint:
    """Return an estimate in which one pallet began anew; `joined` and `kept` say what that means."""
    others = [one for one in joint.keys if one != key]
    return joined(kept(joint, others), key, state) if others else alone(key, state)


def regrouped(
    joints: Sequence[Joint], began: Sequence[tuple[Key, Gaussian]], alive: set[Key], most: int
) -> list[Joint]:
    """Return estimates after tracks have ended, begun and begun anew.

    Parameters
    ----------
    joints : sequence of Joint
        After a shot.
    began : sequence of (Key, Gaussian)
        Tracks that began in it, or began anew.
    alive : set of Key
        All tracks that live on.
    most : int
        How many tracks share an estimate at most.

    Returns
    -------
    list of Joint
        A new track goes to the first estimate that has room.
    """
    if sum(len(joint.keys) for joint in joints) == len(alive) and not began:
        return list(joints)
    living = [(joint, [key for key in joint.keys if key in alive]) for joint in joints]
    found = [kept(joint, keys) for joint, keys in living if keys]
    for key, state in began:
        if key not in alive:
            continue
        at = next((i for i, one in enumerate(found) if key in one.keys), None)
        if at is not None:
            found[at] = renewed(found[at], key, state)
            continue
        at = next((i for i, one in enumerate(found) if len(one.keys) < most), None)
        if at is None:
            found.append(alone(key, state))
        else:
            found[at] = joined(found[at], key, state)
    return found
