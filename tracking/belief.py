"""One step of the tracker: from what was believed at one shot, by a motion, to what is believed at the next.

A function of its arguments alone. That is what makes any order of arrival come to the same result: an input that
comes late is put in its place, and the steps from there on are done again.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

from tracking.assignment import Assignment, Pairing, assign
from tracking.config import TrackerConfig
from tracking.events import EventKind
from tracking.filter import PalletFilter
from tracking.footprint import Footprints
from tracking.gate import chi_square_limit, huber_weight
from tracking.motion import Motion
from tracking.observation import ALL, Observation
from tracking.track import Key, Rival, Track


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


@dataclass(frozen=True, slots=True, eq=False)
class Rules:
    """What a step needs besides its inputs."""

    config: TrackerConfig
    """Parameters."""
    engine: PalletFilter
    """The filter, which has no memory."""
    footprints: Footprints
    """Sizes of pallets."""


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
    return Belief(time, tuple(_moved(track, motion, rules) for track in before.tracks))


def advance(
    before: Belief, motion: Motion | None, time: float, observations: Sequence[Observation], rules: Rules
) -> Belief:
    """Carry the tracks to a shot and fuse its observations.

    Parameters
    ----------
    before : Belief
        What was believed after the shot before.
    motion : Motion or None
        Of the forklift since; None where odometry does not say.
    time : float
        Of the shot, in seconds.
    observations : sequence of Observation
        Of the shot, in their order.
    rules : Rules
        Parameters, filter and sizes.

    Returns
    -------
    Belief
        After the shot; without odometry, what was believed before it, all observations waiting.
    """
    if motion is None:
        waiting = Fate(EventKind.WAITING, reason="no odometry at its time")
        return replace(before, fates=(waiting,) * len(observations), ended=(), renewed=())
    life = rules.config.life
    moved = [_moved(track, motion, rules) for track in before.tracks]
    reasons = [track.end(time, life) for track in moved]
    ended = [(track.key, reason) for track, reason in zip(moved, reasons, strict=True) if reason]
    alive = [track for track, reason in zip(moved, reasons, strict=True) if not reason]
    found = assign(alive, observations, rules.engine, rules.config.gate)
    fates: dict[int, Fate] = {}
    tracks = list(alive)
    for i, j in found.pairs.items():
        tracks[j] = _hit(alive[j], observations[i], found.pairings[i, j], time, rules)
        pairing = found.pairings[i, j]
        fates[i] = Fate(EventKind.ACCEPTED, alive[j].key, pairing.innovation.distance, pairing.limit)
    for j in set(range(len(alive))) - set(found.pairs.values()):
        tracks[j] = replace(alive[j], misses=alive[j].misses + 1)
    renewed = []
    for i, observation in enumerate(observations):
        if i in fates:
            continue
        inside = _track_in_place(tracks, observation, found, i, rules)
        if inside is not None:
            tracks[inside], began_anew = _contradicted(tracks[inside], observation, time, rules)
            key = tracks[inside].key
            renewed += [key] if began_anew else []
            fates[i] = _gated(found, i, inside if inside < len(alive) else None, key, observation, rules)
        elif observation.is_whole:
            key = Key(time, observation.order)
            tracks.append(Track(key, observation.model, rules.engine.begin(observation), time))
            fates[i] = Fate(EventKind.ACCEPTED, key)
        else:
            fates[i] = Fate(EventKind.GATED, reason="no track where this part of a pose belongs")
    kept, merged = _exclusive(tracks, rules)
    order = tuple(fates[i] for i in range(len(observations)))
    return Belief(time, tuple(sorted(kept, key=lambda one: one.key)), order, (*ended, *merged), tuple(renewed))


def _moved(track: Track, motion: Motion, rules: Rules) -> Track:
    predicted = rules.engine.predicted(track.state, motion)
    rival = track.rival
    if rival is not None:
        rival = replace(rival, state=rules.engine.predicted(rival.state, motion).state)
    return replace(track, state=predicted.state, predicted=predicted, rival=rival)


def _hit(track: Track, observation: Observation, pairing: Pairing, time: float, rules: Rules) -> Track:
    """Return a track after a measurement of its own."""
    gate, dof = rules.config.gate, len(observation.components)
    distance = pairing.innovation.distance
    ratios = track.ratios
    if gate.adapt_over > 0:
        ratios = (*ratios, pairing.scale * distance / dof)[-gate.adapt_over :]
    weight = huber_weight(distance, dof, gate)
    hits = track.hits + 1
    return replace(
        track,
        state=rules.engine.updated(track.state, observation, pairing.scale, weight),
        seen=time,
        hits=hits,
        misses=0,
        confirmed=track.confirmed or hits >= rules.config.life.confirm_hits,
        nis=distance,
        ratios=ratios,
        rival=None,
    )


def _track_in_place(
    tracks: Sequence[Track], observation: Observation, found: Assignment, number: int, rules: Rules
) -> int | None:
    """Return the track in whose place an observation is that belongs to none: the nearest one."""
    if not observation.is_whole:
        compared = {j: one.innovation.distance for (i, j), one in found.pairings.items() if i == number}
        return min(compared, key=lambda j: compared[j]) if compared else None
    pose = observation.pose
    inside = [
        j
        for j, track in enumerate(tracks)
        if rules.footprints.same_place(pose, observation.model, track.pose, track.model)
    ]
    return min(
        inside, key=lambda j: (tracks[j].pose.x - pose.x) ** 2 + (tracks[j].pose.y - pose.y) ** 2, default=None
    )


def _gated(
    found: Assignment, number: int, track: int | None, key: Key, observation: Observation, rules: Rules
) -> Fate:
    pairing = None if track is None else found.pairings.get((number, track))
    if pairing is None:
        limit = chi_square_limit(rules.config.gate.probability, len(observation.components))
        return Fate(EventKind.GATED, key, None, limit, "another model, or measured twice in this shot")
    reason = "another measurement of this shot fits better" if pairing.passes else ""
    return Fate(EventKind.GATED, key, pairing.innovation.distance, pairing.limit, reason)


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
    kept: list[Track] = []
    merged: list[tuple[Key, str]] = []
    for track in sorted(tracks, key=lambda one: (not one.confirmed, one.misses > 0, -one.hits, one.key)):
        if any(rules.footprints.same_place(track.pose, track.model, one.pose, one.model) for one in kept):
            merged.append((track.key, "another track is in its place"))
        else:
            kept.append(track)
    return kept, merged
