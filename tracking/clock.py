"""Whether an input comes in time: inside the window, too late, or from another clock."""

from __future__ import annotations

import math
from typing import NamedTuple

from tracking.config import WindowConfig

MOST_KEPT = 512
"""How many times of late inputs are kept."""


class Lateness(NamedTuple):
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

    def judge(self, time: float) -> Lateness:
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
            return Lateness(age)
        if self._paused(time):
            follows = len(self.elsewhere)
            self.newest = max(time, *self.elsewhere)
            self.elsewhere.clear()
            return Lateness(age, follows=follows)
        if self.elsewhere and abs(time - self.elsewhere[-1]) > config.window_s:
            self.elsewhere.clear()
        follows = len(self.elsewhere)
        self.elsewhere.append(time)
        jumped = age < 0 or age > config.max_jump_s
        spanned = max(self.elsewhere) - min(self.elsewhere) >= config.window_s
        if len(self.elsewhere) >= config.restart_inputs and (jumped or spanned):
            self.newest = max(self.elsewhere[-config.restart_inputs :])
            self.elsewhere.clear()
            return Lateness(0.0, jumped=True, restarted=True, follows=follows)
        del self.elsewhere[: -max(config.restart_inputs, MOST_KEPT)]
        return Lateness(age, in_time=False, jumped=jumped, follows=follows)

    def _paused(self, time: float) -> bool:
        """Tell whether an input and the one before it are both ahead, but not too far."""
        ahead = [one - self.newest for one in (*self.elsewhere[-1:], time)]
        return len(ahead) == 2 and all(self._config.window_s < one <= self._config.max_jump_s for one in ahead)
