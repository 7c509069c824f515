"""One step of the tracker: from what was believed at one shot, by a motion, to what is believed at the next.

A function of its arguments alone. That is what makes any order of arrival come to the same result: an input that
comes late is put in its place, and the steps from there on are done again.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from typing import NamedTuple

import numpy as np

from tracking.assignment import FEW, Comparison, assign
from tracking.config import TrackerConfig
from tracking.events import EventKind
from tracking.filter import PalletFilter
from tracking.footprint import Footprints, Standing
from tracking.gate import chi_square_limit
from tracking.hits import Hit, tracks_after
from tracking.motion import Motion
from tracking.observation import ALL, Observation
from tracking.state import POSE
from tracking.track import Key, Rival, Track, floor_sigma


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


class Foreseen:
    """Tracks carried to a shot, before its observations.

    Remembers what observations came to, so that more of them can come without doing everything again.

    Parameters
    ----------
    before : Belief
        What was believed after the shot before.
    motion : Motion
        Of the forklift since.
    time : float
        Of the shot, in seconds.
    rules : Rules
        Parameters, filter and sizes.
    """

    def __init__(self, before: Belief, motion: Motion, time: float, rules: Rules) -> None:
        self.time = time
        self._rules = rules
        self._origin = before, motion
        moved = _moved(before.tracks, motion, rules)
        reasons = [track.end(time, rules.config.life) for track in moved]
        self.ended = tuple((track.key, why) for track, why in zip(moved, reasons, strict=True) if why)
        alive = [track for track, why in zip(moved, reasons, strict=True) if not why]
        self.comparison = Comparison(alive, rules.engine, rules.config.gate)
        self._hits: dict[tuple[int, str], Track] = {}
        self._missed: dict[int, Track] = {}
        self._apart: dict[int, Track] = {}
        self.vague: dict[Key, str] = {}
        """Tracks that are not worth keeping unless they are seen, and why."""

    def serves(self, before: Belief, motion: Motion, time: float) -> bool:
        """Tell whether it comes of just these."""
        return self._origin[0] is before and self._origin[1] is motion and self.time == time

    def hits(self, hits: Sequence[Hit]) -> list[Track]:
        """Return tracks after a measurement of their own each."""
        fresh = [hit for hit in hits if hit.pair not in self._hits]
        for _, alike in groupby(fresh, key=lambda hit: hit.observation.components):
            group = list(alike)
            tracks = [self.comparison.tracks[hit.track] for hit in group]
            after = tracks_after(tracks, group, self.time, self._rules.engine, self._rules.config)
            self._hits |= zip((hit.pair for hit in group), after, strict=True)
        return [self._hits[hit.pair] for hit in hits]

    def missed(self, track: int) -> Track:
        """Return a track after a shot in which it was not seen."""
        if track not in self._missed:
            before = self.comparison.tracks[track]
            self._missed[track] = replace(before, misses=before.misses + 1)
            why = before.vague(self._rules.config.life)
            if why:
                self.vague[before.key] = why
        return self._missed[track]

    def are_apart(self, tracks: Sequence[Track]) -> bool:
        """Tell whether no two tracks are in the same place; only those are looked at that were not there before."""
        if len(tracks) < 2:
            return True
        fresh = [track for track in tracks if id(track) not in self._apart]
        footprints = self._rules.footprints
        if len(fresh) > FEW:
            apart = not footprints.sharing(_standing(tracks))
        else:
            others = _standing(tracks)
            apart = all(footprints.same_place(one, others).sum() == 1 for one in _standing(fresh))
        self._apart = {id(track): track for track in tracks} if apart else {}
        return apart


def carried(before: Belief, motion: Motion, time: float, rules: Rules) -> Belief:
    """Carry the tracks to a later time without a shot.

    Parameters
    ----------
    before : Belief
        What was believed.
    motion : Motion
        Of the forklift since.
    time : float
        Where it ends, in seconds.
    rules : Rules
        Parameters, filter and sizes.
    """
    return Belief(time, tuple(_moved(before.tracks, motion, rules)))


def waiting(before: Belief, count: int) -> Belief:
    """Return what is believed after a shot to which odometry does not reach: what was believed before it."""
    fate = Fate(EventKind.WAITING, reason="no odometry at its time")
    return replace(before, fates=(fate,) * count, ended=(), renewed=())


def advance(foreseen: Foreseen, observations: Sequence[Observation], rules: Rules) -> Belief:
    """Fuse the observations of a shot.

    Parameters
    ----------
    foreseen : Foreseen
        Tracks carried to the shot.
    observations : sequence of Observation
        Of the shot, in their order.
    rules : Rules
        Parameters, filter and sizes.

    Returns
    -------
    Belief
        After the shot.
    """
    comparison = foreseen.comparison
    pairs = assign(comparison, observations)
    fates: dict[int, Fate] = {}
    tracks = list(comparison.tracks)
    hits = [Hit(j, observations[i], pairing) for i, (j, pairing) in pairs.items()]
    for i, hit, track in zip(pairs, hits, foreseen.hits(hits), strict=True):
        tracks[hit.track] = track
        fates[i] = Fate(EventKind.ACCEPTED, track.key, hit.pairing.innovation.distance, hit.pairing.limit)
    for j in set(range(len(tracks))) - {hit.track for hit in hits}:
        tracks[j] = foreseen.missed(j)
    renewed: list[Key] = []
    for i in sorted(set(range(len(observations))) - fates.keys()):
        fates[i] = _left_over(foreseen, observations[i], tracks, renewed, rules)
    vague = {one.key: foreseen.vague[one.key] for one in tracks if one.misses and one.key in foreseen.vague}
    kept = [track for track in tracks if track.key not in vague]
    merged: list[tuple[Key, str]] = []
    if not foreseen.are_apart(kept):
        kept, merged = _exclusive(kept, rules)
    order = tuple(fates[i] for i in range(len(observations)))
    ended = (*foreseen.ended, *vague.items(), *merged)
    return Belief(foreseen.time, tuple(sorted(kept, key=lambda one: one.key)), order, ended, tuple(renewed))


def _moved(tracks: Sequence[Track], motion: Motion, rules: Rules) -> list[Track]:
    rivals = {i: track.rival for i, track in enumerate(tracks) if track.rival is not None}
    states = [track.state for track in tracks] + [rival.state for rival in rivals.values()]
    found = rules.engine.predicted(states, motion)
    moved = [track.carried(one) for track, one in zip(tracks, found[: len(tracks)], strict=True)]
    for (i, rival), predicted in zip(rivals.items(), found[len(tracks) :], strict=True):
        moved[i] = replace(moved[i], rival=replace(rival, state=predicted.state))
    return moved


def _left_over(
    foreseen: Foreseen, observation: Observation, tracks: list[Track], renewed: list[Key], rules: Rules
) -> Fate:
    """Return what becomes of an observation that was assigned to no track; may change the tracks or add one."""
    comparison = foreseen.comparison
    inside = _track_in_place(comparison, observation, tracks, rules)
    limit = chi_square_limit(rules.config.gate.probability, len(observation.components))
    if inside is not None:
        tracks[inside], began_anew = _contradicted(tracks[inside], observation, foreseen.time, rules)
        key = tracks[inside].key
        renewed += [key] if began_anew else []
        known = inside < len(comparison.tracks)
        pairing = comparison.pairing(observation, inside) if known else None
        if pairing is None:
            return Fate(EventKind.GATED, key, None, limit, "another model, or measured twice in this shot")
        reason = "another measurement of this shot fits better" if pairing.passes else ""
        return Fate(EventKind.GATED, key, pairing.innovation.distance, limit, reason)
    if not observation.is_whole:
        return Fate(EventKind.GATED, limit=limit, reason="no track where this part of a pose belongs")
    if floor_sigma(observation.covariance) > rules.config.life.max_sigma_m:
        return Fate(EventKind.GATED, limit=limit, reason="no track there, and too uncertain to begin one")
    key = Key(foreseen.time, observation.order)
    tracks.append(Track(key, observation.model, rules.engine.begin(observation), foreseen.time))
    return Fate(EventKind.ACCEPTED, key)


def _track_in_place(
    comparison: Comparison, observation: Observation, tracks: Sequence[Track], rules: Rules
) -> int | None:
    """Return the track in whose place an observation is that belongs to none: the nearest one."""
    if not tracks:
        return None
    if not observation.is_whole:
        return comparison.nearest(observation)
    found = Standing(observation.values, observation.covariance, observation.model)
    inside = rules.footprints.same_place(found, _standing(tracks))
    x, y = observation.values[:2].tolist()
    return min(
        np.flatnonzero(inside).tolist(),
        key=lambda j: math.hypot(*(tracks[j].state.mean[:2] - (x, y)).tolist()),
        default=None,
    )


def _standing(tracks: Sequence[Track]) -> list[Standing]:
    return [Standing(track.state.mean[POSE], track.state.covariance, track.model) for track in tracks]


def _contradicted(track: Track, observation: Observation, time: float, rules: Rules) -> tuple[Track, bool]:
    """Return a track after a measurement in its place that is not its own, and whether it began anew from it.

    Rejected measurements that agree with each other are no outliers: a gate alone would shut them out for ever.
    Those of a track that was seen in the same shot do not count.
    """
    if not observation.is_whole or track.seen == time:
        return track, False
    engine, rival = rules.engine, track.rival
    limit = chi_square_limit(rules.config.gate.probability, len(ALL))
    agrees = (
        rival is not None
        and rival.model == observation.model
        and engine.innovation(rival.state, observation).distance <= limit
    )
    if rival is None or not agrees:
        rival = Rival(engine.begin(observation), observation.model, 1)
    else:
        rival = Rival(engine.updated(rival.state, observation), rival.model, rival.hits + 1)
    if rival.hits < rules.config.life.recovery_hits:
        return replace(track, rival=rival), False
    return (
        replace(
            track,
            model=rival.model,
            state=rival.state,
            seen=time,
            hits=rival.hits,
            misses=0,
            confirmed=track.confirmed or rival.hits >= rules.config.life.confirm_hits,
            nis=float("nan"),
            ratios=(),
            rival=None,
            predicted=None,
        ),
        True,
    )


def _exclusive(tracks: Sequence[Track], rules: Rules) -> tuple[list[Track], list[tuple[Key, str]]]:
    """Return the tracks of which no two are in the same place, and those that gave way to a better one."""
    together = rules.footprints.sharing(_standing(tracks))
    if not together:
        return list(tracks), []
    kept: list[int] = []
    merged: list[tuple[Key, str]] = []
    ranks = [(not one.confirmed, one.misses > 0, -one.hits, one.key) for one in tracks]
    for i in sorted(range(len(tracks)), key=lambda one: ranks[one]):
        if any((min(i, j), max(i, j)) in together for j in kept):
            merged.append((tracks[i].key, "another track is in its place"))
        else:
            kept.append(i)
    return [tracks[i] for i in kept], merged
