from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from filterpy.kalman import ExtendedKalmanFilter

from palletloc.geometry import FloatArray, LevelPose, wrap_angle
from palletloc.measurement import PalletMeasurement, YawSource
from tracking.config import MeasurementErrors, TrackerConfig
from tracking.filter import PalletFilter
from tracking.motion import Motion, Twist
from tracking.observation import COMPONENTS, YAW, Observation, PartialMeasurement, observe
from tracking.odometry import OdometryNoise
from tracking.state import COMMON, CONSTANTS, POSE, SIZE, Gaussian

CONFIG = TrackerConfig()
NOISE = OdometryNoise()
ALONE = MeasurementErrors(0.0, 0.0, wander_m=0.0, wander_yaw_deg=0.0)
"""Measurements that share nothing, of pallets that stand still."""
PARTS = (("x", "y", "z", "yaw"), ("yaw",), ("x", "y", "z"), ("x", "y"), ("z", "yaw"))


def covariance(rng: np.random.Generator, size: int, sigma: float = 0.02) -> FloatArray:
    root = rng.normal(size=(size, size)) * sigma
    return np.asarray(root @ root.T + 0.1 * sigma**2 * np.eye(size))


def seen(
    pose: FloatArray, R: FloatArray, parts: Sequence[str] = COMPONENTS, config: TrackerConfig = CONFIG
) -> Observation:
    near = LevelPose(*pose.tolist())
    picked = pose[[COMPONENTS.index(name) for name in parts]]
    given: PalletMeasurement | PartialMeasurement = PartialMeasurement(0.0, "any", tuple(parts), picked, R, near)
    if tuple(parts) == COMPONENTS:
        given = PalletMeasurement(0.0, "any", near, R, 0.9, YawSource.FACE)
    (found,) = observe([given], config.errors)
    assert isinstance(found, Observation)
    return found


def moved(rng: np.random.Generator, speed: float = 0.6) -> Motion:
    return NOISE.moved(Twist(speed, 0.05 * rng.normal(), float(rng.uniform(-0.8, 0.8))), 0.1)


class Plain:
    """The extended Kalman filter as textbooks have it, by numbers alone."""

    def __init__(self, x: FloatArray, P: FloatArray) -> None:
        self.x, self.P = x, P

    @staticmethod
    def f(x: FloatArray, motion: Motion, noise: Any) -> Any:
        dx, dy, turn = motion.increment + motion.constants @ x[CONSTANTS] + noise[:3]
        stays = math.exp(-motion.path / CONFIG.errors.common_path_m)
        back = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
        place = back @ (x[:2] - np.array([dx, dy])) + noise[8:10]
        common = stays * x[COMMON] + noise[3:7]
        return np.array([*place, x[2] + noise[7], x[3] - turn + noise[10], *x[CONSTANTS], *common])

    def predict(self, motion: Motion) -> None:
        step, none = 1e-30, np.zeros(11)  # along the imaginary axis: no cancellation
        F = np.array([self.f(self.x + step * 1j * e, motion, none).imag / step for e in np.eye(10)]).T
        G = np.array([self.f(self.x, motion, step * 1j * e).imag / step for e in np.eye(11)]).T
        q = np.zeros((11, 11))
        q[:3, :3] = motion.covariance
        q[3:7, 3:7] = (1 - math.exp(-2 * motion.path / CONFIG.errors.common_path_m)) * np.eye(4)
        wander = CONFIG.errors.wander_m**2 * motion.path
        q[7, 7] = (1e-3 * NOISE.floor_mm_per_sqrt_m) ** 2 * motion.path + wander
        q[8, 8] = q[9, 9] = wander
        q[10, 10] = math.radians(CONFIG.errors.wander_yaw_deg) ** 2 * motion.path
        self.x = self.f(self.x, motion, none)
        self.P = F @ self.P @ F.T + G @ q @ G.T

    def update(self, one: Observation) -> None:
        H = np.zeros((len(one.components), 10))
        H[range(len(one.components)), one.components] = 1.0
        H[:, COMMON] = one.common
        away = one.values - H @ self.x
        if 3 in one.components:
            away[-1] = math.remainder(away[-1], 2 * math.pi)
        S = H @ self.P @ H.T + one.own
        K = self.P @ H.T @ np.linalg.inv(S)
        self.x = self.x + K @ away
        self.P = self.P - K @ S @ K.T


def test_it_is_the_textbooks_filter_over_500_steps_with_all_kinds_of_measurements() -> None:
    rng = np.random.default_rng(0)
    engine = PalletFilter(CONFIG)
    truth = np.array([5.0, 2.0, 0.5, 3.0])
    state = engine.begin(seen(truth, covariance(rng, 4)))
    plain = Plain(state.mean, state.covariance)
    for step in range(500):
        motion = moved(rng, 0.6 if step % 80 < 40 else -0.6)
        (predicted,) = engine.predicted([state], motion)
        plain.predict(motion)
        parts = PARTS[step % len(PARTS)]
        truth = Plain.f(np.concatenate([truth, np.zeros(6)]), motion, np.zeros(11))[:4]
        one = seen(truth + 0.01 * rng.normal(size=4), covariance(rng, len(parts)), parts)
        state = engine.updated(predicted.state, one)
        plain.update(one)
        away = state.mean - plain.x
        away[YAW] = math.remainder(away[YAW], 2 * math.pi)
        np.testing.assert_allclose(away, 0.0, atol=1e-10)
        np.testing.assert_allclose(state.covariance, plain.P, atol=1e-10)


def test_the_derivatives_of_a_step_are_those_of_finite_differences() -> None:
    rng = np.random.default_rng(1)
    engine = PalletFilter(CONFIG)
    motion, step = moved(rng), 1e-6
    for _ in range(20):
        x = np.array([4.0, -2.0, 0.3, 1.0, 0.01, 0.003, 0.5, -0.2, 1.0, 0.1]) * rng.uniform(0.5, 1.5, 10)
        F, Q, after = engine.transition(x, motion)
        ends = [engine.transition(x + e * step, motion)[2] for e in (*np.eye(10), *-np.eye(10))]
        slopes = (np.array(ends[:10]) - np.array(ends[10:])).T / (2 * step)
        np.testing.assert_allclose(F, slopes, atol=1e-8)
        noisy = [engine.transition(x, replace(motion, increment=motion.increment + e * step))[2] for e in np.eye(3)]
        G = (np.array(noisy) - after).T / step
        errors = CONFIG.errors
        wander = np.array([errors.wander_m] * 3 + [math.radians(errors.wander_yaw_deg)])
        Q[POSE, POSE] -= np.diag(wander**2) * motion.path
        Q[2, 2] -= (1e-3 * NOISE.floor_mm_per_sqrt_m) ** 2 * motion.path
        np.testing.assert_allclose(Q[POSE, POSE], (G @ motion.covariance @ G.T)[POSE, POSE], atol=1e-10)


def test_many_states_move_as_each_would_alone() -> None:
    rng = np.random.default_rng(2)
    engine, motion = PalletFilter(CONFIG), moved(rng)
    states = [Gaussian(rng.normal(size=SIZE), covariance(rng, SIZE)) for _ in range(7)]
    together = engine.predicted(states, motion)
    for state, found in zip(states, together, strict=True):
        (alone,) = engine.predicted([state], motion)
        for one, other in zip((*found.state, found.F), (*alone.state, alone.F), strict=True):
            np.testing.assert_allclose(one, other, rtol=0, atol=1e-14)
    assert engine.predicted([], motion) == []


@pytest.mark.parametrize("config", [CONFIG, replace(CONFIG, estimate_odometry=False)])
@pytest.mark.parametrize("parts", PARTS)
def test_many_states_are_compared_and_updated_as_each_would_alone(
    parts: tuple[str, ...], config: TrackerConfig
) -> None:
    rng = np.random.default_rng(5)
    engine = PalletFilter(config)
    scales, weights = rng.uniform(0.5, 4.0, 7).tolist(), rng.uniform(0.2, 1.0, 7).tolist()
    poses = rng.normal(size=(7, 4)) + np.array([0, 0, 0, 3.1])
    states = [
        one.state
        for pose in poses
        for one in engine.predicted([engine.begin(seen(pose, covariance(rng, 4)))], moved(rng))
    ]
    observations = [seen(pose, covariance(rng, len(parts)), parts) for pose in poses + 0.05 * rng.normal(size=(7, 4))]
    compared = engine.innovations(states, observations, scales)
    updated = engine.updates(states, observations, scales, weights)
    for i, case in enumerate(zip(states, observations, scales, strict=True)):
        assert compared[i] == pytest.approx(engine.innovation(*case), rel=1e-9)
        for one, other in zip(updated[i], engine.updated(*case, weights[i]), strict=True):
            np.testing.assert_allclose(one, other, rtol=0, atol=1e-12)


@pytest.mark.parametrize("parts", PARTS)
def test_an_update_is_that_of_filterpy(parts: tuple[str, ...]) -> None:
    rng = np.random.default_rng(6)
    engine, whole = PalletFilter(CONFIG), ExtendedKalmanFilter(dim_x=SIZE, dim_z=len(parts))
    for _ in range(20):
        pose = rng.normal(size=4)
        (predicted,) = engine.predicted([engine.begin(seen(pose, covariance(rng, 4)))], moved(rng))
        one = seen(pose + 0.02 * rng.normal(size=4), covariance(rng, len(parts)), parts)
        H, R = engine.model(one)
        whole.x, whole.P = predicted.state
        whole.update(one.values, lambda _, H=H: H, lambda x, H=H: H @ x, R=R)
        found = engine.updated(predicted.state, one)
        np.testing.assert_allclose(found.mean, whole.x, rtol=0, atol=1e-10)
        np.testing.assert_allclose(found.covariance, whole.P, rtol=0, atol=1e-10)


@pytest.mark.parametrize("parts", PARTS)
def test_the_distance_is_that_of_the_innovation(parts: tuple[str, ...]) -> None:
    rng = np.random.default_rng(3)
    engine = PalletFilter(CONFIG)
    truth = np.array([5.0, 2.0, 0.5, -3.0])
    state = engine.begin(seen(truth, covariance(rng, 4)))
    one = seen(truth + 0.02 * rng.normal(size=4), covariance(rng, len(parts)), parts)
    for scale in (1.0, 2.5):
        H, R = engine.model(one, scale)
        S = H @ state.covariance @ H.T + R
        away = one.values - H @ state.mean
        found = engine.innovation(state, one, scale)
        assert found.distance == pytest.approx(away @ np.linalg.inv(S) @ away)
        assert found.log_volume == pytest.approx(math.log(np.linalg.det(S)))
        np.testing.assert_allclose(H[:, COMMON] @ H[:, COMMON].T + R, scale * one.covariance, atol=1e-15)


def test_an_angle_is_compared_and_kept_the_short_way_round() -> None:
    engine = PalletFilter(CONFIG)
    R = np.diag([1e-4, 1e-4, 1e-4, 1e-4])
    state = engine.begin(seen(np.array([3.0, 1.0, 0.0, 3.13]), R))
    one = seen(np.array([3.0, 1.0, 0.0, -3.13]), R)
    assert engine.innovation(state, one).distance < 4
    assert abs(abs(engine.updated(state, one).mean[YAW]) - math.pi) < 0.01


def test_the_yaw_goes_round_and_round() -> None:
    rng = np.random.default_rng(4)
    engine = PalletFilter(CONFIG)
    truth = np.array([2.0, 0.0, 0.0, 0.0])
    R = np.diag([1e-4, 1e-4, 1e-4, 1e-5])
    state = engine.begin(seen(truth, R))
    turning = NOISE.moved(Twist(0.0, 0.0, 0.9), 0.2)
    for _ in range(400):
        truth = Plain.f(np.concatenate([truth, np.zeros(6)]), turning, np.zeros(11))[:4]
        (predicted,) = engine.predicted([state], turning)
        state = engine.updated(predicted.state, seen(truth + rng.multivariate_normal(np.zeros(4), R), R))
        assert -math.pi <= state.mean[YAW] < math.pi
        assert abs(wrap_angle(float(state.mean[YAW] - truth[YAW]))) < 0.02


def test_a_yaw_alone_tells_nothing_of_an_uncorrelated_place() -> None:
    engine = PalletFilter(CONFIG)
    state = engine.begin(seen(np.array([3.0, 1.0, 0.0, 1.0]), np.diag([1e-4] * 4)))
    found = engine.updated(state, seen(np.array([3.0, 1.0, 0.0, 1.02]), np.array([[1e-4]]), ("yaw",)))
    np.testing.assert_array_equal(found.mean[:3], state.mean[:3])
    assert 1.0 < found.mean[YAW] < 1.02
    assert found.covariance[YAW, YAW] < state.covariance[YAW, YAW]


def test_a_smaller_weight_and_a_larger_scale_count_less() -> None:
    engine = PalletFilter(CONFIG)
    R = np.diag([1e-4] * 4)
    state = engine.begin(seen(np.array([3.0, 1.0, 0.0, 1.0]), R))
    one = seen(np.array([3.1, 1.0, 0.0, 1.0]), R)
    steps = [engine.updated(state, one, *how).mean[0] for how in ((1.0, 1.0), (1.0, 0.5), (4.0, 1.0))]
    assert steps[0] > steps[1] > 3.0
    assert steps[0] > steps[2] > 3.0


@pytest.mark.slow
@pytest.mark.parametrize("estimated", [True, False])
def test_after_100_000_steps_the_covariance_is_still_one(estimated: bool) -> None:
    still_one(100_000, estimated)


@pytest.mark.parametrize("estimated", [True, False])
def test_after_many_steps_the_covariance_is_still_one(estimated: bool) -> None:
    still_one(3000, estimated)


def still_one(steps: int, estimated: bool) -> None:
    rng = np.random.default_rng(5)
    engine = PalletFilter(replace(CONFIG, estimate_odometry=estimated))
    R = np.diag([1e-6, 4e-4, 1e-8, 1e-6])
    state = engine.begin(seen(np.array([3.0, 1.0, 0.5, 1.0]), R))
    ways = [moved(rng) for _ in range(20)] + [moved(rng, -0.6) for _ in range(20)]
    one = seen(state.mean[POSE], R)
    for step in range(steps):
        (predicted,) = engine.predicted([state], ways[step % 40])
        one = replace(one, values=predicted.state.mean[POSE])
        state = engine.updated(predicted.state, one)
        if step % 97 == 0 or step == steps - 1:
            P = state.covariance
            np.testing.assert_array_equal(P, P.T)
            assert np.linalg.eigvalsh(P[POSE, POSE])[0] > 0
            scale = np.sqrt(np.diag(P))
            assert np.linalg.eigvalsh(P / np.outer(scale, scale))[0] > -1e-12


def errors_of(engine: PalletFilter, rng: np.random.Generator, wrong: bool = False) -> list[float]:
    """Return the normalised errors squared of a simulated drive before each measurement."""
    constants = NOISE.constants * rng.normal(size=2)
    truth = np.array([4.0, 1.5, 0.5, 1.0])
    R = np.diag([1e-5, 1e-5, 1e-5, 1e-6])
    config = replace(CONFIG, errors=ALONE)
    state = engine.begin(seen(truth + rng.multivariate_normal(np.zeros(4), R), R, COMPONENTS, config))
    found = []
    for step in range(60):
        motion = NOISE.moved(Twist(0.6 if step % 20 < 10 else -0.6, 0.0, 0.5 if step % 14 < 7 else -0.5), 0.25)
        noise = np.zeros(11)
        noise[:3] = rng.multivariate_normal(np.zeros(3), motion.covariance)
        noise[7] = 1e-3 * NOISE.floor_mm_per_sqrt_m * math.sqrt(motion.path) * rng.normal()
        truth = Plain.f(np.concatenate([truth, constants, np.zeros(4)]), motion, noise)[:4]
        (predicted,) = engine.predicted([state], motion)
        state = predicted.state
        if wrong:
            Q = engine.transition(state.mean, motion)[1]
            P = state.covariance - Q
            Q[:2, YAW] = Q[YAW, :2] = 0.0
            Q[:2, :2] = motion.covariance[:2, :2]
            state = Gaussian(state.mean, P + Q)
        away = truth - state.mean[POSE]
        away[YAW] = wrap_angle(float(away[YAW]))
        found.append(float(away @ np.linalg.solve(state.covariance[POSE, POSE], away)))
        state = engine.updated(state, seen(truth + rng.multivariate_normal(np.zeros(4), R), R, COMPONENTS, config))
    return found


@pytest.mark.parametrize("estimated", [True, False])
def test_errors_are_as_large_as_they_are_said_to_be(estimated: bool) -> None:
    rng = np.random.default_rng(6)
    config = replace(CONFIG, estimate_odometry=estimated, errors=ALONE)
    engine = PalletFilter(config)
    mean = np.mean([errors_of(engine, rng) for _ in range(40)])
    assert 3.6 < mean < 4.4


def test_without_the_cross_terms_of_the_turn_they_are_not() -> None:
    rng = np.random.default_rng(6)
    engine = PalletFilter(replace(CONFIG, errors=ALONE))
    assert np.mean([errors_of(engine, rng, wrong=True) for _ in range(40)]) > 4.8


def test_constants_that_are_only_allowed_for_stay_as_they_are() -> None:
    rng = np.random.default_rng(7)
    engine = PalletFilter(replace(CONFIG, estimate_odometry=False))
    truth = np.array([4.0, 1.5, 0.5, 3.1])
    state = engine.begin(seen(truth, covariance(rng, 4)))
    for _ in range(20):
        (predicted,) = engine.predicted([state], moved(rng))
        one = seen(predicted.state.mean[POSE] + 0.01, covariance(rng, 4))
        state = engine.updated(predicted.state, one)
    assert not state.mean[CONSTANTS].any()
    np.testing.assert_allclose(np.diag(state.covariance)[CONSTANTS], NOISE.constants**2)


def test_constants_are_learned_while_driving() -> None:
    engine = PalletFilter(CONFIG)
    constants = np.array([0.01, math.radians(0.2)])
    truth = np.array([8.0, 1.5, 0.5, 1.0])
    R = np.diag([1e-6, 1e-6, 1e-6, 1e-7])
    state = engine.begin(seen(truth, R))
    for step in range(100):
        motion = NOISE.moved(Twist(0.6 if step < 50 else -0.6, 0.0, 0.1), 0.2)
        truth = Plain.f(np.concatenate([truth, constants, np.zeros(4)]), motion, np.zeros(11))[:4]
        (predicted,) = engine.predicted([state], motion)
        state = engine.updated(predicted.state, seen(truth, R))
    np.testing.assert_allclose(state.mean[CONSTANTS], constants, rtol=0.25)
    assert (np.sqrt(np.diag(state.covariance)[CONSTANTS]) < 0.6 * NOISE.constants).all()
