import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import binom, chi2, kstest

from palletloc.evaluation.requirement import Requirement, Verdict, check_requirement, needed_errors
from palletloc.evaluation.statistics import (
    Consistency,
    chi_square_check,
    clopper_pearson,
    lower_bound,
    nees,
    normalised,
    spread,
    upper_bound,
)
from palletloc.geometry import FloatArray

values = st.lists(st.floats(-1e3, 1e3), min_size=1, max_size=30)
counts = st.integers(1, 200).flatmap(lambda n: st.tuples(st.integers(0, n), st.just(n)))
confidences = st.floats(0.5, 0.999)


@given(values)
def test_the_mean_square_is_that_of_the_mean_and_the_deviations(errors: list[float]) -> None:
    found = spread(errors)
    assert found is not None
    assert found.rms**2 == pytest.approx(found.mean**2 + np.var(errors), abs=1e-6)


@given(values)
def test_turning_all_signs_turns_the_bias_and_no_size(errors: list[float]) -> None:
    found, turned = spread(errors), spread(-np.array(errors))
    assert found is not None
    assert turned is not None
    assert (turned.bias, turned.mean) == pytest.approx((-found.bias, -found.mean))
    sizes = ("n", "median", "rms", "p95", "maximum")
    assert [getattr(turned, name) for name in sizes] == pytest.approx([getattr(found, name) for name in sizes])


def test_the_95th_percentile_has_5_percent_above_and_nothing_has_no_spread() -> None:
    found = spread(np.arange(1, 102.0))
    assert found is not None
    assert (found.n, found.p95, found.maximum) == (101, 96.0, 101.0)
    assert spread([]) is None


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
    found, turned = clopper_pearson(successes, trials), clopper_pearson(trials - successes, trials)
    assert (found.low, found.high) == pytest.approx((1 - turned.high, 1 - turned.low))


def test_without_a_success_or_a_failure_the_interval_reaches_the_end_and_without_a_trial_nothing_is_known() -> None:
    assert (clopper_pearson(0, 20).low, clopper_pearson(20, 20).high) == (0, 1)
    found = clopper_pearson(0, 0)
    assert (found.low, found.high) == (0, 1)
    assert np.isnan(found.value)


def test_with_every_trial_a_success_the_bound_is_a_power_and_the_interval_covers_as_often_as_it_says() -> None:
    assert lower_bound(30, 30, 0.9) == pytest.approx(0.1 ** (1 / 30))
    assert upper_bound(0, 30, 0.9) == pytest.approx(1 - 0.1 ** (1 / 30))
    trials, true = 30, 0.9
    chances = binom.pmf(np.arange(trials + 1), trials, true)
    covers = [
        found.low <= true <= found.high for found in (clopper_pearson(k, trials, 0.9) for k in range(trials + 1))
    ]
    assert 0.9 <= float(chances @ covers) < 1


def test_impossible_counts_and_requests_are_refused() -> None:
    for successes, trials, confidence in ((-1, 3, 0.9), (4, 3, 0.9), (1, 3, 0.0), (1, 3, 1.0)):
        with pytest.raises(ValueError, match="expected"):
            clopper_pearson(successes, trials, confidence)
    for freedom, confidence in ((0, 0.95), (4, 0.0), (4, 1.0)):
        with pytest.raises(ValueError, match="expected"):
            chi_square_check([4.0], freedom, confidence)


def drawn(count: int, factor: float = 1.0) -> tuple[FloatArray, FloatArray]:
    """Return errors drawn from a covariance, and ``factor`` times that covariance."""
    rng = np.random.default_rng(8)
    root = rng.normal(size=(4, 4))
    return rng.normal(size=(count, 4)) @ root.T, factor * root @ root.T


def test_nees_of_draws_from_a_covariance_is_chi_square() -> None:
    errors, covariance = drawn(3000)
    assert kstest([nees(error, covariance) for error in errors], chi2(4).cdf).pvalue > 0.01


def test_normalised_errors_have_unit_variance_and_are_infinite_with_their_sign_without_one() -> None:
    rng = np.random.default_rng(1)
    error = rng.normal(scale=0.03, size=20000) - rng.normal(scale=0.04, size=20000)
    found = normalised(error, np.full(20000, 0.03**2 + 0.04**2))
    assert float(found.std()) == pytest.approx(1, abs=0.02)
    assert normalised(np.array([-0.1, 0.2, 0.2]), np.array([0.0, -1.0, 4e-2])).tolist() == [-np.inf, np.inf, 1.0]


@pytest.mark.parametrize(
    ("factor", "verdict"),
    [(1.0, Consistency.CONSISTENT), (0.25, Consistency.OVERCONFIDENT), (4.0, Consistency.UNDERCONFIDENT)],
)
def test_covariances_of_a_wrong_size_are_told(factor: float, verdict: Consistency) -> None:
    errors, covariance = drawn(200, factor)
    check = chi_square_check([nees(error, covariance) for error in errors], 4)
    assert check.verdict is verdict
    assert check.expected == 4
    assert check.low < 4 < check.high


def test_the_band_holds_the_mean_as_often_as_it_says() -> None:
    rng = np.random.default_rng(2)
    means = rng.chisquare(4, size=(4000, 10)).mean(axis=1)
    check = chi_square_check(np.full(10, 4.0), 4, confidence=0.9)
    assert np.mean((means >= check.low) & (means <= check.high)) == pytest.approx(0.9, abs=0.015)


def test_measurements_of_different_sizes_share_a_band() -> None:
    rng = np.random.default_rng(3)
    freedom = rng.integers(1, 5, size=400)
    check = chi_square_check(rng.chisquare(freedom), freedom)
    assert check.verdict is Consistency.CONSISTENT
    assert check.expected == pytest.approx(freedom.mean())
    assert check.inside == pytest.approx(0.95, abs=0.04)


def test_unknown_values_are_left_out_and_improper_ones_count() -> None:
    check = chi_square_check([np.nan, 4.0, np.inf], 4)
    assert (check.n, check.unknown, check.improper, check.mean) == (2, 1, 1, np.inf)
    assert check.verdict is Consistency.OVERCONFIDENT
    nothing = chi_square_check([np.nan], 4)
    assert (nothing.n, nothing.unknown, nothing.verdict) == (0, 1, Consistency.UNKNOWN)


def test_the_limits_by_default_are_2_degrees_and_2_cm() -> None:
    assert Requirement().limits.tolist() == [0.02, 0.02, 0.02, np.radians(2)]


@pytest.mark.parametrize(("name", "column"), [("depth", 0), ("along", 1), ("height", 2), ("yaw", 3)])
@pytest.mark.parametrize("sign", [-1, 1])
def test_each_quantity_has_its_own_limit(name: str, column: int, sign: int) -> None:
    requirement = dataclasses.replace(Requirement(), **{name: 0.5})
    offsets = np.zeros((3, 4))
    offsets[:, column] = np.array([0.49, 0.5, 0.51]) * sign
    checked = check_requirement(offsets, requirement)
    inside = {key: getattr(checked, key).proportion.successes for key in ("depth", "along", "height", "yaw")}
    assert inside.pop(name) == 2
    assert set(inside.values()) == {3}
    assert checked.together.proportion.successes == 2


def test_together_counts_what_is_inside_in_every_way() -> None:
    offsets = np.zeros((4, 4))
    offsets[0, 0] = offsets[1, 3] = 1.0
    checked = check_requirement(offsets)
    assert checked.depth.proportion.successes == checked.yaw.proportion.successes == 3
    assert checked.together.proportion.successes == 2


def test_59_good_errors_show_95_percent_and_58_do_not_and_errors_outside_that_it_is_not_met() -> None:
    # 0.95 ** 59 < 0.05 < 0.95 ** 58
    assert check_requirement(np.zeros((59, 4))).together.verdict is Verdict.MET
    assert check_requirement(np.zeros((58, 4))).together.verdict is Verdict.UNDECIDED
    assert check_requirement(np.zeros((58, 4))).together.needed == 59
    # one outside has a chance of 0.1, two of 0.01
    requirement = Requirement(share=0.9, confidence=0.95)
    assert check_requirement(np.ones((1, 4)), requirement).together.verdict is Verdict.UNDECIDED
    assert check_requirement(np.ones((2, 4)), requirement).together.verdict is Verdict.NOT_MET


def test_a_true_share_at_the_limit_is_called_met_no_oftener_than_the_confidence_allows() -> None:
    rng = np.random.default_rng(4)
    requirement = Requirement(share=0.8, confidence=0.9)
    offsets = np.where(rng.uniform(size=(400, 60, 1)) < 0.8, 0.0, 1.0) * np.ones(4)
    verdicts = [check_requirement(run, requirement).together.verdict for run in offsets]
    for wrong in (Verdict.MET, Verdict.NOT_MET):
        assert verdicts.count(wrong) / len(verdicts) <= 0.1 + 0.03


def test_missed_pallets_where_asked_and_values_that_are_not_finite_are_outside_and_none_decide_nothing() -> None:
    checked = check_requirement(np.zeros((8, 4)), missed=2)
    assert checked.yaw.proportion.value == checked.together.proportion.value == 0.8
    assert check_requirement(np.full((1, 4), np.nan)).yaw.proportion.successes == 0
    assert check_requirement(np.zeros((0, 4))).together.verdict is Verdict.UNDECIDED


@pytest.mark.parametrize("wrong", [{"depth": 0.0}, {"yaw": -1.0}, {"share": 1.0}, {"confidence": 0.0}])
def test_an_impossible_requirement_and_errors_of_another_shape_are_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=rf"requirement\.{next(iter(wrong))}: expected"):
        Requirement(**wrong)
    with pytest.raises(ValueError, match=r"expected \(n, 4\), got \(4,\)"):
        check_requirement(np.zeros(4))


@pytest.mark.parametrize("outside", [0, 1, 3, 20])
def test_as_many_errors_as_are_said_decide_and_one_less_does_not(outside: int) -> None:
    requirement = Requirement()
    needed = needed_errors(outside, requirement)
    offsets = np.zeros((needed, 4))
    offsets[:outside] = 1.0
    assert check_requirement(offsets).together.verdict is Verdict.MET
    checked = check_requirement(offsets[:-1]).together
    assert checked.verdict is Verdict.UNDECIDED
    assert checked.needed == needed
    assert checked.decision == f"{needed} errors decide if no more than {outside} are outside; there are {needed - 1}"
