from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from calibration.mounting.consensus import Reading, agree, read_as
from calibration.mounting.problem import MountingProblem
from tests.calibration.simulated_yard import Yard


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
    found = agree(read_wrongly(drawn.problem, reading, slice(2, 3)))
    assert found is not None
    assert found.readings == (Reading.AS_NAMED, Reading.AS_NAMED, reading, *(Reading.AS_NAMED,) * 3)
    assert all(found.agrees)
    assert np.linalg.norm(found.poses.camera.translation - drawn.truth.camera.translation) < 0.02


def test_boards_that_all_hang_upside_down_are_read_so(yard: Callable[..., Yard]) -> None:
    found = agree(read_wrongly(yard().problem, Reading.UPSIDE_DOWN, slice(None)))
    assert found is not None
    assert set(found.readings) == {Reading.UPSIDE_DOWN}
    assert all(found.agrees)


def test_targets_that_moved_do_not_move_the_start(yard: Callable[..., Yard]) -> None:
    drawn = yard()
    surveys = list(drawn.problem.surveys)
    for k in (0, 3):
        surveys[k] = replace(surveys[k], points=surveys[k].points + np.array([0.4, -0.3, 0.2 * k]))
    found = agree(replace(drawn.problem, surveys=tuple(surveys)))
    assert found is not None
    assert [k for k, good in enumerate(found.agrees) if not good] == [0, 3]
    assert np.linalg.norm(found.poses.camera.translation - drawn.truth.camera.translation) < 0.03
