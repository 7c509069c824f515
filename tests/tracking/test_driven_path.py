import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from palletloc.geometry import LevelPose, wrap_angle
from palletloc.trajectory import Trajectory
from tracking.driven_path import MOST_KEPT, UNKNOWN_SPEED, DrivenPath
from tracking.motion import Twist, chain
from tracking.odometry import Odometry, OdometryNoise, PathLimits

NOISE = OdometryNoise()


def driven(*samples: Odometry) -> DrivenPath:
    path = DrivenPath(NOISE, PathLimits())
    for sample in samples:
        path.put(sample)
    return path


def circle(time: float) -> LevelPose:
    return LevelPose(2 * math.sin(0.4 * time), 2 - 2 * math.cos(0.4 * time), 0.0, wrap_angle(0.4 * time))


SAMPLES = [Odometry(0.1 * k, circle(0.1 * k)) for k in range(30)]


def test_motion_between_samples_is_that_of_the_poses() -> None:
    motion = driven(*SAMPLES).motion(SAMPLES[3].time, SAMPLES[20].time)
    assert motion is not None
    np.testing.assert_allclose(motion.increment, Twist(0.8, 0.0, 0.4).after(1.7), atol=1e-9)
    parts = [driven(*SAMPLES).motion(a.time, b.time) for a, b in pairwise(SAMPLES[3:21])]
    whole = chain([part for part in parts if part is not None])
    np.testing.assert_allclose(motion.covariance, whole.covariance, atol=1e-15)


@given(st.floats(-0.4, 3.3), st.floats(0.0, 2.0))
def test_at_constant_rates_every_motion_is_known_even_beyond_the_samples(start: float, duration: float) -> None:
    end = min(start + duration, 3.3)
    motion = driven(*SAMPLES).motion(min(start, end), end)
    assert motion is not None
    np.testing.assert_allclose(motion.increment, Twist(0.8, 0.0, 0.4).after(end - min(start, end)), atol=1e-9)
    assert np.linalg.eigvalsh(motion.covariance)[0] >= -1e-15


@given(st.permutations(range(12)))
def test_samples_may_come_in_any_order(order: list[int]) -> None:
    path, mixed = driven(*SAMPLES[:12]), DrivenPath(NOISE, PathLimits())
    for number in order:
        mixed.put(SAMPLES[number])
        mixed.motion(-0.2, 0.05)  # what is asked in between must not stick
        mixed.motion(0.05, 0.95)
    for ends in ((-0.2, 0.05), (0.05, 0.95), (0.33, 1.5)):
        one, other = path.motion(*ends), mixed.motion(*ends)
        assert one is not None
        assert other is not None
        np.testing.assert_array_equal(one.increment, other.increment)
        np.testing.assert_array_equal(one.covariance, other.covariance)


def test_a_sample_put_again_takes_the_place_of_the_first() -> None:
    path = driven(*SAMPLES[:3])
    assert path.put(Odometry(SAMPLES[1].time, LevelPose(0.05, 0.0, 0.0, 0.0))) == -math.inf
    assert len(path) == 3
    found = path.find(SAMPLES[1].time)
    assert found is not None
    assert found.pose == LevelPose(0.05, 0.0, 0.0, 0.0)
    assert path.find(0.123) is None


def test_where_motions_changed_is_told() -> None:
    path = driven(*SAMPLES[:5], *SAMPLES[6:10])
    assert path.put(SAMPLES[5]) == SAMPLES[4].time
    assert path.put(SAMPLES[10]) == SAMPLES[9].time


def test_beyond_the_samples_a_motion_is_less_sure_and_ends_at_the_limit() -> None:
    path = driven(*SAMPLES)
    last = SAMPLES[-1].time
    ahead = [path.motion(last, last + step) for step in (0.0, 0.2, 0.4)]
    spread = [each.covariance[0, 0] for each in ahead if each is not None]
    assert spread == sorted(spread)
    assert spread[0] < spread[-1]
    assert path.motion(last, last + 0.6) is None
    assert path.motion(-0.6, last) is None
    assert path.extrapolated(last, last + 60) is not None


def test_before_any_sample_nothing_is_known() -> None:
    path = driven()
    assert path.span is None
    assert path.motion(0.0, 1.0) is None
    assert path.extrapolated(0.0, 1.0) is None
    assert path.pose_at(0.0) is None
    assert path.last_before(0.0) is None
    assert path.first_after(0.0) is None
    assert not path.reaches(0.0)
    assert not path.is_between_samples(0.0)


def test_a_single_sample_without_rates_knows_no_speed() -> None:
    motion = driven(SAMPLES[0]).motion(0.0, 0.4)
    assert motion is not None
    assert not motion.increment.any()
    assert math.sqrt(motion.covariance[0, 0]) == pytest.approx(UNKNOWN_SPEED * 0.4, rel=0.05)


def test_rates_alone_make_a_path() -> None:
    path = driven(*(Odometry(0.1 * k, None, Twist(0.8, 0.0, 0.4)) for k in range(5)))
    motion = path.motion(0.0, 0.4)
    assert motion is not None
    np.testing.assert_allclose(motion.increment, Twist(0.8, 0.0, 0.4).after(0.4))
    assert path.pose_at(0.2) is None


@pytest.mark.parametrize("later", [LevelPose(50.0, 0.0, 0.0, 0.0), LevelPose(0.0, 0.0, 0.0, 3.0)])
def test_a_pose_that_jumps_is_no_motion(later: LevelPose) -> None:
    slow = Twist(0.5, 0.0, 0.0)
    still = LevelPose(0.0, 0.0, 0.0, 0.0)
    path = driven(Odometry(0.0, still, slow), Odometry(0.1, later, slow))
    assert path.jumps_at(0.1)
    motion = path.motion(0.0, 0.1)
    assert motion is not None
    np.testing.assert_allclose(motion.increment, [0.05, 0.0, 0.0])
    unknown = driven(Odometry(0.0, still), Odometry(0.1, later)).motion(0.0, 0.1)
    assert unknown is not None
    assert not unknown.increment.any()
    assert math.sqrt(unknown.covariance[0, 0]) == pytest.approx(UNKNOWN_SPEED * 0.1)


def test_rates_that_no_forklift_has_are_not_believed() -> None:
    path = driven(*(Odometry(0.1 * k, None, Twist(1e5, 0.0, 0.0)) for k in range(3)))
    for ends in ((0.0, 0.2), (0.2, 0.5)):
        motion = path.motion(*ends)
        assert motion is not None
        assert not motion.increment.any()


@pytest.mark.parametrize("time", [0.0, 0.05, 0.1, 0.234, 0.9, -0.04, 0.94])
def test_the_pose_at_a_time_is_the_trajectorys(time: float) -> None:
    straight = [Odometry(0.1 * k, LevelPose(0.1 * k, 0.05 * k, 0.0, 0.7)) for k in range(10)]
    columns = np.array([[each.time, *each.pose.as_array()[[0, 1, 3]]] for each in straight if each.pose]).T
    expected, found = Trajectory(*columns).pose_at(time), driven(*straight).pose_at(time)
    assert found is not None
    np.testing.assert_allclose(found.as_array(), expected.as_array(), atol=1e-9)


def test_on_a_curve_the_pose_is_on_the_arc() -> None:
    path = driven(*SAMPLES)
    for time in (-0.1, 0.0, 0.72, 1.0, 2.95):
        found = path.pose_at(time)
        assert found is not None
        np.testing.assert_allclose(found.as_array(), circle(time).as_array(), atol=1e-9)


def test_what_is_forgotten_does_not_change_later_motions() -> None:
    path, whole = driven(*SAMPLES), driven(*SAMPLES)
    path.motion(0.05, 0.3)
    path.forget_before(1.23)
    assert len(path) < len(whole)
    assert path.span == (SAMPLES[12].time, SAMPLES[-1].time)
    one, other = path.motion(1.23, 2.2), whole.motion(1.23, 2.2)
    assert one is not None
    assert other is not None
    np.testing.assert_array_equal(one.covariance, other.covariance)


def test_kept_motions_do_not_grow_without_end() -> None:
    path = driven(*SAMPLES)
    for k in range(3 * MOST_KEPT):
        path.motion(0.0, 1 + 1e-4 * k)
    assert len(path._kept) <= MOST_KEPT
