"""One update of the tracker: from what was believed at one shot, by a motion, to what is believed at the next.

A function of its arguments alone. That is what makes any order of arrival come to the same result: an input that
comes late is put in its place, and the updates from there on are done again.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from operator import attrgetter

import numpy as np

from tracking.association import FEW, Comparison, Standing, assign
from tracking.belief import Belief, Disposition, UpdateModel
from tracking.config import TrackerConfig
from tracking.events import EventKind
from tracking.gating import Association, chi_square_limit
from tracking.motion import Motion
from tracking.observation import ALL, Observation
from tracking.state import POSE, Gaussian, Key, TrackGroup, regrouped
from tracking.track import MOST_SERIES, RECALL, RejectedSeries, Track, floor_sigma

_KEY = attrgetter("key")
"""By which tracks are put in order."""

_Hits = dict[int, Association]
"""Measurements of a group's members, by their places in it."""


class Prediction:
    """Tracks as a motion leads them to a shot, before its observations.

    Remembers what observations came to, so that more of them can come without doing everything again.

    Parameters
    ----------
    before : Belief
        What was believed after the shot before.
    motion : Motion
        Of the forklift since.
    time : float
        Of the shot, in seconds.
    model : UpdateModel
        Parameters, filter and sizes.
    """

    def __init__(self, before: Belief, motion: Motion, time: float, model: UpdateModel) -> None:
        self.time = time
        self._model = model
        self._origin = before, motion
        tracks, groups = _predicted(before, motion, model)
        self.ended = tuple((track.key, why) for track in tracks if (why := track.end(time, model.config.life)))
        if self.ended:
            alive = {track.key for track in tracks} - {key for key, _ in self.ended}
            tracks = [track for track in tracks if track.key in alive]
            groups = regrouped(groups, (), alive, model.config.tracks_together)
        self._groups = groups
        self._members = {key: (i, at) for i, group in enumerate(groups) for at, key in enumerate(group.keys)}
        self.comparison = Comparison(tracks, model.filter, model.config.gate)
        self._tracks = {track.key: track for track in self.comparison.tracks}
        self._updated: dict[tuple[int, tuple[tuple[int, str], ...]], tuple[TrackGroup, dict[Key, Track]]] = {}
        self._separate: dict[int, Track] = {}

    def serves(self, before: Belief, motion: Motion, time: float) -> bool:
        """Tell whether it comes of just these."""
        return self._origin[0] is before and self._origin[1] is motion and self.time == time

    def updated(self, hits: Mapping[int, Association]) -> tuple[list[TrackGroup], list[Track]]:
        """Return the groups and the tracks after measurements.

        Parameters
        ----------
        hits : mapping of int to Association
            By the tracks' numbers in `comparison`.
        """
        of_group: list[_Hits] = [{} for _ in self._groups]
        for track in sorted(hits):
            i, member = self._members[self.comparison.tracks[track].key]
            of_group[i][member] = hits[track]
        after = [self._updated_group(i, measured) for i, measured in enumerate(of_group)]
        tracks = {key: track for _, members in after for key, track in members.items()}
        return [group for group, _ in after], [tracks[track.key] for track in self.comparison.tracks]

    def _updated_group(self, number: int, hits: _Hits) -> tuple[TrackGroup, dict[Key, Track]]:
        """Return a group after measurements, and its tracks; one of which none is measured is as it was."""
        name = number, tuple((member, hit.observation.order) for member, hit in hits.items())
        if name not in self._updated:
            group = self._groups[number]
            if hits:
                group = self._model.filter.update_group(group, tuple(hits.items()))
            tracks = {}
            for member, (key, state) in enumerate(group.members.items()):
                track, hit = self._tracks[key], hits.get(member)
                if hit is None:
                    tracks[key] = replace(track, misses=track.misses + 1, state=state)
                else:
                    tracks[key] = _measured(track, hit, state, self.time, self._model.config)
            self._updated[name] = group, tracks
        return self._updated[name]

    def are_separate(self, tracks: Sequence[Track]) -> bool:
        """Tell whether no two tracks are in the same place; looks only at those that were not there before."""
        if len(tracks) < 2:
            return True
        fresh = [track for track in tracks if id(track) not in self._separate]
        footprints = self._model.footprints
        if len(fresh) > FEW:
            separate = not footprints.sharing(_standing(tracks))
        else:
            others = _standing(tracks)
            separate = all(footprints.same_place(pallet, others).sum() == 1 for pallet in _standing(fresh))
        self._separate = {id(track): track for track in tracks} if separate else {}
        return separate


def carried(before: Belief, motion: Motion, time: float, model: UpdateModel) -> Belief:
    """Carry the tracks to a later time without a shot.

    Parameters
    ----------
    before : Belief
        What was believed.
    motion : Motion
        Of the forklift since.
    time : float
        Where it ends, in seconds.
    model : UpdateModel
        Parameters, filter and sizes.
    """
    tracks, groups = _predicted(before, motion, model)
    return Belief(time, tuple(tracks), tuple(groups))


def waiting(before: Belief, count: int) -> Belief:
    """Return what is believed after a shot to which odometry does not reach: what was believed before it."""
    disposition = Disposition(EventKind.WAITING, reason="no odometry at its time")
    return replace(before, dispositions=(disposition,) * count, ended=(), renewed=())


def advance(prediction: Prediction, observations: Sequence[Observation], model: UpdateModel) -> Belief:
    """Fuse the observations of a shot.

    Parameters
    ----------
    prediction : Prediction
        Tracks as the motion leads them to the shot.
    observations : sequence of Observation
        Of the shot, in their order.
    model : UpdateModel
        Parameters, filter and sizes.

    Returns
    -------
    Belief
        After the shot.
    """
    pairs = assign(prediction.comparison, observations)
    groups, tracks = prediction.updated(dict(pairs.values()))
    accepted = {
        i: Disposition(EventKind.ACCEPTED, tracks[track].key, pair.distance, pair.limit)
        for i, (track, pair) in pairs.items()
    }
    known = len(tracks)
    tracks, renewed, dispositions = _with_others(prediction, observations, tracks, accepted, model)
    vague = {track.key: why for track in tracks if track.misses and (why := track.vague(model.config.life))}
    kept = [track for track in tracks if track.key not in vague]
    merged: list[tuple[Key, str]] = []
    if not prediction.are_separate(kept):
        kept, merged = _exclusive(kept, model)
    kept.sort(key=_KEY)
    if renewed or not known == len(tracks) == len(kept):
        fresh = {track.key for track in tracks[known:]}.union(renewed)
        began = [(track.key, track.state) for track in kept if track.key in fresh]
        groups = regrouped(groups, began, {track.key for track in kept}, model.config.tracks_together)
    ended = (*prediction.ended, *vague.items(), *merged)
    return Belief(prediction.time, tuple(kept), tuple(groups), dispositions, ended, tuple(renewed))


def _predicted(before: Belief, motion: Motion, model: UpdateModel) -> tuple[list[Track], list[TrackGroup]]:
    """Return tracks and groups after a motion of the forklift."""
    groups = model.filter.predict_groups(before.groups, motion)
    states = {key: state for group in groups for key, state in group.members.items()}
    tracks = [track.moved(states[track.key]) for track in before.tracks]
    series = [rejected for track in tracks for rejected in track.rejected]
    if series:
        after = iter(model.filter.predict([rejected.state for rejected in series], motion))
        tracks = [
            replace(track, rejected=tuple(replace(rejected, state=next(after)) for rejected in track.rejected))
            for track in tracks
        ]
    return tracks, groups


def _measured(track: Track, hit: Association, state: Gaussian, time: float, config: TrackerConfig) -> Track:
    """Return a track after a measurement of its own, in the state after the shot."""
    ratios = track.ratios
    if config.gate.adapt_over > 0:
        ratio = hit.scale * hit.distance / len(hit.observation.components)
        ratios = (*ratios, ratio)[-config.gate.adapt_over :]
    hits = track.hits + 1
    rejected = tuple(series.opposed() for series in track.rejected if series.idle < RECALL)
    found = Track(track.key, track.model, state, time, hits, 0, track.confirmed, hit.distance, ratios, rejected)
    if found.confirmed or hits < config.life.confirm_hits or found.is_contested:
        return found
    return replace(found, confirmed=True)


def _with_others(
    prediction: Prediction,
    observations: Sequence[Observation],
    tracks: Sequence[Track],
    accepted: Mapping[int, Disposition],
    model: UpdateModel,
) -> tuple[list[Track], list[Key], tuple[Disposition, ...]]:
    """Return the tracks after the observations that belong to none of them, too.

    With those that began anew, and what became of all observations. New tracks stand behind the others.
    """
    after, renewed, dispositions = list(tracks), list[Key](), list[Disposition]()
    for i, observation in enumerate(observations):
        inside = None if i in accepted else _track_in_place(prediction.comparison, observation, after, model)
        if i in accepted:
            dispositions.append(accepted[i])
        elif inside is None:
            alone = _alone(observation, prediction.time, model)
            dispositions.append(alone)
            if alone.key is not None:
                begun = model.filter.begin(observation)
                after.append(Track(alone.key, observation.model, begun, prediction.time))
        else:
            after[inside], began_anew = _contradicted(after[inside], observation, prediction.time, model)
            renewed += [after[inside].key] if began_anew else []
            dispositions.append(_rejected(prediction.comparison, observation, inside, after[inside].key, model))
    return after, renewed, tuple(dispositions)


def _alone(observation: Observation, time: float, model: UpdateModel) -> Disposition:
    """Return what becomes of an observation in the place of no track: a new one, where it may begin one."""
    limit = chi_square_limit(model.config.gate.probability, len(observation.components))
    if not observation.is_whole:
        return Disposition(EventKind.GATED, limit=limit, reason="no track where this part of a pose belongs")
    if floor_sigma(observation.covariance) > model.config.life.max_sigma_m:
        return Disposition(EventKind.GATED, limit=limit, reason="no track there, and too uncertain to begin one")
    return Disposition(EventKind.ACCEPTED, Key(time, observation.order))


def _rejected(
    comparison: Comparison, observation: Observation, track: int, key: Key, model: UpdateModel
) -> Disposition:
    """Return what becomes of an observation in the place of a track that it does not belong to."""
    limit = chi_square_limit(model.config.gate.probability, len(observation.components))
    pair = comparison.association(observation, track) if track < len(comparison.tracks) else None
    if pair is None:
        return Disposition(EventKind.GATED, key, None, limit, "another model, or measured twice in this shot")
    reason = "another measurement of this shot fits better" if pair.passes else ""
    return Disposition(EventKind.GATED, key, pair.distance, limit, reason)


def _track_in_place(
    comparison: Comparison, observation: Observation, tracks: Sequence[Track], model: UpdateModel
) -> int | None:
    """Return the track in whose place an observation is that belongs to none: the nearest one."""
    if not tracks:
        return None
    if not observation.is_whole:
        return comparison.nearest(observation)
    found = Standing(observation.values, observation.covariance, observation.model)
    inside = model.footprints.same_place(found, _standing(tracks))
    x, y = observation.values[:2].tolist()
    return min(
        np.flatnonzero(inside).tolist(),
        key=lambda j: math.hypot(*(tracks[j].state.mean[:2] - (x, y)).tolist()),
        default=None,
    )


def _contradicted(track: Track, observation: Observation, time: float, model: UpdateModel) -> tuple[Track, bool]:
    """Return a track after a measurement in its place that is not its own, and whether it began anew from it.

    Rejected measurements that agree with each other are no outliers: a gate alone would shut them out for ever.
    Those of a track that was seen in the same shot do not count. What the track was before becomes one more series,
    so that a change that was wrong is taken back as soon as the count says so.
    """
    if not observation.is_whole or track.seen == time:
        return track, False
    series, life = _extended(track, observation, model), model.config.life
    best, *others = series
    if not best.outweighs(life):
        return replace(track, rejected=series), False
    former = RejectedSeries(track.state, track.model, track.hits, 0, 0, mixed=True)
    rejected = [
        replace(each, row=0, lead=max(each.lead - best.lead, -RECALL), mixed=True) for each in (former, *others)
    ]
    confirmed = track.confirmed or best.hits >= life.confirm_hits
    renewed = Track(
        track.key,
        best.model,
        best.state,
        time,
        best.hits,
        confirmed=confirmed,
        rejected=tuple(rejected[:MOST_SERIES]),
    )
    return renewed, True


def _extended(track: Track, observation: Observation, model: UpdateModel) -> tuple[RejectedSeries, ...]:
    """Return the series of a track's rejected measurements after one more: first that to which it belongs."""
    group_filter = model.filter
    limit = chi_square_limit(model.config.gate.probability, len(ALL))
    distances = [
        group_filter.innovation(series.state, observation).distance if series.model == observation.model else math.inf
        for series in track.rejected
    ]
    nearest = min(range(len(distances)), key=distances.__getitem__, default=None)
    if nearest is None or distances[nearest] > limit:
        own = RejectedSeries(group_filter.begin(observation), observation.model, 1, 1, 1 - min(track.hits, RECALL))
    else:
        own = track.rejected[nearest]
        own = own.joined(group_filter.update(own.state, [(0, Association(observation))]))
    others = [replace(each, row=0) for i, each in enumerate(track.rejected) if own.hits == 1 or i != nearest]
    others.sort(key=lambda each: (-each.lead, each.idle))
    return (own, *others[: MOST_SERIES - 1])


def _exclusive(tracks: Sequence[Track], model: UpdateModel) -> tuple[list[Track], list[tuple[Key, str]]]:
    """Return the tracks of which no two are in the same place, and those that gave way to a better one."""
    together = model.footprints.sharing(_standing(tracks))
    if not together:
        return list(tracks), []
    kept: list[int] = []
    merged: list[tuple[Key, str]] = []
    ranks = [(not track.confirmed, track.misses > 0, -track.hits, track.key) for track in tracks]
    for i in sorted(range(len(tracks)), key=lambda number: ranks[number]):
        if any((min(i, j), max(i, j)) in together for j in kept):
            merged.append((tracks[i].key, "another track is in its place"))
        else:
            kept.append(i)
    return [tracks[i] for i in kept], merged


def _standing(tracks: Sequence[Track]) -> list[Standing]:
    """Return where the pallets of tracks stand."""
    return [Standing(track.state.mean[POSE], track.state.covariance, track.model) for track in tracks]
