"""Tracks as a shot finds them, and what its measurements make of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from operator import attrgetter

from tracking.assignment import FEW, Comparison
from tracking.belief import Belief, Rules
from tracking.footprint import Standing
from tracking.hits import Hit, seen_track, updated
from tracking.joint import Joint, regrouped
from tracking.motion import Motion
from tracking.state import POSE
from tracking.track import Key, Track

_TRACK = attrgetter("track")


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
        tracks, joints = moved(before, motion, rules)
        self.ended = tuple((track.key, why) for track in tracks if (why := track.end(time, rules.config.life)))
        self._tracks = {track.key: track for track in tracks}
        if self.ended:
            for key, _ in self.ended:
                del self._tracks[key]
            joints = regrouped(joints, (), set(self._tracks), rules.config.tracks_together)
        self._joints = joints
        self._members = {key: (i, at) for i, joint in enumerate(joints) for at, key in enumerate(joint.keys)}
        self.comparison = Comparison(list(self._tracks.values()), rules.engine, rules.config.gate)
        self._after: dict[tuple[int, tuple[tuple[int, str], ...]], tuple[Joint, dict[Key, Track]]] = {}
        self._apart: dict[int, Track] = {}

    def serves(self, before: Belief, motion: Motion, time: float) -> bool:
        """Tell whether it comes of just these."""
        return self._origin[0] is before and self._origin[1] is motion and self.time == time

    def after(self, hits: Sequence[Hit]) -> tuple[list[Joint], list[Track]]:
        """Return the estimates after measurements of the tracks, and the tracks as they are then.

        Estimates of which no track is measured are as they were.
        """
        of_joint: list[list[tuple[int, Hit]]] = [[] for _ in self._joints]
        for hit in sorted(hits, key=_TRACK):
            i, member = self._members[self.comparison.tracks[hit.track].key]
            of_joint[i].append((member, hit))
        names = [(i, tuple(hit.pair for _, hit in ones)) for i, ones in enumerate(of_joint)]
        fresh = [i for i, name in enumerate(names) if name not in self._after]
        seen = [i for i in fresh if of_joint[i]]
        joints, rules = list(self._joints), self._rules
        after = updated([joints[i] for i in seen], [of_joint[i] for i in seen], rules.joint_engine, rules.config.gate)
        for i, joint in zip(seen, after, strict=True):
            joints[i] = joint
        for i in fresh:
            measured = {joints[i].keys[member]: hit for member, hit in of_joint[i]}
            self._after[names[i]] = joints[i], self._tracks_of(joints[i], measured)
        done = [self._after[name] for name in names]
        tracks = {key: track for _, ones in done for key, track in ones.items()}
        return [joint for joint, _ in done], [tracks[track.key] for track in self.comparison.tracks]

    def _tracks_of(self, joint: Joint, measured: Mapping[Key, Hit]) -> dict[Key, Track]:
        """Return the tracks of an estimate after a shot."""
        found = {}
        for key, state in zip(joint.keys, joint.members, strict=True):
            before, hit = self._tracks[key], measured.get(key)
            if hit is None:
                found[key] = replace(before, misses=before.misses + 1, state=state)
            else:
                found[key] = seen_track(before, hit, state, self.time, self._rules.config)
        return found

    def are_apart(self, tracks: Sequence[Track]) -> bool:
        """Tell whether no two tracks are in the same place; only those are looked at that were not there before."""
        if len(tracks) < 2:
            return True
        fresh = [track for track in tracks if id(track) not in self._apart]
        footprints = self._rules.footprints
        if len(fresh) > FEW:
            apart = not footprints.sharing(standing(tracks))
        else:
            others = standing(tracks)
            apart = all(footprints.same_place(one, others).sum() == 1 for one in standing(fresh))
        self._apart = {id(track): track for track in tracks} if apart else {}
        return apart


def moved(before: Belief, motion: Motion, rules: Rules) -> tuple[list[Track], list[Joint]]:
    """Return tracks and estimates after a motion of the forklift.

    Parameters
    ----------
    before : Belief
        What was believed.
    motion : Motion
        Of the forklift since.
    rules : Rules
        The filter.
    """
    joints = rules.joint_engine.predicted(before.joints, motion)
    states = {key: state for joint in joints for key, state in zip(joint.keys, joint.members, strict=True)}
    tracks = [track.carried(states[track.key]) for track in before.tracks]
    rivals = {i: track.rival for i, track in enumerate(tracks) if track.rival is not None}
    if not rivals:
        return tracks, joints
    found = rules.engine.predicted([rival.state for rival in rivals.values()], motion)
    for (i, rival), predicted in zip(rivals.items(), found, strict=True):
        tracks[i] = replace(tracks[i], rival=replace(rival, state=predicted.state))
    return tracks, joints


def standing(tracks: Sequence[Track]) -> list[Standing]:
    """Return where tracks' pallets stand."""
    return [Standing(track.state.mean[POSE], track.state.covariance, track.model) for track in tracks]
