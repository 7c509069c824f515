"""Measurements of standing pallets from several shots, carried into one frame by odometry, with all their errors."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from palletloc.geometry import FloatArray
from tracking.motion import Motion
from tracking.state import Key

TINY = 1e-12
"""Variance added to steps of the random walk that have none, in m^2 and rad^2: far below that of any measurement."""


@dataclass(frozen=True, slots=True, eq=False)
class Sighting:
    """A measurement of a pallet, level and on the floor plan: x, y and yaw in the forklift frame."""

    pallet: Key
    """The track of the pallet."""
    pose: FloatArray
    """(3,) in metres and radians."""
    own: FloatArray
    """(3, 3) covariance of what is new in it."""
    common: FloatArray
    """(3, 4) what a unit of the error moves that the pallet's measurements share."""


@dataclass(frozen=True, slots=True, eq=False)
class LatencyShot:
    """A shot, how the forklift came there, and how it went just before and after."""

    time: float
    """In seconds."""
    motion: Motion
    """Since the shot before."""
    around: FloatArray
    """(trials, 3) where the forklift was when the stamp is late by each trial offset, in its frame at the stamp."""
    jitter: FloatArray
    """(3, 3) covariance of the odometry's noise per second just there."""
    sightings: tuple[Sighting, ...] = ()
    """The pallets in it."""
    rejected: tuple[Sighting, ...] = ()
    """Those that the gate of their track rejected: a large latency may be why."""


class ShotStack:
    """Sightings as arrays, carried into the forklift's frame at the first shot.

    Parameters
    ----------
    shots : sequence of LatencyShot
        All shots, in the order of time.
    chosen : sequence of (int, tuple of Sighting)
        Numbers of the shots that are compared, and which sightings in each.
    mended : (2,) array
        Odometry's constant errors, as far as they are known: wheel scale, and bias of the gyroscope in rad/s.
    """

    def __init__(
        self, shots: Sequence[LatencyShot], chosen: Sequence[tuple[int, tuple[Sighting, ...]]], mended: FloatArray
    ) -> None:
        way = _Way(shots, mended)
        self.mended = mended
        numbers = np.array([i for i, _ in chosen])
        self.shot = np.repeat(np.arange(len(chosen)), [len(sightings) for _, sightings in chosen])
        sightings = [sighting for _, several in chosen for sighting in several]
        pallets = {sighting.pallet: None for sighting in sightings}
        order = {pallet: j for j, pallet in enumerate(pallets)}
        self.pallet = np.array([order[sighting.pallet] for sighting in sightings])
        self.path = way.path[numbers][self.shot]
        stamped = way.poses[numbers]
        exposed = _composed(stamped[:, None], np.array([shots[i].around for i in numbers]))
        seen = np.array([sighting.pose for sighting in sightings])
        self.places = _composed(exposed[self.shot], seen[:, None])
        now = _composed(stamped[self.shot], seen)
        turn = _turns(stamped[self.shot, 2])
        self.own = turn @ np.array([sighting.own for sighting in sightings]) @ turn.transpose(0, 2, 1)
        self.common = turn @ np.array([sighting.common for sighting in sightings])
        self.lever = _levers(now)
        self.walk = np.diff(way.walk[numbers], axis=0, prepend=way.walk[numbers[:1]])
        self.constants = self.lever @ way.constants[numbers][self.shot]
        heading, place = _turns(stamped[:, 2]), _levers(-stamped)
        at_shot = place @ heading
        jitter = np.array([shots[i].jitter for i in numbers])
        self.jitter = at_shot @ jitter @ at_shot.transpose(0, 2, 1)

    def spread(self, covariances: FloatArray, reach: FloatArray) -> FloatArray:
        """Return the (3 m, 3 n) effect of independent errors of the n shots on the m sightings.

        Parameters
        ----------
        covariances : (n, 3, 3) array
            Of each shot's error: a motion about the frame's origin.
        reach : (m, n) array
            Which shots' errors move which sightings.
        """
        roots = np.linalg.cholesky(covariances + TINY * np.eye(3))
        parts = np.einsum("mn,mab,nbc->manc", reach, self.lever, roots, optimize=True)
        return np.asarray(parts.reshape(3 * len(self.shot), -1))

    def free(self, sigmas: FloatArray) -> FloatArray:
        """Return the (3 m, 3 p + 2) effect of the pallets' poses, and of odometry's constants in units of sigma."""
        count = int(self.pallet.max()) + 1
        pallets = np.einsum("mp,ab->mapb", np.eye(count)[self.pallet], np.eye(3))
        rows = 3 * len(self.shot)
        return np.hstack([pallets.reshape(rows, 3 * count), (-self.constants * sigmas).reshape(rows, 2)])

    def shared(self, fades_over: float) -> FloatArray:
        """Return the (3 m, 3 m) covariance of what a pallet's measurements share, and that fades along the way."""
        rows = self.common.reshape(-1, 4)
        distance = np.abs(self.path[:, None] - self.path)
        share = np.where(self.pallet[:, None] == self.pallet, np.exp(-distance / fades_over), 0.0)
        return np.asarray((rows @ rows.T) * np.repeat(np.repeat(share, 3, axis=0), 3, axis=1))

    def from_first(self) -> FloatArray:
        """Return the (3 m, trials) places against those of each pallet's first sighting, turns the short way."""
        _, first = np.unique(self.pallet, return_index=True)
        now = self.places.shape[1] // 2
        offsets = self.places - self.places[first[self.pallet], now][:, None]
        offsets[..., 2] = (offsets[..., 2] + math.pi) % (2 * math.pi) - math.pi
        return np.asarray(offsets.transpose(0, 2, 1).reshape(3 * len(offsets), -1))


class _Way:
    """How the forklift came to each shot, in its frame at the first one."""

    def __init__(self, shots: Sequence[LatencyShot], mended: FloatArray) -> None:
        motions = [shot.motion for shot in shots]
        constants = np.array([motion.constants for motion in motions])
        steps = np.array([motion.increment for motion in motions]) + constants @ mended
        steps[0] = 0.0
        heading = np.cumsum(steps[:, 2])
        before = heading - steps[:, 2]
        cos, sin = np.cos(before), np.sin(before)
        x = np.cumsum(cos * steps[:, 0] - sin * steps[:, 1])
        y = np.cumsum(sin * steps[:, 0] + cos * steps[:, 1])
        self.poses = np.stack([x, y, heading], axis=1)
        # a step's error as a motion about the origin: it turns by its turn, with the step's end standing still
        about = _levers(-self.poses) @ _turns(before)
        noise = np.array([motion.covariance for motion in motions])
        noise[0], constants[0] = 0.0, 0.0
        self.walk = np.cumsum(about @ noise @ about.transpose(0, 2, 1), axis=0)
        self.constants = np.cumsum(about @ constants, axis=0)
        self.path = np.cumsum([0.0, *(motion.path for motion in motions[1:])])


def _composed(first: FloatArray, second: FloatArray) -> FloatArray:
    """Return planar poses one after the other."""
    cos, sin = np.cos(first[..., 2]), np.sin(first[..., 2])
    return np.stack(
        [
            first[..., 0] + cos * second[..., 0] - sin * second[..., 1],
            first[..., 1] + sin * second[..., 0] + cos * second[..., 1],
            first[..., 2] + second[..., 2],
        ],
        axis=-1,
    )


def _turns(angles: FloatArray) -> FloatArray:
    """Return (n, 3, 3) matrices that turn (x, y) and leave the yaw."""
    turn = np.zeros((len(angles), 3, 3))
    turn[:, 0, 0] = turn[:, 1, 1] = np.cos(angles)
    turn[:, 1, 0] = np.sin(angles)
    turn[:, 0, 1] = -turn[:, 1, 0]
    turn[:, 2, 2] = 1.0
    return turn


def _levers(places: FloatArray) -> FloatArray:
    """Return (n, 3, 3) matrices: what a small motion about the origin does to a pose at a place."""
    lever = np.tile(np.eye(3), (len(places), 1, 1))
    lever[:, 0, 2], lever[:, 1, 2] = -places[:, 1], places[:, 0]
    return lever
