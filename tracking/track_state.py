"""Where the pallets are at any time, and how that is known."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import StrEnum

from palletloc.geometry import FloatArray, LevelPose
from palletloc.track_status import Status
from tracking.belief import Belief, UpdateModel
from tracking.driven_path import DrivenPath
from tracking.state import Key
from tracking.track import Track


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
    time: float, belief: Belief, path: DrivenPath, numbers: Mapping[Key, int], model: UpdateModel
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
    model : UpdateModel
        Parameters and filter.

    Returns
    -------
    tuple of TrackState
        In the order of their numbers; without tracks that have ended by then.
    """
    if belief.time is None:
        return ()
    live = [track for track in belief.tracks if not track.is_too_old(time, model.config.life)]
    motion = path.extrapolated(belief.time, time) if live else None
    moved = [track.state for track in live]
    if motion is not None and motion.duration > 0:
        moved = model.filter.predict(moved, motion)
    beyond = not path.is_between_samples(time)
    states = [
        _state(replace(track, state=state), numbers[track.key], time, beyond, model)
        for track, state in zip(live, moved, strict=True)
    ]
    return tuple(sorted(states, key=lambda state: state.track))


def _state(track: Track, number: int, time: float, beyond: bool, model: UpdateModel) -> TrackState:
    status = track.status(time, model.config.life)
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
        track.pose,
        track.covariance,
        time - track.seen,
        track.hits,
        math.nan if track.nis is None else track.nis,
    )
