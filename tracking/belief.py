"""Everything that is believed after a shot."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from tracking.config import TrackerConfig
from tracking.events import EventKind
from tracking.filter import PalletFilter
from tracking.footprint import Footprints
from tracking.joint import Joint
from tracking.joint_filter import JointFilter
from tracking.track import Key, Track


class Fate(NamedTuple):
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
    joints: tuple[Joint, ...] = ()
    """What is known of them together: each track is in one estimate, which it may share with others."""
    fates: tuple[Fate, ...] = ()
    """What became of the shot's observations, in their order."""
    ended: tuple[tuple[Key, str], ...] = ()
    """Tracks that ended at this shot, and why."""
    renewed: tuple[Key, ...] = ()
    """Tracks that began anew at this shot."""
    via: tuple[Belief, ...] = ()
    """What was believed on the way from the shot before, where that is long ago."""


@dataclass(frozen=True, slots=True, eq=False)
class Rules:
    """What a step needs besides its inputs."""

    config: TrackerConfig
    """Parameters."""
    engine: PalletFilter
    """The filter, which has no memory."""
    footprints: Footprints
    """Sizes of pallets."""

    @property
    def joint_engine(self) -> JointFilter:
        """The filter of tracks that share an estimate."""
        return JointFilter(self.engine)
