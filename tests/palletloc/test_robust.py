"""Robust fits: weights fall with residuals, and wrong values do not move a line."""

from collections.abc import Callable
from functools import partial

import numpy as np
import pytest
from scipy.stats import norm

from palletloc.geometry import FloatArray
from palletloc.robust import (
    SIGMA_PER_MEDIAN,
    cauchy_weights,
    huber_weights,
    reweighted,
    robust_sigma,
    tukey_weights,
)

WEIGHTS = [tukey_weights, huber_weights, cauchy_weights]
Weigh = Callable[..., FloatArray]


@pytest.mark.parametrize("weigh", WEIGHTS)
def test_weights_fall_from_one_to_zero_whatever_the_sign_and_the_scale(weigh: Weigh) -> None:
    residuals = np.linspace(0, 1e4, 10001)
    weights = weigh(residuals)
    assert weights[0] == 1
    assert (np.diff(weights) <= 0).all()
    assert (weights >= 0).all()
    assert weights[-1] < 1e-3
    np.testing.assert_array_equal(weigh(-residuals), weights)
    np.testing.assert_allclose(weigh(7 * residuals, 7.0), weights, rtol=1e-12)


@pytest.mark.parametrize(("weigh", "efficiency"), list(zip(WEIGHTS, (0.95, 0.96, 0.93), strict=True)))
def test_the_constants_have_the_efficiency_that_they_state(weigh: Weigh, efficiency: float) -> None:
    # Of an M-estimator with psi(x) = x w(x) on normal residuals: E[psi']^2 / E[psi^2].
    x = np.linspace(-12, 12, 240001)
    density = norm.pdf(x) * (x[1] - x[0])
    psi = x * weigh(x)
    slope = np.gradient(psi, x)
    assert (slope @ density) ** 2 / (psi**2 @ density) == pytest.approx(efficiency, abs=0.005)


def test_the_spread_of_normal_residuals_is_their_standard_deviation() -> None:
    assert pytest.approx(1 / norm.ppf(0.75), abs=1e-4) == SIGMA_PER_MEDIAN
    assert robust_sigma(np.array([-1.0, 1.0, 1e9])) == SIGMA_PER_MEDIAN
    assert robust_sigma(np.zeros(3), 0.5) == 0.5


@pytest.mark.parametrize("weigh", WEIGHTS)
def test_a_third_of_wrong_values_does_not_move_a_line(weigh: Weigh) -> None:
    rng = np.random.default_rng(0)
    x = rng.uniform(-1, 1, 300)
    design = np.stack([x, np.ones(300)], axis=1)
    values = design @ [2.0, 3.0] + rng.normal(0, 0.01, 300)
    values[:100] += rng.choice([-1.0, 1.0], 100) * rng.uniform(0.5, 1.0, 100)

    def fit(weights: FloatArray, _: float) -> FloatArray:
        return np.asarray(np.linalg.solve((design * weights[:, None]).T @ design, design.T @ (weights * values)))

    found = reweighted(fit, lambda line: values - design @ line, weigh, robust_sigma, np.ones(300), 20)
    np.testing.assert_allclose(found.solution, [2.0, 3.0], atol=0.01)
    assert found.weights[:100].max() < 0.1 < found.weights[100:].min() or weigh is not tukey_weights
    # Once the weights have settled, more rounds change nothing.
    early = reweighted(fit, lambda line: values - design @ line, weigh, robust_sigma, np.ones(300), 200, 1e-6)
    np.testing.assert_allclose(early.solution, found.solution, atol=1e-4)


def test_one_round_is_the_plain_fit() -> None:
    values = np.array([0.0, 0.0, 9.0])
    mean = reweighted(
        lambda weights, _: np.array([np.average(values, weights=weights)]),
        lambda at: values - at,
        partial(huber_weights, tuning=1.0),
        lambda _: 1.0,
        np.ones(3),
        1,
    )
    assert mean.solution[0] == 3.0
    np.testing.assert_allclose(mean.weights, [1 / 3, 1 / 3, 1 / 6])
