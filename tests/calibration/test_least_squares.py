"""What all adjustments share: descents that find the least squares, and what residuals tell of their errors."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest

from calibration.least_squares import (
    MEDIAN_LENGTH,
    descend,
    descend_damped,
    error_factor,
    inverse_normal,
    redundancies,
    within_gate,
)
from palletloc.geometry import FloatArray

DESIGN = np.random.default_rng(0).normal(size=(40, 3))
TRUTH = np.array([2.0, -1.0, 0.5])


@dataclass(frozen=True)
class Values:
    x: FloatArray

    def moved(self, step: FloatArray) -> "Values":
        return Values(self.x + step)


def residuals_to(seen: FloatArray) -> Callable[[Values], FloatArray]:
    return lambda values: np.asarray(DESIGN @ values.x - seen)


@pytest.mark.parametrize("derivatives", [None, lambda _values, _step: DESIGN])
def test_a_descent_ends_at_the_least_squares(derivatives: Callable[[Values, FloatArray], FloatArray] | None) -> None:
    seen = DESIGN @ TRUTH + np.random.default_rng(1).normal(size=40)
    found = descend(residuals_to(seen), Values(np.zeros(3)), np.ones(3), "linear", derivatives)
    np.testing.assert_allclose(found.x, np.linalg.lstsq(DESIGN, seen)[0], atol=1e-6)


def test_a_robust_descent_is_not_moved_by_single_wrong_values() -> None:
    seen = DESIGN @ TRUTH
    seen[:4] += 1000.0
    plain, robust = (
        descend(residuals_to(seen), Values(np.zeros(3)), np.ones(3), loss) for loss in ("linear", "soft_l1")
    )
    assert np.abs(robust.x - TRUTH).max() < 1.0 < np.abs(plain.x - TRUTH).max()


def test_a_damped_descent_ends_at_the_least_squares_and_never_rises() -> None:
    seen, costs = DESIGN @ TRUTH + np.random.default_rng(1).normal(size=40), list[float]()

    def cost(x: FloatArray) -> float:
        return float(((DESIGN @ x - seen) ** 2).sum())

    def step(x: FloatArray) -> Callable[[float], FloatArray | None]:
        costs.append(cost(x))
        normal, right = DESIGN.T @ DESIGN, DESIGN.T @ (seen - DESIGN @ x)
        return lambda damping: x + np.linalg.solve(normal + damping * np.diag(np.diag(normal)), right)

    found = descend_damped(np.zeros(3), cost, step, 1e3, 60, 1e-14)
    np.testing.assert_allclose(found, np.linalg.lstsq(DESIGN, seen)[0], atol=1e-6)
    assert (np.diff(costs) < 0).all()


def test_a_damped_descent_stays_where_no_step_helps() -> None:
    assert descend_damped(1.0, lambda x: x**2, lambda _: lambda _: None, 1.0, 10, 0.0) == 1.0


def test_redundancies_add_up_to_the_observations_less_the_unknowns() -> None:
    covariance = inverse_normal(DESIGN)
    np.testing.assert_array_equal(covariance, covariance.T)
    left = redundancies(DESIGN, covariance)
    assert left.sum() == pytest.approx(40 - 3)
    assert ((left > 0) & (left < 1)).all()


def test_the_gate_passes_what_is_normal_whatever_its_scale() -> None:
    rng = np.random.default_rng(2)
    pairs = rng.normal(size=(20000, 2))
    assert np.median(np.linalg.norm(pairs, axis=1)) == pytest.approx(MEDIAN_LENGTH, rel=0.02)
    for scale in (1.0, 30.0):
        assert 1 - within_gate(scale * pairs).mean() == pytest.approx(np.exp(-8), abs=4e-4)
    assert within_gate(0.001 * pairs + np.array([3.0, 0.0])).all()


@pytest.mark.parametrize(("square", "factor"), [(20.0, 1.0), (35.0, 1.0), (80.0, 2.0)])
def test_stated_errors_are_believed_unless_the_residuals_contradict_them(square: float, factor: float) -> None:
    assert error_factor(square, 20.0) == factor
    assert error_factor(square, 0.5) == 1.0
