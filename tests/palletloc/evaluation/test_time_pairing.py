import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from palletloc.evaluation.pose_error import EvaluationError
from palletloc.evaluation.time_pairing import brackets, nearest_pairs, require_overlap

series = st.lists(st.floats(0, 10), min_size=1, max_size=12).map(np.array)
ordered = st.lists(st.floats(0, 10), min_size=1, max_size=12, unique=True).map(sorted).map(np.array)
limits = st.floats(0, 3)


@given(series, series, limits)
def test_nearest_is_what_a_search_of_all_samples_finds(first: np.ndarray, second: np.ndarray, limit: float) -> None:
    pairs = nearest_pairs(first, second, limit)
    all_apart = np.abs(second[None] - first[:, None])
    assert pairs.first.tolist() == np.flatnonzero(all_apart.min(axis=1) <= limit).tolist()
    assert np.abs(pairs.differences).tolist() == all_apart.min(axis=1)[pairs.first].tolist()
    np.testing.assert_array_equal(second[pairs.second] - first[pairs.first], pairs.differences)


def test_the_limit_is_inclusive() -> None:
    pairs = nearest_pairs(np.array([0.0, 1.0]), np.array([0.25, 1.5]), 0.25)
    assert (pairs.first.tolist(), pairs.second.tolist()) == ([0], [0])


@given(ordered, series, limits)
def test_a_wanted_time_is_the_weighted_mean_of_its_neighbours(
    samples: np.ndarray, wanted: np.ndarray, limit: float
) -> None:
    found = brackets(wanted, samples, limit)
    before, after = samples[found.before], samples[found.after]
    np.testing.assert_allclose((1 - found.share) * before + found.share * after, wanted[found.wanted], atol=1e-12)
    assert ((found.share >= 0) & (found.share <= 1)).all()
    assert (after - before <= limit).all()
    assert ((found.after - found.before) <= 1).all()


@given(ordered, series)
def test_without_a_limit_everything_between_the_ends_is_found_and_nothing_else(
    samples: np.ndarray, wanted: np.ndarray
) -> None:
    inside = (wanted >= samples[0]) & (wanted <= samples[-1])
    assert brackets(wanted, samples, np.inf).wanted.tolist() == np.flatnonzero(inside).tolist()


def test_a_long_gap_is_not_bridged_but_its_ends_are_known() -> None:
    found = brackets(np.array([0.5, 1.0, 3.0, 5.0, 5.5]), np.array([0.0, 1.0, 5.0, 6.0]), 1.0)
    assert found.wanted.tolist() == [0, 1, 3, 4]


def test_series_of_other_times_are_refused_with_both_spans() -> None:
    with pytest.raises(EvaluationError, match="shots from 0 s to 2 s, truth from 100 s to 101 s: exp"):
        require_overlap(np.array([0.0, 2.0]), np.array([100.0, 101.0]), ("shots", "truth"))
    with pytest.raises(EvaluationError, match="truth: no times; expected"):
        require_overlap(np.array([0.0]), np.array([]), ("shots", "truth"))


def test_series_may_be_as_far_apart_as_the_slack() -> None:
    require_overlap(np.array([0.0, 1.0]), np.array([1.005]), ("a", "b"), slack=0.01)
    with pytest.raises(EvaluationError, match="one clock"):
        require_overlap(np.array([0.0, 1.0]), np.array([1.02]), ("a", "b"), slack=0.01)


def test_a_negative_limit_is_refused() -> None:
    with pytest.raises(ValueError, match="expected 0 s or more"):
        nearest_pairs(np.zeros(1), np.zeros(1), -1.0)


def test_nothing_has_no_partner() -> None:
    assert not len(nearest_pairs(np.zeros(0), np.ones(2), 9).first)
    assert not len(nearest_pairs(np.ones(2), np.zeros(0), 9).first)
