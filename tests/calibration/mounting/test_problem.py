from collections.abc import Callable

import numpy as np
import pytest

from calibration.mounting.problem import CAMERA, Poses
from palletloc.geometry import FloatArray
from tests.calibration.simulated_yard import Yard, YardErrors

AXIS = np.array([1.0, 0.0, 0.0])
EXACT = YardErrors(drawn=False)


def numeric(function: Callable[[FloatArray], FloatArray], size: int, step: float = 1e-6) -> FloatArray:
    moves = step * np.eye(size)
    return np.stack([(function(move) - function(-move)) / (2 * step) for move in moves], axis=1)


def wrong(yard: Yard) -> Poses:
    """Return poses beside the truth."""
    size = CAMERA * (1 + len(yard.truth.boards))
    return yard.truth.moved(np.random.default_rng(5).normal(0, 0.01, size))


def test_the_truth_has_no_residuals(yard: Callable[..., Yard]) -> None:
    exact = yard(errors=EXACT)
    assert np.abs(exact.problem.residuals(exact.truth)).max() < 1e-8


def test_the_jacobian_is_the_derivative(yard: Callable[..., Yard]) -> None:
    drawn = yard()
    problem, poses = drawn.problem, wrong(drawn)
    jacobian = problem.jacobian(poses)
    expected = numeric(lambda step: problem.residuals(poses.moved(step)), jacobian.shape[1])
    np.testing.assert_allclose(jacobian, expected, atol=1e-6 * np.abs(expected).max())


def test_a_survey_that_does_not_count_has_no_rows(yard: Callable[..., Yard]) -> None:
    drawn = yard()
    less = drawn.problem.without_survey(2)
    assert len(less.residuals(drawn.truth)) == len(drawn.problem.residuals(drawn.truth)) - 9
    assert less.jacobian(drawn.truth).shape[0] == len(less.residuals(drawn.truth))


@pytest.mark.parametrize("distance", [0.01, -0.04])
def test_the_distance_of_two_lenses_acts_as_its_derivative_says(yard: Callable[..., Yard], distance: float) -> None:
    drawn = yard()
    step = 1e-5

    def residuals(value: float) -> FloatArray:
        return drawn.problem.with_lens_distance(value, AXIS).residuals(drawn.truth)

    shifted = drawn.problem.with_lens_distance(distance, AXIS)
    expected = (residuals(distance + step) - residuals(distance - step)) / (2 * step)
    actual = shifted.by_lens_distance(drawn.truth, AXIS)
    np.testing.assert_allclose(actual, expected, atol=1e-4 * np.abs(expected).max())


def test_bearings_from_two_lenses_fit_with_their_distance(yard: Callable[..., Yard]) -> None:
    two = yard(errors=YardErrors(drawn=False, lens_distance=0.04))
    assert np.abs(two.problem.residuals(two.truth)).max() > 10
    assert np.abs(two.problem.with_lens_distance(0.04, AXIS).residuals(two.truth)).max() < 1e-8
