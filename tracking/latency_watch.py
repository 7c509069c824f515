"""Keeps what the shots of the last half minute tell about the camera's latency, in bounded memory."""

from __future__ import annotations

import numpy as np

from palletloc.geometry import FloatArray
from tracking.belief import Belief
from tracking.config import TrackerConfig
from tracking.events import Event, EventKind
from tracking.latency import LatencyEstimate, estimate_latency, smoothing, trial_offsets
from tracking.path import DrivenPath
from tracking.replay import Look, Replay
from tracking.sightings import SeenFrom, Sighting

PLANE = np.ix_((0, 1, 3), (0, 1, 3))
"""Where x, y and yaw are in a covariance of (x, y, z, yaw)."""
MOST_PALLETS = 4
"""How many pallets of a shot are compared, those known longest."""


class LatencyWatch:
    """Takes shots that are final, and tells when the camera's latency shows.

    Parameters
    ----------
    config : TrackerConfig
        Parameters.
    """

    def __init__(self, config: TrackerConfig) -> None:
        self._config = config
        self.shots: list[SeenFrom] = []
        self.since = 0
        """Shots since the last estimate."""
        self.told: float | None = None
        """The latency that was told last, in seconds."""

    def estimate(self) -> LatencyEstimate:
        """Return what the shots that are kept tell."""
        return estimate_latency(self.shots, self._config)

    def of_final(self, replay: Replay, horizon: float) -> list[Event]:
        """Take the shots that no input can change any more; return what they tell anew.

        Parameters
        ----------
        replay : Replay
            Before it forgets them.
        horizon : float
            Time before which they are final, in seconds.
        """
        events: list[Event] = []
        count = replay.final_count(horizon)
        for look, belief in zip(replay.looks[:count], replay.beliefs[:count], strict=True):
            if self._take(look, belief, replay.path):
                self.since += 1
            if self.since >= self._config.latency.every:
                self.since = 0
                events += self._news(look.time)
        return events

    def _news(self, time: float) -> list[Event]:
        limits, found = self._config.latency, self.estimate()
        if not found.observable:
            return []
        if self.told is None:
            new = abs(found.offset) > max(limits.least_s, limits.significance * found.sigma)
        else:
            new = abs(found.offset - self.told) > found.sigma
        if not new:
            return []
        self.told = found.offset
        figure = f"{1e3 * abs(found.offset):.1f} +- {1e3 * found.sigma:.1f} ms"
        side = "later" if found.offset > 0 else "earlier"
        reason = f"shots are stamped {figure} {side} than they are exposed, by odometry's time ({found.shots} shots)"
        return [Event(EventKind.LATENCY, time, reason=reason)]

    def _take(self, look: Look, belief: Belief, path: DrivenPath) -> bool:
        """Take a shot; tell whether it is of use."""
        limits = self._config.latency
        if self.shots and look.time < self.shots[-1].time + limits.spacing_s:
            return False
        accepted = _sightings(look, belief, EventKind.ACCEPTED)
        rejected = _sightings(look, belief, EventKind.GATED)
        around = self._around(look.time, path) if accepted or rejected else None
        if around is None:
            return False
        motion = path.motion(self.shots[-1].time if self.shots else look.time, look.time)
        nearby = path.motion(look.time - limits.search_s, look.time + limits.search_s)
        if nearby is None:
            return False
        if motion is None:
            self.shots.clear()
            motion = path.motion(look.time, look.time)
        if motion is None:
            return False
        jitter = nearby.covariance / nearby.duration
        self.shots.append(SeenFrom(look.time, motion, around, jitter, accepted, rejected))
        while look.time - self.shots[0].time > limits.span_s:
            del self.shots[0]
        return True

    def _around(self, time: float, path: DrivenPath) -> FloatArray | None:
        """Return where the forklift was at the trial offsets; None where odometry does not say."""
        limits = self._config.latency
        offsets = trial_offsets(limits)
        within = path.rates_within(time - limits.search_s, time + limits.search_s)
        if within is None or np.diff(within[0]).max() > limits.max_gap_s:
            return None
        times, rates = within
        spans = np.diff(times)
        heading = np.concatenate([[0.0], np.cumsum(spans * rates[:, 2])])
        heading -= np.interp(time, times, heading)
        middle = (heading[:-1] + heading[1:]) / 2
        cos, sin = np.cos(middle), np.sin(middle)
        ahead, aside = spans * rates[:, 0], spans * rates[:, 1]
        ways = np.concatenate([[[0.0, 0.0]], np.cumsum([cos * ahead - sin * aside, sin * ahead + cos * aside], 1).T])
        poses = np.column_stack([ways, heading])
        now = np.array([np.interp(time, times, column) for column in poses.T])
        at = time - offsets
        exposed = np.stack([np.interp(at, times, column) for column in (poses - now).T], axis=1)
        return np.asarray(smoothing() @ exposed)


def _sightings(look: Look, belief: Belief, kind: EventKind) -> tuple[Sighting, ...]:
    """Return the whole poses of a shot that a track took, or rejected in its place."""
    found = [
        (fate.key, one)
        for one, fate in zip(look.observations, belief.fates, strict=True)
        if fate.kind is kind and fate.key is not None and one.is_whole
    ]
    found.sort(key=lambda pair: pair[0])
    return tuple(
        Sighting(key, one.values[[0, 1, 3]], one.own[PLANE], one.common[[0, 1, 3]])
        for key, one in found[:MOST_PALLETS]
    )
