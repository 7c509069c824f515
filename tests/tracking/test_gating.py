from __future__ import annotations

import numpy as np
import pytest

from tracking.config import GateConfig
from tracking.gating import chi_square_limit, covariance_scale, huber_weight

GATE = GateConfig()


@pytest.mark.parametrize("dof", [1, 2, 3, 4])
def test_the_gate_lets_its_part_of_measurements_pass_whatever_their_size(dof: int) -> None:
    squares = (np.random.default_rng(dof).normal(size=(200_000, dof)) ** 2).sum(axis=1)
    assert np.mean(squares <= chi_square_limit(0.99, dof)) == pytest.approx(0.99, abs=0.001)


def test_ordinary_measurements_count_in_full_and_far_ones_less() -> None:
    limit = chi_square_limit(GATE.robust_probability, 4)
    assert huber_weight(limit, 4, GATE) == 1.0
    weights = [huber_weight(limit * factor, 4, GATE) for factor in (1.01, 2.0, 4.0)]
    assert weights == sorted(weights, reverse=True)
    assert weights[-1] == pytest.approx(0.5)


def test_covariances_are_scaled_only_where_innovations_leave_their_band() -> None:
    count = GATE.adapt_over
    assert covariance_scale([4.0] * (GATE.adapt_from - 1), GATE) == 1.0
    assert covariance_scale([4.0] * GATE.adapt_from, GATE) == 4.0
    assert covariance_scale([0.01] * (count - 1), GATE) == 1.0
    assert covariance_scale([1.1] * count, GATE) == 1.0
    assert covariance_scale([4.0] * count, GATE) == 4.0
    assert covariance_scale([9.0] * 5 + [4.0] * count, GATE) == 4.0
    assert covariance_scale([100.0] * count, GATE) == GATE.max_scale
    assert covariance_scale([0.01] * count, GATE) == GATE.min_scale
    assert covariance_scale([4.0] * count, GateConfig(adapt_over=0)) == 1.0


def test_honest_innovations_are_rarely_scaled() -> None:
    rng = np.random.default_rng(0)
    ratios = (rng.normal(size=(2000, GATE.adapt_over, 4)) ** 2).mean(axis=2)
    scaled = np.mean([covariance_scale(row.tolist(), GATE) != 1.0 for row in ratios])
    assert scaled < 0.02
