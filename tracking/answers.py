"""Where the pallets are at any time, and how that is known."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum

from palletloc.geometry import FloatArray, LevelPose
from tracking.belief import Belief, Rules
from tracking.motion import Motion, no_motion
from tracking.path import DrivenPath
from tracking.track import Key, Status, Track


class Knowledge(StrEnum):
    """How a state at some time is known."""

    EXACT = "exact"
    """Measured at that very time."""
    INTERPOLATED = "interpolated"
    """Carried there from the last measurement by odometry on both sides of that time."""
    EXTRAPOLATED = "extrapolated"
    """Carried beyond the last odometry at its last rates."""
    COASTING = "coasting"
    """Carried there by odometry alone: the pallet was not seen of late."""


@dataclass(frozen=True, slots=True, eq=False)
class TrackState:
    """A pallet at some time."""

    track: int
    """Number of the track."""
    model: str
    """Name of the pallet model."""
    status: Status
    """How much the track is believed."""
    knowledge: Knowledge
    """How the state is known."""
    time: float
    """In seconds."""
    pose: LevelPose
    """``forklift_from_pallet`` at that time."""
    covariance: FloatArray
    """(4, 4) covariance of (x, y, z, yaw), in metres and radians."""
    age: float
    """Time since the last measurement, in seconds."""
    hits: int
    """How many measurements the track is made of."""
    nis: float
    """Normalised innovation squared of the last one; NaN where none followed the first."""


def states_at(
    time: float, belief: Belief, path: DrivenPath, numbers: Mapping[Key, int], rules: Rules
) -> tuple[TrackState, ...]:
    """Return the states of all tracks at a time.

    Parameters
    ----------
    time : float
        At or after the belief's, in seconds.
    belief : Belief
        After the last shot up to that time.
    path : DrivenPath
        The odometry.
    numbers : mapping
        Numbers of tracks.
    rules : Rules
        Parameters and filter.

    Returns
    -------
    tuple of TrackState
        In the order of their numbers; without tracks that have ended by then.
    """
    if belief.time is None:
        return ()
    motion = path.extrapolated(belief.time, time) or no_motion()
    beyond = not path.is_between_samples(time)
    live = [track for track in belief.tracks if not track.end(time, rules.config.life)]
    states = [_state(track, numbers[track.key], time, motion, beyond, rules) for track in live]
    return tuple(sorted(states, key=lambda one: one.track))


def _state(track: Track, number: int, time: float, motion: Motion, beyond: bool, rules: Rules) -> TrackState:
    state = track.state if motion.duration == 0 else rules.engine.predicted(track.state, motion).state
    moved = Track(track.key, track.model, state, track.seen)
    status = track.status(time, rules.config.life)
    if time == track.seen:
        known = Knowledge.EXACT
    elif beyond:
        known = Knowledge.EXTRAPOLATED
    else:
        known = Knowledge.COASTING if status is Status.COASTING else Knowledge.INTERPOLATED
    return TrackState(
        number,
        track.model,
        status,
        known,
        time,
        moved.pose,
        moved.covariance,
        time - track.seen,
        track.hits,
        track.nis,
    )
