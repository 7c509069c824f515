"""CPU times of things to compare, taken in turns so that a machine that slows down slows all of them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from time import process_time

import numpy as np

from palletloc.geometry import FloatArray


@dataclass(frozen=True, slots=True)
class Timings:
    """CPU times of several cases, turn by turn."""

    seconds: Mapping[str, FloatArray]
    """(turns,) of each case, in the order in which they were taken."""

    def median(self, name: str) -> float:
        """Return the median time of a case, in seconds."""
        return float(np.median(self.seconds[name]))

    def ratio(self, name: str, base: str) -> float:
        """Return how many times longer than a base a case takes: the median of the turns' ratios."""
        return float(np.median(self.seconds[name] / self.seconds[base]))


def take_turns(cases: Mapping[str, Callable[[], object]], turns: int) -> Timings:
    """Time every case once in each turn.

    Parameters
    ----------
    cases : mapping of str to callable
        What to time.
    turns : int
        How often; one more turn before them is not counted.
    """
    seconds: dict[str, list[float]] = {name: [] for name in cases}
    for _ in range(turns + 1):
        for name, case in cases.items():
            started = process_time()
            case()
            seconds[name].append(process_time() - started)
    return Timings({name: np.array(times[1:]) for name, times in seconds.items()})


def joined(parts: list[Timings]) -> Timings:
    """Return the turns of several timings of the same cases as those of one."""
    return Timings({name: np.concatenate([part.seconds[name] for part in parts]) for name in parts[0].seconds})
