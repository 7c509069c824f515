import math
from typing import Any

import numpy as np
import pytest

from palletloc.geometry import FloatArray, LevelPose
from palletloc.measurement import PalletMeasurement
from tracking.config import MeasurementErrors
from tracking.observation import ALL, Observation, PartialMeasurement, observe
from tracking.validation import BadInputError

ERRORS = MeasurementErrors(inflation=1.0)
POSE = LevelPose(3.0, 2.0, 0.1, 1.2)


def ready(given: PalletMeasurement | PartialMeasurement, errors: MeasurementErrors = ERRORS) -> Observation:
    (found,) = observe([given], errors)
    assert isinstance(found, Observation)
    return found


def random_covariance(seed: int, scale: float) -> FloatArray:
    root = scale * np.random.default_rng(seed).normal(size=(4, 4))
    return np.asarray(root @ root.T + 0.01 * scale**2 * np.eye(4))


@pytest.mark.parametrize("scale", [1e-4, 1e-3, 1e-2, 1.0])
@pytest.mark.parametrize("seed", range(4))
def test_the_two_parts_make_up_the_covariance_and_neither_is_more_than_all(
    make_measurement: Any, scale: float, seed: int
) -> None:
    covariance = random_covariance(seed, scale)
    one = ready(make_measurement(0.0, POSE, covariance))
    shared = one.common @ one.common.T
    np.testing.assert_allclose(shared + one.own, covariance, rtol=1e-9, atol=1e-12 * scale**2)
    shares = np.linalg.eigvals(np.linalg.solve(covariance, shared)).real
    assert shares.min() > -1e-9
    assert shares.max() < ERRORS.max_common_share + 1e-9
    assert np.linalg.eigvalsh(one.own)[0] > 0


def test_where_there_is_room_the_shared_part_is_as_the_parameters_say_in_the_pallets_axes(
    make_measurement: Any,
) -> None:
    one = ready(make_measurement(0.0, POSE, np.diag([1.0, 1.0, 1.0, 1.0])))
    cos, sin = math.cos(POSE.yaw), math.sin(POSE.yaw)
    across = np.array([0.0, 1.0, 0.0, 0.0])
    np.testing.assert_allclose(one.common @ across, 0.0025 * np.array([-sin, cos, 0.0, 0.0]), atol=1e-15)
    assert one.common[3, 3] == pytest.approx(math.radians(0.1))


def test_without_shared_errors_all_is_new(make_measurement: Any) -> None:
    one = ready(make_measurement(0.0, POSE), MeasurementErrors(0.0, 0.0, inflation=1.0))
    assert not one.common.any()


def test_many_are_read_as_each_would_be_alone(make_measurement: Any) -> None:
    given = [make_measurement(0.1 * k, POSE, random_covariance(k, 0.01 if k % 2 else 1e-3)) for k in range(9)]
    for one, alone in zip(observe(given, ERRORS), given, strict=True):
        assert isinstance(one, Observation)
        expected = ready(alone)
        assert one.order == expected.order
        np.testing.assert_array_equal(one.common, expected.common)
        np.testing.assert_array_equal(one.own, expected.own)


def test_what_is_wrong_stands_in_its_place_among_the_others(make_measurement: Any) -> None:
    bad = make_measurement(1.0, LevelPose(math.nan, 0.0, 0.0, 0.0))
    worse = make_measurement(math.nan, POSE)
    found = observe([make_measurement(0.0, POSE), bad, worse, make_measurement(2.0, POSE)], ERRORS)
    assert [isinstance(each, BadInputError) for each in found] == [False, True, True, False]
    assert observe([], ERRORS) == []


def test_the_time_is_that_of_the_exposure(make_measurement: Any) -> None:
    assert ready(make_measurement(5.0, POSE), MeasurementErrors(latency_s=0.03)).time == pytest.approx(4.97)


def test_yaw_and_zero_have_one_form_each(make_measurement: Any) -> None:
    turned = ready(make_measurement(0.0, LevelPose(-0.0, 2.0, 0.1, 1.2 + 2 * math.pi)))
    assert turned.pose.yaw == pytest.approx(1.2)
    assert math.copysign(1.0, turned.pose.x) == 1.0
    assert turned.components == ALL
    assert turned.is_whole


def test_a_part_is_told_by_what_it_says_and_what_it_is_near() -> None:
    def part(near: LevelPose | None, *names: str) -> Observation:
        size = len(names)
        return ready(PartialMeasurement(0.0, "any", names, np.ones(size), np.eye(size), near))

    assert part(POSE, "yaw").order != part(None, "yaw").order
    assert part(POSE, "yaw").order == part(POSE, "yaw").order
    assert part(None, "yaw").place is None
    assert part(None, "x", "y", "z").place == (1.0, 1.0, 1.0)
    assert part(POSE, "x", "y", "z").place == (3.0, 2.0, 0.1)
    assert not part(None, "x", "y", "z", "yaw").is_whole or part(None, "x", "y", "z", "yaw").place is not None
