from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from calibration.consensus import agree
from calibration.extrinsics import Extrinsics, extra_parameter, resolve, solve, turn_to
from calibration.network import Network, Poses
from calibration.simulated_yard import Yard, YardErrors
from calibration.targets import CharucoBoard, SingleTag
from palletloc.geometry import FloatArray

LAYOUTS = ((0.4, 2.0, -2.6, -1.2), (0.3, 1.6, -0.5), (1.4, -1.5, 0.2, 3.0, -2.4, 2.2))
SMALL, TAG = CharucoBoard(4, 3, 0.12, 0.09, "DICT_4X4_250"), SingleTag(0.3, "DICT_APRILTAG_36h11", 0)


def solved(network: Network) -> Extrinsics:
    start = agree(network)
    assert start is not None
    return solve(start.network, start.poses)


def error(solution: Extrinsics, truth: Poses) -> FloatArray:
    moved = truth.camera.translation - solution.poses.camera.translation
    return np.concatenate([moved, turn_to(solution.poses.camera.rotation, truth.camera.rotation)])


def test_exact_observations_give_the_truth(yard: Callable[..., Yard]) -> None:
    exact = yard(errors=YardErrors(drawn=False))
    assert np.abs(error(solved(exact.network), exact.truth)).max() < 1e-8


@pytest.mark.parametrize("count", [10, pytest.param(150, marks=pytest.mark.slow)])
def test_covariances_are_consistent_over_many_yards(yard: Callable[..., Yard], count: int) -> None:
    squares = []
    for seed in range(count):
        errors = YardErrors(survey=(0.0005, 0.001, 0.002)[seed % 3], bearing=(5e-5, 2e-4)[seed // 3 % 2])
        drawn = yard(LAYOUTS[seed % len(LAYOUTS)], seed, errors, TAG if seed % 5 == 0 else SMALL)
        solution = solved(drawn.network)
        off = error(solution, drawn.truth)
        squares.append(float(off @ np.linalg.solve(solution.covariance, off)))
    low, high = (chi2.ppf(level, 6 * len(squares)) / len(squares) for level in (0.005, 0.995))
    assert low < np.mean(squares) < high
    assert max(squares) < chi2.isf(1e-5, 6)


def test_a_corner_that_is_elsewhere_is_left_out(yard: Callable[..., Yard]) -> None:
    drawn = yard()
    sight = drawn.network.sights[1]
    bearings = sight.bearings.copy()
    bearings[4] += [0.0, 0.0, 0.004]
    bearings[4] /= np.linalg.norm(bearings[4])
    sights = (drawn.network.sights[0], replace(sight, bearings=bearings), *drawn.network.sights[2:])
    solution = solved(replace(drawn.network, sights=sights))
    assert not solution.kept[1][4]
    assert np.mean([kept.mean() for kept in solution.kept]) > 0.97
    assert (np.abs(error(solution, drawn.truth)) < 4 * solution.sigma).all()


@pytest.mark.parametrize("factor", [1.0, 3.0])
def test_errors_larger_than_stated_widen_the_covariance(yard: Callable[..., Yard], factor: float) -> None:
    drawn = yard(errors=YardErrors(survey=0.001 * factor, bearing=1e-4 * factor))
    network = replace(
        drawn.network,
        surveys=tuple(replace(one, sigma=0.001) for one in drawn.network.surveys),
        sights=tuple(replace(one, sigma=one.sigma / factor) for one in drawn.network.sights),
    )
    solution = solved(network)
    assert solution.sight_factor == pytest.approx(factor, rel=0.15)
    assert solution.survey_factor == pytest.approx(factor, rel=0.35)


def test_one_more_unknown_is_found_with_its_sigma(yard: Callable[..., Yard]) -> None:
    drawn = yard()
    network = replace(
        drawn.network, surveys=tuple(replace(s, points=1.001 * s.points) for s in drawn.network.surveys)
    )
    solution = solved(network)
    stated = resolve(solution, replace(solution.network, survey_scale=1.0))
    value, sigma = extra_parameter(stated, stated.network.by_survey_scale())
    assert value == pytest.approx(-0.001, abs=4 * sigma)
    assert sigma < 2e-4


def test_an_unknown_that_nothing_tells_has_no_sigma(yard: Callable[..., Yard]) -> None:
    solution = solved(yard().network)
    value, sigma = extra_parameter(solution, np.zeros(len(solution.network.residuals(solution.poses))))
    assert (value, sigma) == (0.0, np.inf)
