"""Whether an input comes in time: inside the window, too late, or from another clock."""

from __future__ import annotations

import math
from typing import NamedTuple

from tracking.config import WindowConfig


class Lateness(NamedTuple):
    """How an input's time stands to that of the newest one."""

    age: float
    """How much older it is, in seconds; negative for a newer one."""
    in_time: bool
    """Whether it can be put in its place."""
    jumped: bool
    """Whether it is so far off that a clock must be wrong."""
    restarted: bool
    """Whether so many inputs came from there that it is the present now."""


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

    def judge(self, time: float) -> Lateness:
        """Tell whether an input comes in time, and take note of it.

        A single far time is doubted. When several inputs in a row come from there, near each other, or when for a
        whole window nothing but late ones come, time itself has jumped: a replay began again, a clock was set.

        Parameters
        ----------
        time : float
            Of the input, in seconds.
        """
        if not math.isfinite(self.newest):
            self.newest = time
        config, age = self._config, self.newest - time
        if -config.max_jump_s <= age <= config.window_s:
            self.newest = max(self.newest, time)
            self.elsewhere.clear()
            return Lateness(age, True, False, False)
        if self.elsewhere and abs(time - self.elsewhere[-1]) > config.window_s:
            self.elsewhere.clear()
        self.elsewhere.append(time)
        jumped = abs(age) > config.max_jump_s
        spanned = max(self.elsewhere) - min(self.elsewhere) >= config.window_s
        if len(self.elsewhere) >= config.restart_inputs and (jumped or spanned):
            self.newest = max(self.elsewhere[-config.restart_inputs :])
            self.elsewhere.clear()
            return Lateness(0.0, True, True, True)
        del self.elsewhere[: -max(config.restart_inputs, 512)]
        return Lateness(age, False, jumped, False)
