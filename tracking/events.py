"""What became of every input, and what happened to the tracks."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class EventKind(StrEnum):
    """What happened."""

    ACCEPTED = "accepted"
    """The input was used."""
    WAITING = "waiting"
    """A measurement is kept until odometry reaches its time."""
    GATED = "gated"
    """A measurement is too far from the track in whose place it is."""
    TOO_LATE = "too_late"
    """The input is older than the window."""
    DUPLICATE = "duplicate"
    """The same input came before."""
    REJECTED = "rejected"
    """The input cannot be used: a value is wrong."""
    TIME_JUMP = "time_jump"
    """The input's time is far from all others; it is held, and used when more come from there."""
    RESET = "reset"
    """The tracker started anew, or the odometry did."""
    BORN = "born"
    """A track began."""
    CONFIRMED = "confirmed"
    """A track is believed from now on."""
    COASTING = "coasting"
    """A believed track was not seen."""
    REINITIALIZED = "reinitialized"
    """A track began anew from measurements that its gate had rejected."""
    LOST = "lost"
    """A track ended."""
    LATENCY = "latency"
    """The camera's time is offset against the odometry's."""


@dataclass(frozen=True, slots=True)
class Event:
    """Something that an input led to."""

    kind: EventKind
    """What happened."""
    time: float
    """Of the input, or of the shot where it happened to a track, in seconds."""
    track: int | None = None
    """Number of the track that it concerns."""
    distance: float | None = None
    """Squared Mahalanobis distance of a measurement from its track."""
    limit: float | None = None
    """The gate that it was held against."""
    age: float | None = None
    """How much older than the newest input a late one is, in seconds."""
    window: float | None = None
    """How late it might have been, in seconds."""
    reason: str = ""
    """Why, in words."""
    revised: bool = False
    """Whether a later input changed what had become of this one."""
