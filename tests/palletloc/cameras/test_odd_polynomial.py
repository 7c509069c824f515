import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from palletloc.cameras.odd_polynomial import OddPolynomial
from palletloc.geometry import FloatArray

# With a slope that almost vanishes on the way (at x = 1.05), so that plain Newton steps fly off.
FLAT_ON_THE_WAY = OddPolynomial((-0.6, 0.164))
POLYNOMIALS = {
    "identity": OddPolynomial(()),
    "no_distortion": OddPolynomial((0.0, 0.0, 0.0)),
    "flat_on_the_way": FLAT_ON_THE_WAY,
    "barrel": OddPolynomial((-0.2, 0.05, -0.01)),
    "steep": OddPolynomial((0.5, 2.0, 4.0)),
    "up_to_the_turn": OddPolynomial((-1 / 3,)),
}
every_polynomial = pytest.mark.parametrize("polynomial", POLYNOMIALS.values(), ids=POLYNOMIALS.keys())


def by_definition(polynomial: OddPolynomial, x: FloatArray) -> FloatArray:
    return np.asarray(x + sum(c * x ** (2 * i + 3) for i, c in enumerate(polynomial.coefficients)))


@every_polynomial
def test_factor_and_slope_follow_the_definition(polynomial: OddPolynomial) -> None:
    x = np.linspace(0.01, 2.0, 50)
    np.testing.assert_allclose(x * polynomial.factor(x * x), by_definition(polynomial, x), rtol=1e-12)
    step = 1e-6
    slope = (by_definition(polynomial, x + step) - by_definition(polynomial, x - step)) / (2 * step)
    np.testing.assert_allclose(polynomial.slope(x * x), slope, rtol=1e-6, atol=1e-7)


@every_polynomial
def test_inverse_undoes_the_polynomial(polynomial: OddPolynomial) -> None:
    upper = polynomial.increasing_until()
    x = np.linspace(0.0, min(upper, 3.0), 5001)
    values = by_definition(polynomial, x)
    found = polynomial.inverse(values, upper)
    np.testing.assert_allclose(by_definition(polynomial, found), values, rtol=1e-14, atol=1e-15)
    assert found.min() >= 0
    assert found.max() <= upper


def test_inverse_is_exact_where_the_slope_almost_vanishes() -> None:
    x = np.linspace(0.0, 2.0, 5001)
    found = FLAT_ON_THE_WAY.inverse(by_definition(FLAT_ON_THE_WAY, x), 2.0)
    np.testing.assert_allclose(found, x, atol=1e-12)


def test_there_is_no_inverse_beyond_the_reach_nor_of_nan() -> None:
    turn = POLYNOMIALS["up_to_the_turn"]
    found = turn.inverse(np.array([[0.1, 0.6], [2 / 3 + 1e-9, np.nan]]), turn.increasing_until())
    np.testing.assert_array_equal(np.isnan(found), [[False, False], [True, True]])


@given(st.lists(st.floats(-1.0, 1.0), max_size=4), st.floats(0.0, 0.5))
def test_it_rises_as_far_as_stated_and_no_farther(coefficients: list[float], margin: float) -> None:
    polynomial = OddPolynomial(tuple(coefficients))
    end = polynomial.increasing_until(margin)
    x = np.linspace(0.0, min(0.999 * end, 50.0), 1000)
    slope = polynomial.slope(x * x)
    assert (slope - margin * x).min() > -1e-9 * np.abs(slope).max()
    if math.isfinite(end):
        after = np.array([end * (1 + 1e-6)])
        lowest = min(float(polynomial.slope(after**2)[0]), float(polynomial.factor(after**2)[0]))
        assert lowest - margin * after[0] < 1e-4
