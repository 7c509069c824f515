"""Measurements that were assigned to tracks, and the tracks after them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from tracking.assignment import Pairing
from tracking.config import GateConfig, TrackerConfig
from tracking.gate import huber_weight
from tracking.joint import Joint
from tracking.joint_filter import JointFilter, Seen
from tracking.observation import Observation
from tracking.state import Gaussian
from tracking.track import Track


class Hit(NamedTuple):
    """A measurement of a track's own."""

    track: int
    """Index of the track."""
    observation: Observation
    """The measurement."""
    pairing: Pairing
    """How they compare."""

    @property
    def pair(self) -> tuple[int, str]:
        """Which track and which measurement."""
        return self.track, self.observation.order

    def weight(self, gate: GateConfig) -> float:
        """Return how much it counts."""
        return huber_weight(self.pairing.innovation.distance, len(self.observation.components), gate)


def updated(
    joints: Sequence[Joint], hits: Sequence[Sequence[tuple[int, Hit]]], engine: JointFilter, gate: GateConfig
) -> list[Joint]:
    """Return estimates after the measurements of their tracks.

    Parameters
    ----------
    joints : sequence of Joint
        As the shot finds them.
    hits : sequence of sequence of (int, Hit)
        For each of them, which of its members were measured, and how.
    engine : JointFilter
        The filter.
    gate : GateConfig
        How much a measurement counts.
    """
    seen = [
        [Seen(member, hit.observation, hit.pairing.scale, hit.weight(gate)) for member, hit in ones] for ones in hits
    ]
    return engine.updated(joints, seen)


def seen_track(track: Track, hit: Hit, state: Gaussian, time: float, config: TrackerConfig) -> Track:
    """Return a track after a measurement of its own.

    Parameters
    ----------
    track : Track
        As the shot finds it.
    hit : Hit
        The measurement.
    state : Gaussian
        What is known of it after the shot.
    time : float
        Of the shot, in seconds.
    config : TrackerConfig
        Parameters.
    """
    gate, pairing = config.gate, hit.pairing
    distance = pairing.innovation.distance
    ratios = track.ratios
    if gate.adapt_over > 0:
        ratios = (*ratios, pairing.scale * distance / len(hit.observation.components))[-gate.adapt_over :]
    hits = track.hits + 1
    return Track(
        track.key,
        track.model,
        state,
        time,
        hits,
        confirmed=track.confirmed or hits >= config.life.confirm_hits,
        nis=distance,
        ratios=ratios,
    )
