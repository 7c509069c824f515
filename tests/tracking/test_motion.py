import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from palletloc.geometry import FloatArray, LevelPose, wrap_angle
from tracking.motion import Motion, Twist, chain, no_motion, twist_between
from tracking.odometry import OdometryNoise

RATES = st.builds(Twist, st.floats(-3, 3), st.floats(-2, 2), st.floats(-3, 3) | st.floats(-1e-6, 1e-6))
NOISE = OdometryNoise()


def after(pose: LevelPose, increment: FloatArray) -> LevelPose:
    dx, dy, turn = increment.tolist()
    cos, sin = math.cos(pose.yaw), math.sin(pose.yaw)
    return LevelPose(pose.x + cos * dx - sin * dy, pose.y + sin * dx + cos * dy, 0.0, pose.yaw + turn)


def way(rng: np.random.Generator, count: int = 12) -> list[Motion]:
    return [NOISE.moved(Twist(*rng.normal(size=3).tolist()), float(rng.uniform(0.02, 0.3))) for _ in range(count)]


@given(RATES, st.floats(0.01, 1.0), st.floats(-3, 3))
def test_the_rates_between_two_poses_are_those_that_lead_from_one_to_the_other(
    twist: Twist, duration: float, yaw: float
) -> None:
    start = LevelPose(3.0, -2.0, 0.0, yaw)
    found = twist_between(start, after(start, twist.after(duration)), duration)
    expected = (twist.forward, twist.left, twist.turn)
    np.testing.assert_allclose((found.forward, found.left, found.turn), expected, atol=1e-8)


@given(RATES, st.floats(0.0, 2.0))
def test_constant_rates_lead_where_small_steps_lead(twist: Twist, duration: float) -> None:
    x = y = 0.0
    steps = 2000
    for k in range(steps):
        heading = twist.turn * duration * (k + 0.5) / steps
        x += (math.cos(heading) * twist.forward - math.sin(heading) * twist.left) * duration / steps
        y += (math.sin(heading) * twist.forward + math.cos(heading) * twist.left) * duration / steps
    np.testing.assert_allclose(twist.after(duration), [x, y, twist.turn * duration], atol=1e-5)


@pytest.mark.parametrize("turn", [9.9e-5, 1.01e-4])
def test_the_series_of_small_turns_joins_the_formulas(turn: float) -> None:
    exact = [2 * math.sin(turn) / turn, 2 * (1 - math.cos(turn)) / turn]
    np.testing.assert_allclose(Twist(2.0, 0.0, turn).after(1.0)[:2], exact, atol=1e-11)


def test_a_chain_ends_where_its_motions_lead_one_after_the_other() -> None:
    motions = way(np.random.default_rng(1))
    pose = LevelPose(0.0, 0.0, 0.0, 0.0)
    for motion in motions:
        pose = after(pose, motion.increment)
    whole = chain(motions)
    np.testing.assert_allclose(whole.increment, [pose.x, pose.y, pose.yaw], atol=1e-12)
    assert whole.path == pytest.approx(sum(motion.path for motion in motions))
    assert whole.duration == pytest.approx(sum(motion.duration for motion in motions))


def test_a_chain_carries_noise_and_constants_by_its_derivatives() -> None:
    motions = way(np.random.default_rng(2))

    def end(errors: FloatArray) -> FloatArray:
        moved = [replace(one, increment=one.increment + error) for one, error in zip(motions, errors, strict=True)]
        return chain(moved).increment

    step = 1e-6
    covariance, constants = np.zeros((3, 3)), np.zeros((3, 2))
    for i, motion in enumerate(motions):
        by_errors = np.zeros((3, 3))
        for j in range(3):
            errors = np.zeros((len(motions), 3))
            errors[i, j] = step
            by_errors[:, j] = (end(errors) - end(-errors)) / (2 * step)
        covariance += by_errors @ motion.covariance @ by_errors.T
        constants += by_errors @ motion.constants
    whole = chain(motions)
    np.testing.assert_allclose(whole.covariance, covariance, rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(whole.constants, constants, rtol=1e-6, atol=1e-9)


def test_it_does_not_matter_how_a_chain_is_grouped() -> None:
    motions = way(np.random.default_rng(3))
    whole, grouped = chain(motions), chain([chain(motions[:5]), chain(motions[5:7]), chain(motions[7:])])
    np.testing.assert_allclose(grouped.increment, whole.increment, atol=1e-12)
    np.testing.assert_allclose(grouped.covariance, whole.covariance, atol=1e-15)
    np.testing.assert_allclose(grouped.constants, whole.constants, atol=1e-12)


def test_no_motion_leads_nowhere() -> None:
    assert chain([]) is no_motion()
    assert not no_motion().increment.any()
    whole = chain([no_motion(), way(np.random.default_rng(4), 1)[0], no_motion()])
    np.testing.assert_allclose(whole.increment, way(np.random.default_rng(4), 1)[0].increment)


def test_half_a_turn_is_found_from_poses() -> None:
    found = twist_between(LevelPose(0.0, 0.0, 0.0, 0.0), LevelPose(0.0, 2.0, 0.0, wrap_angle(math.pi - 1e-9)), 1.0)
    np.testing.assert_allclose(found.after(1.0)[:2], [0.0, 2.0], atol=1e-6)
