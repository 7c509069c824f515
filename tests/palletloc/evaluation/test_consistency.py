import numpy as np
import pytest
from scipy.stats import chi2, kstest

from palletloc.evaluation.consistency import Consistency, chi_square_check
from palletloc.evaluation.normalised import nees, normalised
from palletloc.geometry import FloatArray

RNG_SEED = 8


def drawn(count: int, factor: float = 1.0) -> tuple[FloatArray, FloatArray]:
    """Return errors drawn from a covariance, and ``factor`` times that covariance."""
    rng = np.random.default_rng(RNG_SEED)
    root = rng.normal(size=(4, 4))
    return rng.normal(size=(count, 4)) @ root.T, factor * root @ root.T


def test_nees_of_draws_from_a_covariance_is_chi_square() -> None:
    errors, covariance = drawn(3000)
    assert kstest([nees(one, covariance) for one in errors], chi2(4).cdf).pvalue > 0.01


def test_normalised_errors_have_unit_variance_where_truth_and_estimate_err_independently() -> None:
    rng = np.random.default_rng(1)
    error = rng.normal(scale=0.03, size=20000) - rng.normal(scale=0.04, size=20000)
    found = normalised(error, np.full(20000, 0.03**2 + 0.04**2))
    assert float(found.std()) == pytest.approx(1, abs=0.02)


def test_without_a_variance_an_error_is_infinite_with_its_sign() -> None:
    assert normalised(np.array([-0.1, 0.2, 0.2]), np.array([0.0, -1.0, 4e-2])).tolist() == [-np.inf, np.inf, 1.0]


@pytest.mark.parametrize(
    ("factor", "verdict"),
    [
        (1.0, Consistency.CONSISTENT),
        (0.25, Consistency.OVERCONFIDENT),
        (4.0, Consistency.UNDERCONFIDENT),
    ],
)
def test_covariances_of_a_wrong_size_are_told(factor: float, verdict: Consistency) -> None:
    errors, covariance = drawn(200, factor)
    check = chi_square_check([nees(one, covariance) for one in errors], 4)
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


def test_nothing_has_no_verdict() -> None:
    check = chi_square_check([np.nan], 4)
    assert (check.n, check.unknown, check.verdict) == (0, 1, Consistency.UNKNOWN)


@pytest.mark.parametrize(("freedom", "confidence"), [(0, 0.95), (4, 0.0), (4, 1.0)])
def test_impossible_requests_are_refused(freedom: int, confidence: float) -> None:
    with pytest.raises(ValueError, match="expected"):
        chi_square_check([4.0], freedom, confidence)
