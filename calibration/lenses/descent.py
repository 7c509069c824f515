"""Damped least squares by Levenberg and Marquardt, for unknowns of any kind.

D. W. Marquardt, "An algorithm for least-squares estimation of nonlinear parameters", SIAM J. 11(2), 1963.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import numpy as np

from palletloc.geometry import FloatArray

State = TypeVar("State")
"""The unknowns, with all that is computed of them once."""
_MOST_DAMPING, _LEAST_DAMPING = 1e12, 1e-12
"""Relative to the diagonal of the normal equations: no step is left above the one, the other is as good as none."""
_FACTOR = 10.0
"""By which the damping rises after a step that does not help, and falls after one that does: Marquardt's own."""


def descend(
    start: State,
    cost: Callable[[State], float],
    step: Callable[[State], Callable[[float], State | None]],
    damping: float,
    steps: int,
    settled: float,
) -> State:
    """Return the unknowns with the least cost, from a start near it.

    Parameters
    ----------
    start : State
        Where to begin.
    cost : callable
        Returns the sum of losses; NaN counts as infinite.
    step : callable
        Returns what takes a step from some unknowns by a damping, or returns None where there is no such step.
    damping : float
        The first one, relative to the diagonal of the normal equations.
    steps : int
        At most so many are taken.
    settled : float
        A step that lowers the cost by no larger part of it is the last one.
    """
    state, least = start, cost(start)
    for _ in range(steps):
        damped = step(state)
        while damping < _MOST_DAMPING:
            trial = damped(damping)
            reached = np.inf if trial is None else cost(trial)
            if trial is not None and reached < least:
                break
            damping *= _FACTOR
        else:
            return state
        gain, state, least = least - reached, trial, reached
        if gain <= settled * least:
            return state
        damping = max(damping / _FACTOR, _LEAST_DAMPING)
    return state


def finite_cost(squares: FloatArray) -> float:
    """Return the sum of squared residuals, infinite where one of them is none."""
    total = float(squares.sum())
    return total if np.isfinite(total) else np.inf
