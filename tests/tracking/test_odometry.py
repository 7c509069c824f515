import math
from dataclasses import replace

import numpy as np
import pytest

from palletloc.geometry import LevelPose
from palletloc.trajectory import Trajectory
from tracking.motion import Twist, chain
from tracking.odometry import Odometry, OdometryNoise, check_odometry, mean_rates, rates_between, samples_of
from tracking.validation import BadInputError

NOISE = OdometryNoise()
HERE = LevelPose(1.0, 2.0, 0.0, 0.3)
TWIST = Twist(0.8, 0.1, 0.2)


def test_the_derivatives_by_the_constant_errors_are_those_of_the_motion() -> None:
    motion = NOISE.moved(TWIST, 0.02)
    step = 1e-6
    for j, change in enumerate(((1 + step, 0.0), (1.0, step))):
        scale, bias = change
        wrong = Twist(TWIST.forward * scale, TWIST.left * scale, TWIST.turn + bias)
        slope = (wrong.after(0.02) - TWIST.after(0.02)) / step
        np.testing.assert_allclose(motion.constants[:, j], slope, rtol=1e-3, atol=1e-5)


@pytest.mark.parametrize("rates", [None, np.diag([1e-4, 2e-5, 3e-4])])
def test_the_noise_of_a_straight_way_does_not_depend_on_how_it_is_cut(rates: np.ndarray | None) -> None:
    ahead = Twist(0.8, 0.1, 0.0)
    whole = NOISE.moved(ahead, 1.0, rates, 0.02)
    for pieces in (2, 7, 50):
        cut = chain([NOISE.moved(ahead, 1 / pieces, rates, 0.02)] * pieces)
        np.testing.assert_allclose(cut.covariance, whole.covariance, rtol=1e-9, atol=1e-15)
        np.testing.assert_allclose(cut.constants, whole.constants, rtol=1e-9, atol=1e-12)


def test_on_a_curve_it_does_not_but_for_the_second_order_of_the_turn() -> None:
    whole = NOISE.moved(TWIST, 0.5)
    cut = chain([NOISE.moved(TWIST, 0.01)] * 50)
    scale = np.sqrt(np.diag(cut.covariance))
    assert np.abs((whole.covariance - cut.covariance) / np.outer(scale, scale)).max() < 2 * 0.1**2


def test_noise_is_what_the_data_sheet_says() -> None:
    metre = NOISE.moved(Twist(1.0, 0.0, 0.0), 1.0)
    assert math.sqrt(metre.covariance[0, 0]) == pytest.approx(math.hypot(3e-3, 4e-3))
    assert math.degrees(math.sqrt(metre.covariance[2, 2])) == pytest.approx(0.08)
    turn = NOISE.moved(Twist(0.0, 0.0, 2 * math.pi), 1.0)
    assert math.degrees(math.sqrt(turn.covariance[2, 2])) == pytest.approx(math.hypot(0.5, 0.08))


def test_a_forklift_that_stands_stays_where_it_is() -> None:
    still = NOISE.moved(Twist(0.0, 0.0, 0.0), 3.0)
    assert not still.covariance.any()
    assert still.path == 0
    assert still.constants[2, 1] == 3.0  # the bias of the rate goes on


def test_between_samples_the_place_is_the_less_known_the_farther_they_are() -> None:
    assert not NOISE.between_samples(0.0, 0.5).any()
    middle = NOISE.between_samples(0.1, 0.1)
    assert math.sqrt(middle[0, 0]) == pytest.approx(0.5 * 0.1 * 0.1 / 2)


def test_rates_come_from_poses_else_from_the_rates() -> None:
    posed, later = Odometry(0.0, HERE), Odometry(2.0, LevelPose(3.0, 2.0, 0.0, 0.3), Twist(9.0, 9.0, 9.0))
    between = rates_between(posed, later)
    assert between is not None
    assert math.hypot(between.forward, between.left) == pytest.approx(1.0)
    assert mean_rates(Odometry(0.0, None, Twist(1.0, 0.0, 0.0)), Odometry(1.0, None, Twist(3.0, 2.0, 1.0))) == Twist(
        2.0, 1.0, 0.5
    )
    assert rates_between(posed, Odometry(1.0, None, TWIST)) == TWIST
    assert mean_rates(posed, posed) is None


def test_samples_of_a_recording() -> None:
    columns = np.array([[0.0, 0.1], [1.0, 1.1], [2.0, 2.0], [0.0, 0.1]])
    path = Trajectory(*columns)
    bare = samples_of(path)
    assert [each.time for each in bare] == [0.0, 0.1]
    assert bare[1].pose == LevelPose(1.1, 2.0, 0.0, 0.1)
    assert bare[0].twist is None
    rated = samples_of(replace(path, speed=np.array([1.0, 2.0]), yaw_rate=np.array([0.1, 0.2])))
    assert rated[1].twist == Twist(2.0, 0.0, 0.2)


@pytest.mark.parametrize(
    ("sample", "words"),
    [
        (Odometry(math.nan, HERE), "time"),
        (Odometry(math.inf, HERE), "time"),
        (Odometry(1.0), "expected a pose, rates, or both"),
        (Odometry(1.0, LevelPose(math.nan, 0.0, 0.0, 0.0)), "pose"),
        (Odometry(1.0, LevelPose(1e7, 0.0, 0.0, 0.0)), "pose"),
        (Odometry(1.0, None, Twist(math.inf, 0.0, 0.0)), "twist"),
        (Odometry(1.0, HERE, frame="map"), "'map'"),
        (Odometry(1.0, HERE, child_frame="camera"), "'camera'"),
        (Odometry(1.0, HERE, covariance=-np.eye(3)), "positive definite"),
        (Odometry(1.0, HERE, covariance=np.eye(4)), "3 x 3"),
        (Odometry(1.0, HERE, covariance=np.array([["a"]])), "expected numbers"),
        (Odometry(1.0, HERE, covariance=np.full((3, 3), np.nan)), "finite"),
        (Odometry(1.0, HERE, covariance=np.eye(3) + np.diag([0.5, 0.5], 1)), "symmetric"),
    ],
)
def test_what_cannot_be_used_is_named_with_its_time(sample: Odometry, words: str) -> None:
    with pytest.raises(BadInputError, match=words) as fault:
        check_odometry(sample)
    assert repr(sample.time) in str(fault.value)


def test_a_sound_sample_is_kept_as_it_is() -> None:
    sample = Odometry(1.0, HERE, TWIST, 1e-4 * np.eye(3))
    assert check_odometry(sample).contents == sample.contents
    assert check_odometry(Odometry(1.0, HERE)).covariance is None
