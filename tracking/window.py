"""Inputs of the last seconds in the order of their times, and what was believed after each shot.

An input that comes late is put in its place, and every step from there on is done again. The clock decides by the
stamps alone which inputs still come in time.
"""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from dataclasses import dataclass, replace
from operator import attrgetter
from typing import NamedTuple

from tracking.belief import Belief, UpdateModel
from tracking.config import WindowConfig
from tracking.driven_path import DrivenPath
from tracking.motion import no_motion
from tracking.observation import Observation
from tracking.update import Prediction, advance, carried, waiting

_ORDER = attrgetter("order")
"""By which the observations of a shot are put in order."""
MOST_KEPT = 512
"""Times of late inputs that are kept: more than come in a window at any usual rate, and few kilobytes."""


@dataclass(frozen=True, slots=True, eq=False)
class ShotMeasurements:
    """A shot: all observations of one time."""

    time: float
    """When it was exposed, in seconds."""
    observations: tuple[Observation, ...] = ()
    """In their order."""

    def plus(self, observation: Observation) -> ShotMeasurements | None:
        """Return the shot with one more observation in its place; None where it has an equal one."""
        known = self.observations
        at = bisect_left(known, observation.order, key=_ORDER)
        if at < len(known) and known[at].order == observation.order:
            return None
        return ShotMeasurements(self.time, (*known[:at], observation, *known[at:]))


class Window:
    """Shots and odometry inside the window, and the belief after each shot.

    Parameters
    ----------
    model : UpdateModel
        Parameters, filter and sizes.
    base : Belief
        What was believed before the first shot that is kept.
    past : list of Belief, optional
        Takes up what was believed after every step that is final.
    """

    def __init__(self, model: UpdateModel, base: Belief, past: list[Belief] | None = None) -> None:
        self._model = model
        self._past = past
        self.path = DrivenPath(model.config.odometry, model.config.path)
        self.base = base
        self.shots: list[ShotMeasurements] = []
        self.beliefs: list[Belief] = []
        self._times: list[float] = []
        self._prediction: Prediction | None = None
        """Of the last step that was done: more measurements of that shot may come."""

    @property
    def current(self) -> Belief:
        """What is believed after the last shot."""
        return self.beliefs[-1] if self.beliefs else self.base

    def belief_at(self, time: float) -> Belief:
        """Return what was believed after the last shot up to a time."""
        at = bisect_right(self._times, time)
        return self.beliefs[at - 1] if at else self.base

    def place(self, time: float, observation: Observation | None = None) -> bool:
        """Take a shot in its place, or one more observation of it; the steps from there on are not done yet.

        Parameters
        ----------
        time : float
            Of the shot, in seconds.
        observation : Observation, optional
            Of the shot.

        Returns
        -------
        bool
            Whether it is new.
        """
        at = bisect_left(self._times, time)
        known = at < len(self._times) and self._times[at] == time
        before = self.shots[at] if known else ShotMeasurements(time)
        shot = before if observation is None else before.plus(observation)
        if shot is None or (known and shot is before):
            return False
        if known:
            self.shots[at] = shot
        else:
            self.shots.insert(at, shot)
            self._times.insert(at, time)
        del self.beliefs[at:]
        return True

    def run(self, since: float = math.inf) -> int:
        """Do the steps of all shots that have not been done, or in which something has changed.

        Parameters
        ----------
        since : float
            Time from which on motions have changed, in seconds.

        Returns
        -------
        int
            Index of the first shot whose step was done; the number of shots where there is none.
        """
        first = min(bisect_left(self._times, since), len(self.beliefs))
        del self.beliefs[first:]
        for shot in self.shots[first:]:
            self.beliefs.append(self._step(self.current, shot))
        return first

    def _step(self, before: Belief, shot: ShotMeasurements) -> Belief:
        via = self._carried(before, shot.time)
        before = via[-1] if via else before
        if before.time is None:
            motion = no_motion() if self.path.reaches(shot.time) else None
        else:
            motion = self.path.motion(before.time, shot.time)
        if motion is None:
            return replace(waiting(before, len(shot.observations)), via=tuple(via))
        if self._prediction is None or not self._prediction.serves(before, motion, shot.time):
            self._prediction = Prediction(before, motion, shot.time, self._model)
        belief = advance(self._prediction, shot.observations, self._model)
        return replace(belief, via=tuple(via)) if via else belief

    def _carried(self, belief: Belief, until: float) -> list[Belief]:
        """Return the steps of a belief that is carried along while no shot comes: old odometry can then be dropped.

        It stops at the last sample of every whole window that ended a window before: these are the same whether they
        are asked for at the next shot or when an older input can come no more.
        """
        window, steps = self._model.config.window.window_s, list[Belief]()
        while belief.time is not None and belief.time + window + window < until:
            following = self.path.first_after(belief.time)
            if following is None:
                break
            stop = belief.time + window * max(1, math.ceil((following - belief.time) / window))
            last = self.path.last_before(stop)
            motion = None if last is None or stop + window >= until else self.path.motion(belief.time, last)
            if last is None or motion is None:
                break
            belief = carried(belief, motion, last, self._model)
            steps.append(belief)
        return steps

    def final_count(self, horizon: float) -> int:
        """Return how many shots no input from a time on can change any more.

        A shot waits for a sample of odometry after it that is as old: until then another one may come between them,
        but it waits no longer than another window.

        Parameters
        ----------
        horizon : float
            In seconds.
        """
        sure = self.path.last_before(math.nextafter(horizon, -math.inf))
        count = bisect_left(self._times, horizon - self._model.config.window.window_s)
        return count if sure is None else max(count, bisect_right(self._times, sure))

    def forget_before(self, horizon: float) -> tuple[ShotMeasurements, ...]:
        """Drop what no input from a time on can change any more.

        Parameters
        ----------
        horizon : float
            In seconds.

        Returns
        -------
        tuple of ShotMeasurements
            The shots whose steps are final now.
        """
        count = self.final_count(horizon)
        final = tuple(self.shots[:count])
        if count:
            self.base = self.beliefs[count - 1]
            if self._past is not None:
                self._past += self.beliefs[:count]
            del self.shots[:count], self.beliefs[:count], self._times[:count]
        steps = self._carried(self.base, horizon)
        if steps:
            self.base = steps[-1]
        if self._past is not None:
            self._past += steps
        needed = horizon if self.base.time is None else min(self.base.time, horizon)
        self.path.forget_before(needed - self._model.config.latency.search_s)
        return final


class Arrival(NamedTuple):
    """How an input's time stands to that of the newest one."""

    age: float
    """How much older it is, in seconds; negative for a newer one."""
    in_time: bool = True
    """Whether it can be put in its place."""
    jumped: bool = False
    """Whether it is so far off that a clock may be wrong."""
    restarted: bool = False
    """Whether so many inputs came from there that it is the present now."""
    follows: int = 0
    """How many inputs before it in a row came from there."""


class Clock:
    """Knows the newest time, by the inputs' stamps alone.

    Parameters
    ----------
    config : WindowConfig
        The window, and when a jump is believed.
    """

    def __init__(self, config: WindowConfig) -> None:
        self._config = config
        self.newest = -math.inf
        self.elsewhere: list[float] = []
        """Times of the inputs in a row that were not in time, the last ones."""

    @property
    def horizon(self) -> float:
        """The earliest time that is still in time, in seconds."""
        return self.newest - self._config.window_s

    def judge(self, time: float) -> Arrival:
        """Tell whether an input comes in time, and take note of it.

        A single far time is doubted. A pause is over when two inputs in a row are ahead. When several inputs in a row
        come from elsewhere, near each other, or when for a whole window nothing but late ones come, time itself has
        jumped: a replay began again, a clock was set.

        Parameters
        ----------
        time : float
            Of the input, in seconds.
        """
        if not math.isfinite(self.newest):
            self.newest = time
        config, age = self._config, self.newest - time
        if abs(age) <= config.window_s:
            self.newest = max(self.newest, time)
            self.elsewhere.clear()
            return Arrival(age)
        if self._paused(time):
            follows = len(self.elsewhere)
            self.newest = max(time, *self.elsewhere)
            self.elsewhere.clear()
            return Arrival(age, follows=follows)
        if self.elsewhere and abs(time - self.elsewhere[-1]) > config.window_s:
            self.elsewhere.clear()
        follows = len(self.elsewhere)
        self.elsewhere.append(time)
        jumped = age < 0 or age > config.max_jump_s
        spanned = max(self.elsewhere) - min(self.elsewhere) >= config.window_s
        if len(self.elsewhere) >= config.restart_inputs and (jumped or spanned):
            self.newest = max(self.elsewhere[-config.restart_inputs :])
            self.elsewhere.clear()
            return Arrival(0.0, jumped=True, restarted=True, follows=follows)
        del self.elsewhere[: -max(config.restart_inputs, MOST_KEPT)]
        return Arrival(age, in_time=False, jumped=jumped, follows=follows)

    def _paused(self, time: float) -> bool:
        """Tell whether an input and the one before it are both ahead, but not too far."""
        ahead = [each - self.newest for each in (*self.elsewhere[-1:], time)]
        return len(ahead) == 2 and all(self._config.window_s < step <= self._config.max_jump_s for step in ahead)
