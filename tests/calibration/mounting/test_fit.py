from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from calibration.mounting.consensus import Reading, agree, read_as
from calibration.mounting.fit import MountingFit, extra_parameter, fit_mounting, refit
from calibration.mounting.problem import CAMERA, MountingProblem, Poses
from calibration.targets.targets import CharucoBoard, SingleTag
from palletloc.geometry import FloatArray
from tests.calibration.expecting import present
from tests.calibration.simulated_yard import Yard, YardErrors, assert_consistent, pose_error

LAYOUTS = ((0.4, 2.0, -2.6, -1.2), (0.3, 1.6, -0.5), (1.4, -1.5, 0.2, 3.0, -2.4, 2.2))
SMALL, TAG = CharucoBoard(4, 3, 0.12, 0.09, "DICT_4X4_250"), SingleTag(0.3, "DICT_APRILTAG_36h11", 0)


def solved(problem: MountingProblem) -> MountingFit:
    start = present(agree(problem))
    return fit_mounting(start.problem, start.poses)


def error(solution: MountingFit, truth: Poses) -> FloatArray:
    return pose_error(solution.poses.camera, truth.camera)


def test_exact_observations_give_the_truth(yard: Callable[..., Yard]) -> None:
    exact = yard(errors=YardErrors(drawn=False))
    assert np.abs(error(solved(exact.problem), exact.truth)).max() < 1e-8


@pytest.mark.slow
def test_covariances_are_consistent_over_many_yards(yard: Callable[..., Yard]) -> None:
    squares = []
    for seed in range(150):
        errors = YardErrors(survey=(0.0005, 0.001, 0.002)[seed % 3], bearing=(5e-5, 2e-4)[seed // 3 % 2])
        drawn = yard(LAYOUTS[seed % len(LAYOUTS)], seed, errors, TAG if seed % 5 == 0 else SMALL)
        solution = solved(drawn.problem)
        off = error(solution, drawn.truth)
        squares.append(float(off @ np.linalg.solve(solution.covariance, off)))
    assert_consistent(squares)
    assert max(squares) < chi2.isf(1e-5, 6)


def test_a_corner_that_is_elsewhere_is_left_out(yard: Callable[..., Yard]) -> None:
    drawn = yard()
    first, second, *others = drawn.problem.observations
    bearings = second.bearings.copy()
    bearings[4] += [0.0, 0.0, 0.004]
    bearings[4] /= np.linalg.norm(bearings[4])
    observations = (first, replace(second, bearings=bearings), *others)
    solution = solved(replace(drawn.problem, observations=observations))
    assert not solution.kept[1][4]
    assert np.mean([kept.mean() for kept in solution.kept]) > 0.97
    assert (np.abs(error(solution, drawn.truth)) < 4 * solution.sigma).all()


@pytest.mark.parametrize("factor", [1.0, 3.0])
def test_errors_larger_than_stated_widen_the_covariance(yard: Callable[..., Yard], factor: float) -> None:
    drawn = yard(errors=YardErrors(survey=0.001 * factor, bearing=1e-4 * factor))
    problem = replace(
        drawn.problem,
        surveys=tuple(replace(survey, sigma=0.001) for survey in drawn.problem.surveys),
        observations=tuple(replace(seen, sigma=seen.sigma / factor) for seen in drawn.problem.observations),
    )
    solution = solved(problem)
    assert solution.bearing_factor == pytest.approx(factor, rel=0.15)
    assert solution.survey_factor == pytest.approx(factor, rel=0.35)


def test_one_more_unknown_is_found_with_its_sigma(yard: Callable[..., Yard]) -> None:
    drawn = yard()
    problem = replace(
        drawn.problem, surveys=tuple(replace(s, points=1.001 * s.points) for s in drawn.problem.surveys)
    )
    solution = solved(problem)
    stated = refit(solution, replace(solution.problem, survey_scale=1.0))
    value, sigma = extra_parameter(stated, stated.problem.by_survey_scale())
    assert value == pytest.approx(-0.001, abs=4 * sigma)
    assert sigma < 2e-4


def test_an_unknown_that_nothing_tells_has_no_sigma(yard: Callable[..., Yard]) -> None:
    solution = solved(yard().problem)
    value, sigma = extra_parameter(solution, np.zeros(len(solution.problem.residuals(solution.poses))))
    assert (value, sigma) == (0.0, np.inf)


AXIS = np.array([1.0, 0.0, 0.0])


def test_the_truth_has_no_residuals(yard: Callable[..., Yard]) -> None:
    exact = yard(errors=YardErrors(drawn=False))
    assert np.abs(exact.problem.residuals(exact.truth)).max() < 1e-8


def test_the_jacobian_is_the_derivative(yard: Callable[..., Yard]) -> None:
    drawn = yard()
    size = CAMERA * (1 + len(drawn.truth.boards))
    problem, poses = drawn.problem, drawn.truth.moved(np.random.default_rng(5).normal(0, 0.01, size))
    jacobian = problem.jacobian(poses)
    ahead, back = ([problem.residuals(poses.moved(step)) for step in sign * 1e-6 * np.eye(size)] for sign in (1, -1))
    expected = np.subtract(ahead, back).T / 2e-6
    np.testing.assert_allclose(jacobian, expected, atol=1e-6 * np.abs(expected).max())


def test_a_survey_that_does_not_count_has_no_rows(yard: Callable[..., Yard]) -> None:
    drawn = yard()
    less = drawn.problem.without_survey(2)
    assert len(less.residuals(drawn.truth)) == len(drawn.problem.residuals(drawn.truth)) - 9
    assert less.jacobian(drawn.truth).shape[0] == len(less.residuals(drawn.truth))


@pytest.mark.parametrize("distance", [0.01, -0.04])
def test_the_distance_of_two_lenses_acts_as_its_derivative_says(yard: Callable[..., Yard], distance: float) -> None:
    drawn = yard()
    ahead, back, here = (drawn.problem.with_lens_distance(distance + step, AXIS) for step in (1e-5, -1e-5, 0.0))
    expected = (ahead.residuals(drawn.truth) - back.residuals(drawn.truth)) / 2e-5
    actual = here.by_lens_distance(drawn.truth, AXIS)
    np.testing.assert_allclose(actual, expected, atol=1e-4 * np.abs(expected).max())


def test_bearings_from_two_lenses_fit_with_their_distance(yard: Callable[..., Yard]) -> None:
    two = yard(errors=YardErrors(drawn=False, lens_distance=0.04))
    assert np.abs(two.problem.residuals(two.truth)).max() > 10
    assert np.abs(two.problem.with_lens_distance(0.04, AXIS).residuals(two.truth)).max() < 1e-8


def read_wrongly(problem: MountingProblem, reading: Reading, which: slice) -> MountingProblem:
    surveys = list(problem.surveys)
    surveys[which] = [read_as(survey, reading) for survey in surveys[which]]
    return replace(problem, surveys=tuple(surveys))


@pytest.mark.parametrize("reading", Reading)
def test_a_reading_undoes_itself(yard: Callable[..., Yard], reading: Reading) -> None:
    survey = yard().problem.surveys[0]
    twice = read_as(read_as(survey, reading), reading)
    np.testing.assert_allclose(twice.points, survey.points, atol=1e-12)


@pytest.mark.parametrize("reading", Reading)
def test_the_reading_of_one_target_is_found(yard: Callable[..., Yard], reading: Reading) -> None:
    drawn = yard()
    found = present(agree(read_wrongly(drawn.problem, reading, slice(2, 3))))
    assert found.readings == (Reading.AS_NAMED, Reading.AS_NAMED, reading, *(Reading.AS_NAMED,) * 3)
    assert all(found.agrees)
    assert np.linalg.norm(found.poses.camera.translation - drawn.truth.camera.translation) < 0.02


def test_boards_that_all_hang_upside_down_are_read_so(yard: Callable[..., Yard]) -> None:
    found = present(agree(read_wrongly(yard().problem, Reading.UPSIDE_DOWN, slice(None))))
    assert set(found.readings) == {Reading.UPSIDE_DOWN}
    assert all(found.agrees)


def test_targets_that_moved_do_not_move_the_start(yard: Callable[..., Yard]) -> None:
    drawn = yard()
    surveys = list(drawn.problem.surveys)
    for k in (0, 3):
        surveys[k] = replace(surveys[k], points=surveys[k].points + np.array([0.4, -0.3, 0.2 * k]))
    found = present(agree(replace(drawn.problem, surveys=tuple(surveys))))
    assert [k for k, good in enumerate(found.agrees) if not good] == [0, 3]
    assert np.linalg.norm(found.poses.camera.translation - drawn.truth.camera.translation) < 0.03
