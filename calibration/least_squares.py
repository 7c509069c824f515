"""What all adjustments share: two descents, the gate for outliers, and the factors that residuals tell.

`descend` is SciPy's (trust region reflective). `descend_damped` leaves the equations of a step to the problem, which
can eliminate what stands in few of them: D. W. Marquardt, "An algorithm for least-squares estimation of nonlinear
parameters", SIAM J. 11(2), 1963. Residuals are in units of their standard deviations.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Literal, Protocol, Self, TypeVar

import numpy as np
from scipy.optimize import least_squares
from scipy.stats import chi2

from palletloc.geometry import BoolArray, FloatArray

_SOFT = 2.0
"""Residuals well beyond this many standard deviations count by their size instead of their square (soft l1)."""
MEDIAN_LENGTH = 1.1774
"""Median length of two unit normal numbers: sqrt(2 ln 2)."""
_GATE = 4.0
"""A corner farther off than this many robust standard deviations is an outlier: one good corner in 3000 is lost."""
_CONTRADICTION = 0.01
"""Stated errors are believed unless the residuals are less probable than this."""
_MOST_DAMPING, _LEAST_DAMPING = 1e12, 1e-12
"""Relative to the diagonal of the normal equations: no step is left above the one, the other is as good as none."""
_FACTOR = 10.0
"""By which the damping rises after a step that does not help, and falls after one that does: Marquardt's own."""


class _Movable(Protocol):
    """Values of unknowns that can be moved."""

    def moved(self, step: FloatArray) -> Self:
        """Return the values after a step."""


_State = TypeVar("_State", bound=_Movable)
_Unknowns = TypeVar("_Unknowns")


def descend(
    residuals: Callable[[_State], FloatArray],
    start: _State,
    scale: FloatArray,
    loss: Literal["linear", "soft_l1"],
    derivatives: Callable[[_State, FloatArray], FloatArray] | None = None,
    evaluations: int = 40,
    tolerance: float = 1e-8,
) -> _State:
    """Return the values with the least sum of losses, from a start near it.

    Parameters
    ----------
    residuals : callable
        Returns the residuals of values, (m,).
    start : _State
        Where to begin.
    scale : (n,) array
        A small step of each unknown.
    loss : str
        ``soft_l1`` where observations may be wrong.
    derivatives : callable, optional
        Returns the derivatives of the residuals by a step from the start, (m, n), for the moved values and the step;
        differences without it.
    evaluations : int
        How many are made at most.
    tolerance : float
        The descent ends where a step is smaller than this part of the values.
    """

    def at(step: FloatArray) -> FloatArray:
        return residuals(start.moved(step))

    fit = partial(
        least_squares,
        at,
        np.zeros(len(scale)),
        loss=loss,
        f_scale=_SOFT,
        x_scale=scale,
        max_nfev=evaluations,
        xtol=tolerance,
    )
    if derivatives is None:
        return start.moved(np.asarray(fit().x, dtype=np.float64))

    def slope(step: FloatArray) -> FloatArray:
        return derivatives(start.moved(step), step)

    return start.moved(np.asarray(fit(jac=slope).x, dtype=np.float64))


def descend_damped(
    start: _Unknowns,
    cost: Callable[[_Unknowns], float],
    step: Callable[[_Unknowns], Callable[[float], _Unknowns | None]],
    damping: float,
    steps: int,
    settled: float,
) -> _Unknowns:
    """Return the unknowns with the least cost, from a start near it.

    Parameters
    ----------
    start : any
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


def inverse_normal(jacobian: FloatArray) -> FloatArray:
    """Return the covariance that derivatives in units of standard deviations give, (n, n).

    Raises
    ------
    numpy.linalg.LinAlgError
        If the observations leave a direction entirely free.
    """
    covariance = np.asarray(np.linalg.inv(jacobian.T @ jacobian), dtype=np.float64)
    return (covariance + covariance.T) / 2


def redundancies(jacobian: FloatArray, covariance: FloatArray) -> FloatArray:
    """Return the part of each residual that the unknowns do not take, (m,), from 0 to 1."""
    return np.asarray(1 - np.einsum("ij,jk,ik->i", jacobian, covariance, jacobian))


def within_gate(residuals: FloatArray) -> BoolArray:
    """Return which pairs of residuals, (m, 2), lie within four robust standard deviations, not below the stated."""
    length = np.linalg.norm(residuals, axis=-1)
    return np.asarray(length < _GATE * max(1.0, float(np.median(length)) / MEDIAN_LENGTH))


def error_factor(square: float, redundancy: float) -> float:
    """Return the factor on stated standard deviations that residuals tell; one unless they contradict them.

    Parameters
    ----------
    square : float
        Sum of the squared residuals in units of the stated standard deviations.
    redundancy : float
        Their number less what the unknowns take from it.
    """
    wrong = redundancy > 1 and square > chi2.isf(_CONTRADICTION, redundancy)
    return max(1.0, float(np.sqrt(square / redundancy))) if wrong else 1.0
