"""Everything that is believed after a shot."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from tracking.association import Footprints
from tracking.config import TrackerConfig
from tracking.events import EventKind
from tracking.filter import GroupFilter
from tracking.state import Key, TrackGroup
from tracking.track import Track


class Disposition(NamedTuple):
    """What became of an observation."""

    kind: EventKind
    """Accepted, gated or waiting."""
    key: Key | None = None
    """The track that it went to, or whose gate rejected it."""
    distance: float | None = None
    """Squared Mahalanobis distance from that track."""
    limit: float | None = None
    """The gate."""
    reason: str = ""
    """Why, in words."""


@dataclass(frozen=True, slots=True, eq=False)
class Belief:
    """Everything that is believed after a shot."""

    time: float | None = None
    """Of the shot up to which tracks are carried, in seconds; None before the first."""
    tracks: tuple[Track, ...] = ()
    """Live ones, in the order of their keys."""
    groups: tuple[TrackGroup, ...] = ()
    """What is known of them together: each track is in one group."""
    dispositions: tuple[Disposition, ...] = ()
    """What became of the shot's observations, in their order."""
    ended: tuple[tuple[Key, str], ...] = ()
    """Tracks that ended at this shot, and why."""
    renewed: tuple[Key, ...] = ()
    """Tracks that began anew at this shot."""
    via: tuple[Belief, ...] = ()
    """What was believed on the way from the shot before, where that is long ago."""


@dataclass(frozen=True, slots=True, eq=False)
class UpdateModel:
    """What an update needs besides its inputs."""

    config: TrackerConfig
    """Parameters."""
    filter: GroupFilter
    """Predicts and updates states."""
    footprints: Footprints
    """Sizes of pallets."""
