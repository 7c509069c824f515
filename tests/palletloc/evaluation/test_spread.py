import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from palletloc.evaluation.spread import spread

values = st.lists(st.floats(-1e3, 1e3), min_size=1, max_size=30)


@given(values)
def test_the_mean_square_is_that_of_the_mean_and_the_deviations(errors: list[float]) -> None:
    found = spread(errors)
    assert found is not None
    assert found.rms**2 == pytest.approx(found.mean**2 + np.var(errors), abs=1e-6)


@given(values)
def test_turning_all_signs_turns_the_bias_and_no_size(errors: list[float]) -> None:
    one, other = spread(errors), spread(-np.array(errors))
    assert one is not None
    assert other is not None
    assert (other.bias, other.mean) == pytest.approx((-one.bias, -one.mean))
    sizes = ("n", "median", "rms", "p95", "maximum")
    assert [getattr(other, name) for name in sizes] == pytest.approx([getattr(one, name) for name in sizes])


def test_the_95th_percentile_has_5_percent_above() -> None:
    found = spread(np.arange(1, 102.0))
    assert found is not None
    assert (found.n, found.p95, found.maximum) == (101, 96.0, 101.0)


def test_nothing_has_no_spread() -> None:
    assert spread([]) is None
