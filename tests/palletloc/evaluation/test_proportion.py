import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import binom

from palletloc.evaluation.proportion import clopper_pearson, lower_bound, upper_bound

counts = st.integers(1, 200).flatmap(lambda n: st.tuples(st.integers(0, n), st.just(n)))
confidences = st.floats(0.5, 0.999)


@given(counts, confidences)
def test_the_ends_are_where_a_binomial_tail_holds_half_the_rest(count: tuple[int, int], confidence: float) -> None:
    successes, trials = count
    found = clopper_pearson(successes, trials, confidence)
    tail = (1 - confidence) / 2
    if successes:
        assert binom.sf(successes - 1, trials, found.low) == pytest.approx(tail, rel=1e-6)
    if successes < trials:
        assert binom.cdf(successes, trials, found.high) == pytest.approx(tail, rel=1e-6)
    assert 0 <= found.low <= found.value <= found.high <= 1


@given(counts)
def test_failures_are_successes_seen_from_the_other_side(count: tuple[int, int]) -> None:
    successes, trials = count
    one, other = clopper_pearson(successes, trials), clopper_pearson(trials - successes, trials)
    assert (one.low, one.high) == pytest.approx((1 - other.high, 1 - other.low))


def test_without_a_success_or_a_failure_the_interval_reaches_the_end() -> None:
    assert clopper_pearson(0, 20).low == 0
    assert clopper_pearson(20, 20).high == 1


def test_the_interval_covers_at_least_as_often_as_it_says() -> None:
    trials, true = 30, 0.9
    chances = binom.pmf(np.arange(trials + 1), trials, true)
    covers = [
        found.low <= true <= found.high for found in (clopper_pearson(k, trials, 0.9) for k in range(trials + 1))
    ]
    assert 0.9 <= float(chances @ covers) < 1


def test_with_every_trial_a_success_the_bound_is_a_power() -> None:
    assert lower_bound(30, 30, 0.9) == pytest.approx(0.1 ** (1 / 30))
    assert upper_bound(0, 30, 0.9) == pytest.approx(1 - 0.1 ** (1 / 30))


def test_without_a_trial_nothing_is_known() -> None:
    found = clopper_pearson(0, 0)
    assert (found.low, found.high) == (0, 1)
    assert np.isnan(found.value)


@pytest.mark.parametrize(("successes", "trials", "confidence"), [(-1, 3, 0.9), (4, 3, 0.9), (1, 3, 0.0), (1, 3, 1.0)])
def test_impossible_counts_are_refused(successes: int, trials: int, confidence: float) -> None:
    with pytest.raises(ValueError, match="expected"):
        clopper_pearson(successes, trials, confidence)
