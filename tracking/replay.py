"""Inputs of the last seconds in the order of their times, and what was believed after each shot.

An input that comes late is put in its place, and every step from there on is done again.
"""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from dataclasses import dataclass, replace
from operator import attrgetter

from tracking.belief import Belief, Rules
from tracking.foreseen import Foreseen
from tracking.motion import no_motion
from tracking.observation import Observation
from tracking.path import DrivenPath
from tracking.step import advance, carried, waiting

_ORDER = attrgetter("order")


@dataclass(frozen=True, slots=True, eq=False)
class Look:
    """A shot: all observations of one time."""

    time: float
    """When it was exposed, in seconds."""
    observations: tuple[Observation, ...] = ()
    """In their order."""

    def holds(self, observation: Observation) -> bool:
        """Tell whether it has an observation that says the same."""
        at = bisect_left(self.observations, observation.order, key=_ORDER)
        return at < len(self.observations) and self.observations[at].order == observation.order

    def plus(self, observation: Observation) -> Look:
        """Return the look with one more observation in its place."""
        at = bisect_left(self.observations, observation.order, key=_ORDER)
        return Look(self.time, (*self.observations[:at], observation, *self.observations[at:]))


class Replay:
    """Looks and odometry inside the window, and the belief after each look.

    Parameters
    ----------
    rules : Rules
        Parameters, filter and sizes.
    base : Belief
        What was believed before the first look that is kept.
    past : list of Belief, optional
        Takes up what was believed after every step that is final.
    """

    def __init__(self, rules: Rules, base: Belief, past: list[Belief] | None = None) -> None:
        self._rules = rules
        self._past = past
        self.path = DrivenPath(rules.config.odometry, rules.config.path)
        self.base = base
        self.looks: list[Look] = []
        self.beliefs: list[Belief] = []
        self._times: list[float] = []
        self._foreseen: Foreseen | None = None
        """Of the last step that was done: more measurements of that shot may come."""

    @property
    def current(self) -> Belief:
        """What is believed after the last look."""
        return self.beliefs[-1] if self.beliefs else self.base

    def look_at(self, time: float) -> Look | None:
        """Return the look of exactly that time."""
        at = bisect_left(self._times, time)
        return self.looks[at] if at < len(self.looks) and self._times[at] == time else None

    def belief_at(self, time: float) -> Belief:
        """Return what was believed after the last look up to a time."""
        at = bisect_right(self._times, time)
        return self.beliefs[at - 1] if at else self.base

    def place(self, look: Look) -> None:
        """Take a look in its place, or in place of one of the same time; its step is not done yet."""
        at = bisect_left(self._times, look.time)
        if at < len(self.looks) and self._times[at] == look.time:
            self.looks[at] = look
        else:
            self.looks.insert(at, look)
            self._times.insert(at, look.time)
        del self.beliefs[at:]

    def run(self, since: float = math.inf) -> int:
        """Do the steps of all looks that have not been done, or in which something has changed.

        Parameters
        ----------
        since : float
            Time from which on motions have changed, in seconds.

        Returns
        -------
        int
            Index of the first look whose step was done; the number of looks where there is none.
        """
        first = min(bisect_left(self._times, since), len(self.beliefs))
        del self.beliefs[first:]
        for look in self.looks[first:]:
            self.beliefs.append(self._step(self.current, look))
        return first

    def _step(self, before: Belief, look: Look) -> Belief:
        via = self._carried(before, look.time)
        before = via[-1] if via else before
        if before.time is None:
            motion = no_motion() if self.path.reaches(look.time) else None
        else:
            motion = self.path.motion(before.time, look.time)
        if motion is None:
            return replace(waiting(before, len(look.observations)), via=tuple(via))
        if self._foreseen is None or not self._foreseen.serves(before, motion, look.time):
            self._foreseen = Foreseen(before, motion, look.time, self._rules)
        belief = advance(self._foreseen, look.observations, self._rules)
        return replace(belief, via=tuple(via)) if via else belief

    def _carried(self, belief: Belief, until: float) -> list[Belief]:
        """Return the steps of a belief that is carried along while no shot comes: old odometry can then be dropped.

        It stops at the last sample of every whole window that ended a window before: these are the same whether they
        are asked for at the next shot or when an older input can come no more.
        """
        window, steps = self._rules.config.window.window_s, list[Belief]()
        while belief.time is not None and belief.time + window + window < until:
            following = self.path.first_after(belief.time)
            if following is None:
                break
            stop = belief.time + window * max(1, math.ceil((following - belief.time) / window))
            last = self.path.last_before(stop)
            motion = None if last is None or stop + window >= until else self.path.motion(belief.time, last)
            if last is None or motion is None:
                break
            belief = carried(belief, motion, last, self._rules)
            steps.append(belief)
        return steps

    def final_count(self, horizon: float) -> int:
        """Return how many looks no input from a time on can change any more.

        A shot waits for a sample of odometry after it that is as old: until then another one may come between them,
        but it waits no longer than another window.

        Parameters
        ----------
        horizon : float
            In seconds.
        """
        sure = self.path.last_before(math.nextafter(horizon, -math.inf))
        count = bisect_left(self._times, horizon - self._rules.config.window.window_s)
        return count if sure is None else max(count, bisect_right(self._times, sure))

    def forget_before(self, horizon: float) -> tuple[Look, ...]:
        """Drop what no input from a time on can change any more.

        Parameters
        ----------
        horizon : float
            In seconds.

        Returns
        -------
        tuple of Look
            The looks whose steps are final now.
        """
        count = self.final_count(horizon)
        final = tuple(self.looks[:count])
        if count:
            self.base = self.beliefs[count - 1]
            if self._past is not None:
                self._past += self.beliefs[:count]
            del self.looks[:count], self.beliefs[:count], self._times[:count]
        steps = self._carried(self.base, horizon)
        if steps:
            self.base = steps[-1]
        if self._past is not None:
            self._past += steps
        needed = horizon if self.base.time is None else min(self.base.time, horizon)
        self.path.forget_before(needed - self._rules.config.latency.search_s)
        return final
