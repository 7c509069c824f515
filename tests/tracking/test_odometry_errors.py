import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from palletloc.geometry import LevelPose
from tracking import Odometry, OdometryNoise, PalletTracker, TrackerConfig
from tracking.odometry_errors import odometry_errors
from tracking.state import Gaussian

PALLETS = (
    LevelPose(5.0, 2.0, 0.0, math.pi / 2),
    LevelPose(6.5, 2.0, 0.0, 1.5),
    LevelPose(7.0, 2.1, 1.5, 1.6),
    LevelPose(6.0, -2.0, 0.0, -1.5),
)


def straight(_: float) -> tuple[float, float]:
    return 0.7, 0.02


def driven(drawn: Any, config: TrackerConfig | None = None) -> PalletTracker:
    tracker = PalletTracker(config)
    inputs = [(sample.time, sample) for sample in drawn.odometry]
    inputs += [(seen.time + 0.03, seen) for seen in drawn.measurements]
    for _, given in sorted(inputs, key=lambda pair: pair[0]):
        tracker.push(given)
    return tracker


def test_several_pallets_over_a_few_metres_tell_the_truth(draw_drive: Callable[..., Any]) -> None:
    prior = TrackerConfig().odometry
    for seed in range(4):
        drawn = draw_drive(40 + seed, straight, PALLETS, 7.0, 0.35)
        found = driven(drawn).odometry_errors()
        assert abs(found.wheel_scale_percent - 100 * drawn.scale) < 3 * found.wheel_scale_sigma_percent
        assert abs(found.gyro_bias_deg_s - math.degrees(drawn.bias)) < 3 * found.gyro_bias_sigma_deg_s
        assert found.wheel_scale_sigma_percent < 0.5 * prior.wheel_scale_percent
        assert found.gyro_bias_sigma_deg_s < 0.3 * prior.gyro_bias_deg_s
        assert found.tracks == len(PALLETS)


def test_errors_after_the_fusion_are_smaller_than_the_prior(draw_drive: Callable[..., Any]) -> None:
    left, right = [], []
    for seed in range(6):
        drawn = draw_drive(60 + seed, straight, PALLETS[:2], 7.0, 0.35)
        found = driven(drawn).odometry_errors()
        left.append([found.wheel_scale_percent - 100 * drawn.scale, found.gyro_bias_deg_s - math.degrees(drawn.bias)])
        right.append([100 * drawn.scale, math.degrees(drawn.bias)])
    assert np.all(np.std(left, axis=0) < 0.6 * np.sqrt(np.mean(np.square(right), axis=0)))


def state(mean: tuple[float, float], part: float, config: TrackerConfig) -> Gaussian:
    covariance, values = np.eye(10), np.zeros(10)
    values[4:6] = mean
    covariance[4:6, 4:6] = part * np.diag(config.odometry.constants**2)
    return Gaussian(values, covariance)


def test_without_tracks_the_prior_is_returned() -> None:
    found = PalletTracker().odometry_errors()
    assert (found.wheel_scale_percent, found.gyro_bias_deg_s, found.tracks) == (0.0, 0.0, 0)
    assert found.wheel_scale_sigma_percent == pytest.approx(1.0)
    assert found.gyro_bias_sigma_deg_s == pytest.approx(0.2)


@pytest.mark.parametrize("count", [1, 2, 20])
def test_tracks_that_know_the_same_are_no_surer_than_one(count: int) -> None:
    config = TrackerConfig()
    one = state((0.004, 0.001), 0.25, config)
    found = odometry_errors([one] * count, config)
    assert found.wheel_scale_percent == pytest.approx(0.4)
    assert found.gyro_bias_deg_s == pytest.approx(math.degrees(0.001))
    np.testing.assert_allclose(found.covariance, 0.25 * np.diag([1.0, 0.04]), rtol=1e-9)


def test_tracks_that_know_nothing_leave_the_prior() -> None:
    config = TrackerConfig()
    found = odometry_errors([state((0.0, 0.0), 1.0, config)] * 3, config)
    np.testing.assert_allclose(found.covariance, np.diag([1.0, 0.04]), rtol=1e-9)


def test_a_track_that_knows_little_takes_nothing_from_one_that_knows_much() -> None:
    config = TrackerConfig()
    much, little = state((0.004, 0.001), 0.05, config), state((0.0, 0.0), 0.9, config)
    alone, both = odometry_errors([much], config), odometry_errors([much, little], config)
    np.testing.assert_allclose(both.covariance, alone.covariance, rtol=0.02)


def test_errors_that_are_known_to_be_none_stay_so() -> None:
    config = TrackerConfig(odometry=OdometryNoise(wheel_scale_percent=0.0))
    tracker = PalletTracker(config)
    tracker.push(Odometry(0.0, LevelPose(0.0, 0.0, 0.0, 0.0)))
    found = tracker.odometry_errors()
    assert found.wheel_scale_percent == 0.0
    assert found.wheel_scale_sigma_percent == 0.0
    assert found.gyro_bias_sigma_deg_s == pytest.approx(0.2)


def test_errors_that_are_not_estimated_stay_as_they_were_known(draw_drive: Callable[..., Any]) -> None:
    drawn = draw_drive(3, straight, PALLETS[:1], 4.0, 0.35)
    found = driven(drawn, TrackerConfig(estimate_odometry=False)).odometry_errors()
    assert found.wheel_scale_percent == 0.0
    assert found.wheel_scale_sigma_percent == pytest.approx(1.0)
