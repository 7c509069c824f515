"""One step of the tracker: from what was believed at one shot, by a motion, to what is believed at the next.

A function of its arguments alone. That is what makes any order of arrival come to the same result: an input that
comes late is put in its place, and the steps from there on are done again.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from operator import attrgetter

import numpy as np

from tracking.assignment import Comparison, assign
from tracking.belief import Belief, Fate, Rules
from tracking.events import EventKind
from tracking.footprint import Standing
from tracking.foreseen import Foreseen, moved, standing
from tracking.gate import chi_square_limit
from tracking.hits import Hit
from tracking.joint import regrouped
from tracking.motion import Motion
from tracking.observation import ALL, Observation
from tracking.track import Key, Rival, Track, floor_sigma

_KEY = attrgetter("key")


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
    tracks, joints = moved(before, motion, rules)
    return Belief(time, tuple(tracks), tuple(joints))


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
    hits = {i: Hit(j, observations[i], pairing) for i, (j, pairing) in pairs.items()}
    joints, tracks = foreseen.after(list(hits.values()))
    fates = {
        i: Fate(EventKind.ACCEPTED, tracks[hit.track].key, hit.pairing.innovation.distance, hit.pairing.limit)
        for i, hit in hits.items()
    }
    known = len(tracks)
    renewed: list[Key] = []
    for i, one in enumerate(observations):
        if i not in fates:
            fates[i] = _left_over(foreseen, one, tracks, renewed, rules)
    vague = {one.key: why for one in tracks if one.misses and (why := one.vague(rules.config.life))}
    kept = [track for track in tracks if track.key not in vague]
    merged: list[tuple[Key, str]] = []
    if not foreseen.are_apart(kept):
        kept, merged = _exclusive(kept, rules)
    kept.sort(key=_KEY)
    if renewed or not known == len(tracks) == len(kept):
        fresh = {track.key for track in tracks[known:]}.union(renewed)
        began = [(track.key, track.state) for track in kept if track.key in fresh]
        joints = regrouped(joints, began, {track.key for track in kept}, rules.config.tracks_together)
    order = tuple(fates[i] for i in range(len(observations)))
    ended = (*foreseen.ended, *vague.items(), *merged)
    return Belief(foreseen.time, tuple(kept), tuple(joints), order, ended, tuple(renewed))


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
    inside = rules.footprints.same_place(found, standing(tracks))
    x, y = observation.values[:2].tolist()
    return min(
        np.flatnonzero(inside).tolist(),
        key=lambda j: math.hypot(*(tracks[j].state.mean[:2] - (x, y)).tolist()),
        default=None,
    )


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
        ),
        True,
    )


def _exclusive(tracks: Sequence[Track], rules: Rules) -> tuple[list[Track], list[tuple[Key, str]]]:
    """Return the tracks of which no two are in the same place, and those that gave way to a better one."""
    together = rules.footprints.sharing(standing(tracks))
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
