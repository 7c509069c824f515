"""Measurements that were assigned to tracks, and the tracks after them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from tracking.assignment import Pairing
from tracking.config import TrackerConfig
from tracking.filter import PalletFilter
from tracking.gate import huber_weight
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


def tracks_after(
    tracks: Sequence[Track], hits: Sequence[Hit], time: float, engine: PalletFilter, config: TrackerConfig
) -> list[Track]:
    """Return tracks after a measurement of their own each.

    Parameters
    ----------
    tracks : sequence of Track
        As the shot finds them.
    hits : sequence of Hit
        Their measurements, all with the same components.
    time : float
        Of the shot, in seconds.
    engine : PalletFilter
        The filter.
    config : TrackerConfig
        Parameters.
    """
    gate, dof = config.gate, len(hits[0].observation.components)
    states = engine.updates(
        [track.state for track in tracks],
        [hit.observation for hit in hits],
        [hit.pairing.scale for hit in hits],
        [huber_weight(hit.pairing.innovation.distance, dof, gate) for hit in hits],
    )
    return [_seen(*one, time, config) for one in zip(tracks, hits, states, strict=True)]


def _seen(track: Track, hit: Hit, state: Gaussian, time: float, config: TrackerConfig) -> Track:
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
        predicted=track.predicted,
    )
