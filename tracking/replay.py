"""Inputs of the last seconds in the order of their times, and what was believed after each shot.

An input that comes late is put in its place, and every step from there on is done again.
"""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from dataclasses import dataclass, replace

from tracking.belief import Belief, Rules, advance, carried
from tracking.motion import no_motion
from tracking.observation import Observation
from tracking.path import DrivenPath


@dataclass(frozen=True, slots=True, eq=False)
class Look:
    """A shot: all observations of one time."""

    time: float
    """When it was exposed, in seconds."""
    observations: tuple[Observation, ...] = ()
    """In their order."""

    def plus(self, observation: Observation) -> Look:
        """Return the look with one more observation in its place."""
        together = sorted((*self.observations, observation), key=lambda one: one.order)
        return replace(self, observations=tuple(together))


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
        if before.time is None:
            motion = no_motion() if self.path.reaches(look.time) else None
        else:
            motion = self.path.motion(before.time, look.time)
        return advance(before, motion, look.time, look.observations, self._rules)

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
        count = bisect_left(self._times, horizon)
        final = tuple(self.looks[:count])
        if count:
            self.base = self.beliefs[count - 1]
            if self._past is not None:
                self._past += self.beliefs[:count]
            del self.looks[:count], self.beliefs[:count], self._times[:count]
        self._carry_base(horizon)
        needed = horizon if self.base.time is None else min(self.base.time, horizon)
        self.path.forget_before(needed - self._rules.config.latency.search_s)
        return final

    def _carry_base(self, horizon: float) -> None:
        """Carry what is believed along while no shot comes, so that old odometry can be dropped.

        Where a look is kept, its step began at the base as it is; it takes the base's place before long.
        """
        time = self.base.time
        if time is None or self.looks or horizon - time < self._rules.config.window.window_s:
            return
        until = self.path.last_before(horizon)
        motion = None if until is None or until <= time else self.path.motion(time, until)
        if until is not None and motion is not None:
            self.base = carried(self.base, motion, until, self._rules)
            if self._past is not None:
                self._past.append(self.base)
