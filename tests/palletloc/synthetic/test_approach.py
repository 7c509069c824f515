from __future__ import annotations

import numpy as np
import pytest

from palletloc.geometry import LevelPose, level_pose
from palletloc.synthetic.approach import Approach, OdometryNoise, measure_odometry

WAY = Approach(LevelPose(-1.0, 0.2, 0.0, 0.4), length=3.0, speed=0.6, winding=0.05, wavelength=2.0, phase=0.7)
NONE = OdometryNoise(0.0, 0.0, 0.0, 0.0)


def test_the_heading_follows_the_way() -> None:
    times = np.linspace(0.0, WAY.duration, 2001)
    x, y, yaw = WAY.poses(times).T
    heading = np.arctan2(np.diff(y), np.diff(x))
    assert heading == pytest.approx((yaw[1:] + yaw[:-1]) / 2, abs=1e-5)


def test_perfect_odometry_is_the_true_motion() -> None:
    odometry = measure_odometry(WAY, NONE, np.random.default_rng(0))
    x, y, yaw = WAY.poses(np.zeros(1))[0].tolist()
    world_from_start = LevelPose(x, y, 0.0, yaw)
    for time in np.linspace(0.0, WAY.duration, 17).tolist():
        x, y, yaw = WAY.poses(np.array([time]))[0].tolist()
        truth = level_pose(world_from_start.transform().inv() * LevelPose(x, y, 0.0, yaw).transform())
        assert odometry.pose_at(time).as_array() == pytest.approx(truth.as_array(), abs=5e-5)


def test_rates_are_those_of_the_motion() -> None:
    odometry = measure_odometry(WAY, NONE, np.random.default_rng(0))
    assert odometry.speed is not None
    assert odometry.yaw_rate is not None
    assert np.trapezoid(odometry.speed, odometry.times) == pytest.approx(
        np.hypot(np.diff(odometry.x), np.diff(odometry.y)).sum(), rel=1e-3
    )
    assert np.trapezoid(odometry.yaw_rate, odometry.times) == pytest.approx(odometry.yaw[-1], abs=5e-3)


def test_odometry_begins_at_zero_covers_the_approach_and_has_its_rate() -> None:
    odometry = measure_odometry(WAY, OdometryNoise(), np.random.default_rng(1), rate=50.0)
    assert odometry.pose_at(0.0).as_array() == pytest.approx(np.zeros(4))
    assert np.diff(odometry.times) == pytest.approx(0.02)
    assert odometry.times[-1] >= WAY.duration


def test_errors_have_the_stated_spread() -> None:
    straight = Approach(length=4.0, speed=0.5, winding=0.0)
    scale, bias = OdometryNoise(0.006, 0.0, 0.0, 0.0), OdometryNoise(0.0, 0.004, 0.0, 0.0)
    ends = [measure_odometry(straight, scale, np.random.default_rng(i)).x[-1] for i in range(300)]
    assert np.std(ends) == pytest.approx(4.0 * 0.006, rel=0.12)
    turns = [measure_odometry(straight, bias, np.random.default_rng(i)).yaw[-1] for i in range(300)]
    assert np.std(turns) == pytest.approx(straight.duration * 0.004, rel=0.12)


def test_the_same_seed_drifts_the_same_way() -> None:
    one, same, other = (measure_odometry(WAY, OdometryNoise(), np.random.default_rng(s)) for s in (1, 1, 2))
    assert (one.x == same.x).all()
    assert (one.x != other.x).any()
