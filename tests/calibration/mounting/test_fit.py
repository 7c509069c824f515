from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from calibration.mounting.consensus import agree
from calibration.mounting.fit import MountingFit, extra_parameter, fit_mounting, refit, turn_to
from calibration.mounting.problem import MountingProblem, Poses
from calibration.targets.targets import CharucoBoard, SingleTag
from palletloc.geometry import FloatArray
from tests.calibration.simulated_yard import Yard, YardErrors

LAYOUTS = ((0.4, 2.0, -2.6, -1.2), (0.3, 1.6, -0.5), (1.4, -1.5, 0.2, 3.0, -2.4, 2.2))
SMALL, TAG = CharucoBoard(4, 3, 0.12, 0.09, "DICT_4X4_250"), SingleTag(0.3, "DICT_APRILTAG_36h11", 0)


def solved(problem: MountingProblem) -> MountingFit:
    start = agree(problem)
    assert start is not None
    return fit_mounting(start.problem, start.poses)


def error(solution: MountingFit, truth: Poses) -> FloatArray:
    moved = truth.camera.translation - solution.poses.camera.translation
    return np.concatenate([moved, turn_to(solution.poses.camera.rotation, truth.camera.rotation)])


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
    low, high = (chi2.ppf(level, 6 * len(squares)) / len(squares) for level in (0.005, 0.995))
    assert low < np.mean(squares) < high
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
