"""The filter of a group: the textbook's equations, filterpy's update, and what pallets tell each other."""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from filterpy.kalman import ExtendedKalmanFilter
from scipy.linalg import block_diag

from palletloc.geometry import FloatArray, LevelPose, wrap_angle
from palletloc.measurement import PalletMeasurement, YawSource
from tracking.config import MeasurementErrors, TrackerConfig
from tracking.filter import GroupFilter, model_of
from tracking.gating import Association
from tracking.motion import Motion, Twist
from tracking.observation import COMPONENTS, YAW, Observation, PartialMeasurement, observe
from tracking.odometry import OdometryNoise
from tracking.state import COMMON, CONSTANTS, POSE, Gaussian, Key, TrackGroup, members_of, places_of

CONFIG = TrackerConfig()
NOISE = OdometryNoise()
ALONE = replace(CONFIG, errors=MeasurementErrors(0.0, 0.0, wander_m=0.0, wander_yaw_deg=0.0))
"""Measurements that share nothing, of pallets that stand still."""
PARTS = (("x", "y", "z", "yaw"), ("yaw",), ("x", "y", "z"), ("x", "y"), ("z", "yaw"))
ROW = np.array([[4.0, 2.0, 0.5, 3.1], [5.3, 2.1, 0.5, 3.0], [2.7, 1.9, 1.8, -3.1]])
KEYS = tuple(Key(0.0, name) for name in "abc")
SHARP = np.diag([1e-6, 1e-6, 1e-6, 1e-7])
Hits = list[tuple[int, Association]]


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


def hit(member: int, *association: Any) -> tuple[int, Association]:
    return member, Association(*association)


def moved(rng: np.random.Generator, speed: float = 0.6) -> Motion:
    return NOISE.moved(Twist(speed, 0.05 * rng.normal(), float(rng.uniform(-0.8, 0.8))), 0.1)


def begun(group_filter: GroupFilter, observations: Sequence[Observation]) -> Gaussian:
    first, *others = (group_filter.begin(observation) for observation in observations)
    group = TrackGroup(KEYS[:1], first)
    for key, state in zip(KEYS[1:], others, strict=False):
        group = group.joined(key, state)
    return group.state


def predicted(group_filter: GroupFilter, state: Gaussian, motion: Motion) -> Gaussian:
    return group_filter.predict([state], motion)[0]


def drawn(rng: np.random.Generator, count: int) -> Gaussian:
    """Return a state in which all depend on each other."""
    size = 2 + 8 * count
    return Gaussian(rng.normal(size=size), covariance(rng, size))


class Plain:
    """All poses, then the constants, then all shared errors, by textbook and numbers alone."""

    def __init__(self, state: Gaussian) -> None:
        self.count = (len(state.mean) - 2) // 8
        places = places_of(self.count)
        self.order = np.concatenate([places[:, POSE].ravel(), places[0, CONSTANTS], places[:, COMMON].ravel()])
        self.x, self.P = self.of(state)

    def of(self, state: Gaussian) -> tuple[FloatArray, FloatArray]:
        """Return the state of a group in this order."""
        return state.mean[self.order], state.covariance[np.ix_(self.order, self.order)]

    def f(self, x: Any, motion: Motion, noise: Any) -> Any:
        size = 4 * self.count
        dx, dy, turn = motion.increment + motion.constants @ x[size : size + 2] + noise[:3]
        stays = math.exp(-motion.path / CONFIG.errors.common_path_m)
        east, north = x[:size:4] - dx, x[1:size:4] - dy
        after = np.array(x)
        after[:size:4] = np.cos(turn) * east + np.sin(turn) * north
        after[1:size:4] = np.cos(turn) * north - np.sin(turn) * east
        after[2:size:4] = x[2:size:4] + noise[3]
        after[3:size:4] = x[3:size:4] - turn
        after[:size] += noise[4 + size :]
        after[size + 2 :] = stays * x[size + 2 :] + noise[4 : 4 + size]
        return after

    def derivatives(self, motion: Motion) -> tuple[FloatArray, FloatArray]:
        """Return F and Q by derivatives along the imaginary axis, where nothing cancels."""
        step, size, none = 1e-30, len(self.x), np.zeros(4 + 8 * self.count)
        F = np.array([self.f(self.x + step * 1j * e, motion, none).imag / step for e in np.eye(size)]).T
        G = np.array([self.f(self.x + 0j, motion, step * 1j * e).imag / step for e in np.eye(len(none))]).T
        q = (1 - math.exp(-2 * motion.path / CONFIG.errors.common_path_m)) * np.eye(len(none))
        wander = [CONFIG.errors.wander_m**2] * 3 + [math.radians(CONFIG.errors.wander_yaw_deg) ** 2]
        q[4 + 4 * self.count :, 4 + 4 * self.count :] = np.diag(wander * self.count) * motion.path
        q[:3, :3] = motion.covariance
        q[3, 3] = (1e-3 * NOISE.floor_mm_per_sqrt_m) ** 2 * motion.path
        return F, G @ q @ G.T

    def predict(self, motion: Motion) -> None:
        F, Q = self.derivatives(motion)
        self.x, self.P = self.f(self.x, motion, np.zeros(4 + 8 * self.count)), F @ self.P @ F.T + Q

    def stacked(self, hits: Hits) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return H, R and the values of measurements."""
        rows, blocks = [], []
        for member, (observation, scale, weight, *_) in hits:
            H = np.zeros((len(observation.components), len(self.x)))
            H[range(len(H)), [4 * member + part for part in observation.components]] = 1.0
            H[:, 4 * self.count + 2 + 4 * member :][:, :4] = math.sqrt(scale) * observation.common
            rows.append(H)
            blocks.append(scale / weight * observation.own)
        values = np.concatenate([association.observation.values for _, association in hits])
        return np.concatenate(rows), np.asarray(block_diag(*blocks)), values

    def update(self, hits: Hits) -> None:
        H, R, values = self.stacked(hits)
        innovation = values - H @ self.x
        yaws = [part == YAW for _, association in hits for part in association.observation.components]
        innovation[yaws] = wrap_angle(innovation[yaws])
        S = H @ self.P @ H.T + R
        K = self.P @ H.T @ np.linalg.inv(S)
        self.x, self.P = self.x + K @ innovation, self.P - K @ S @ K.T


def measured(rng: np.random.Generator, truth: FloatArray) -> Hits:
    """Return measurements of some of the pallets, of all kinds."""
    hits = []
    for member in np.flatnonzero(rng.uniform(size=len(truth)) < 0.7).tolist():
        parts = PARTS[int(rng.integers(len(PARTS)))]
        observation = seen(truth[member] + 0.01 * rng.normal(size=4), covariance(rng, len(parts)), parts)
        hits.append(hit(member, observation, float(rng.choice([1.0, 3.0])), float(rng.choice([1.0, 0.4]))))
    return hits


@pytest.mark.parametrize(("count", "steps"), [(1, 400), (3, 200)])
def test_it_is_the_textbooks_filter_with_all_kinds_of_measurements(count: int, steps: int) -> None:
    rng, group_filter = np.random.default_rng(0), GroupFilter(CONFIG)
    truth = ROW[:count].copy()
    state = begun(group_filter, [seen(pose, covariance(rng, 4)) for pose in truth])
    plain = Plain(state)
    for step in range(steps):
        motion = moved(rng, 0.6 if step % 80 < 40 else -0.6)
        F, Q, _ = group_filter.transition(state.mean, motion)
        plain.x, plain.P = plain.of(state)
        derivatives = plain.derivatives(motion)
        for ours, theirs in zip((F, Q), derivatives, strict=True):
            np.testing.assert_allclose(ours[np.ix_(plain.order, plain.order)], theirs, atol=1e-12)
        state = predicted(group_filter, state, motion)
        plain.predict(motion)
        exact = np.concatenate([truth.ravel(), np.zeros(2 + 4 * count)])
        truth = plain.f(exact, motion, np.zeros(4 + 8 * count))[: truth.size].reshape(-1, 4)
        hits = measured(rng, truth)
        if hits:
            state = group_filter.update(state, hits)
            plain.update(hits)
        mean, P = plain.of(state)
        difference = mean - plain.x
        difference[YAW : 4 * count : 4] = wrap_angle(difference[YAW : 4 * count : 4])
        np.testing.assert_allclose(difference, 0.0, atol=1e-9)
        np.testing.assert_allclose(P, plain.P, atol=1e-10)


@pytest.mark.parametrize("count", [1, 3])
def test_predict_and_update_are_those_of_filterpy(count: int) -> None:
    rng, group_filter = np.random.default_rng(6), GroupFilter(CONFIG)
    for _ in range(30):
        state = begun(group_filter, [seen(rng.normal(size=4), covariance(rng, 4)) for _ in range(count)])
        motion = moved(rng)
        reference = ExtendedKalmanFilter(dim_x=len(state.mean), dim_z=4 * count)
        reference.F, reference.Q, mean = group_filter.transition(state.mean, motion)
        reference.x, reference.P = np.linalg.solve(reference.F, mean), state.covariance
        reference.predict()
        state = predicted(group_filter, state, motion)
        hits = measured(rng, np.array([member.mean[POSE] for member in members_of(state)]))
        if hits:
            plain = Plain(state)
            H, R, values = plain.stacked(hits)
            H = H[:, np.argsort(plain.order)]
            reference.update(values, lambda _, H=H: H, lambda x, H=H: H @ x, R=R)
            state = group_filter.update(state, hits)
        np.testing.assert_allclose(state.mean, reference.x, rtol=0, atol=1e-10)
        np.testing.assert_allclose(state.covariance, reference.P, rtol=0, atol=1e-10)


@pytest.mark.parametrize("parts", PARTS)
def test_the_distance_is_that_of_the_innovation(parts: tuple[str, ...]) -> None:
    rng, group_filter = np.random.default_rng(3), GroupFilter(CONFIG)
    state = group_filter.begin(seen(ROW[0], covariance(rng, 4)))
    observation = seen(ROW[0] + 0.02 * rng.normal(size=4), covariance(rng, len(parts)), parts)
    for scale in (1.0, 2.5):
        H, R = model_of(observation, scale)
        S = H @ state.covariance @ H.T + R
        innovation = observation.values - H @ state.mean
        found = group_filter.innovation(state, observation, scale)
        assert found.distance == pytest.approx(innovation @ np.linalg.inv(S) @ innovation)
        assert found.log_volume == pytest.approx(math.log(np.linalg.det(S)))
        np.testing.assert_allclose(H[:, COMMON] @ H[:, COMMON].T + R, scale * observation.covariance, atol=1e-15)


def test_an_angle_is_compared_and_kept_the_short_way_round() -> None:
    group_filter, R = GroupFilter(CONFIG), 1e-4 * np.eye(4)
    state = group_filter.begin(seen(np.array([3.0, 1.0, 0.0, 3.13]), R))
    observation = seen(np.array([3.0, 1.0, 0.0, -3.13]), R)
    assert group_filter.innovation(state, observation).distance < 4
    assert abs(abs(group_filter.update(state, [hit(0, observation)]).mean[YAW]) - math.pi) < 0.01


def test_the_yaw_goes_round_and_round() -> None:
    rng, group_filter = np.random.default_rng(4), GroupFilter(CONFIG)
    truth, R = np.array([2.0, 0.0, 0.0, 0.0]), np.diag([1e-4, 1e-4, 1e-4, 1e-5])
    state = group_filter.begin(seen(truth, R))
    plain, turning = Plain(state), NOISE.moved(Twist(0.0, 0.0, 0.9), 0.2)
    for _ in range(400):
        truth = plain.f(np.concatenate([truth, np.zeros(6)]), turning, np.zeros(12))[:4]
        observation = seen(truth + rng.multivariate_normal(np.zeros(4), R), R)
        state = group_filter.update(predicted(group_filter, state, turning), [hit(0, observation)])
        assert -math.pi <= state.mean[YAW] < math.pi
        assert abs(wrap_angle(float(state.mean[YAW] - truth[YAW]))) < 0.02


def test_a_yaw_alone_tells_nothing_of_an_uncorrelated_place() -> None:
    group_filter = GroupFilter(CONFIG)
    state = group_filter.begin(seen(np.array([3.0, 1.0, 0.0, 1.0]), 1e-4 * np.eye(4)))
    yaw = seen(np.array([3.0, 1.0, 0.0, 1.02]), np.array([[1e-4]]), ("yaw",))
    found = group_filter.update(state, [hit(0, yaw)])
    np.testing.assert_array_equal(found.mean[:3], state.mean[:3])
    assert 1.0 < found.mean[YAW] < 1.02
    assert found.covariance[YAW, YAW] < state.covariance[YAW, YAW]


def test_a_smaller_weight_and_a_larger_scale_count_less() -> None:
    group_filter, R = GroupFilter(CONFIG), 1e-4 * np.eye(4)
    state = group_filter.begin(seen(np.array([3.0, 1.0, 0.0, 1.0]), R))
    observation = seen(np.array([3.1, 1.0, 0.0, 1.0]), R)
    ways = ((1.0, 1.0), (1.0, 0.5), (4.0, 1.0))
    full, weighted, scaled = (group_filter.update(state, [hit(0, observation, *way)]).mean[0] for way in ways)
    assert full > max(weighted, scaled) >= min(weighted, scaled) > 3.0


@pytest.mark.parametrize("estimated", [True, False])
@pytest.mark.parametrize(
    ("count", "steps"), [(1, 2000), (3, 1000), *(pytest.param(m, 100_000, marks=pytest.mark.slow) for m in (1, 3))]
)
def test_after_many_steps_the_covariance_is_still_one(count: int, steps: int, estimated: bool) -> None:
    rng, R = np.random.default_rng(5), np.diag([1e-6, 4e-4, 1e-8, 1e-6])
    group_filter = GroupFilter(replace(CONFIG, estimate_odometry=estimated))
    observations = [seen(pose, R) for pose in ROW[:count]]
    state = begun(group_filter, observations)
    ways = [moved(rng) for _ in range(20)] + [moved(rng, -0.6) for _ in range(20)]
    for step in range(steps):
        state = predicted(group_filter, state, ways[step % 40])
        places = [member.mean[POSE] for member in members_of(state)]
        visible = [member for member in range(count) if count == 1 or (step + member) % 3]
        again = [(member, replace(observations[member], values=places[member])) for member in visible]
        state = group_filter.update(state, [hit(*pair) for pair in again])
        if step % 97 == 0 or step == steps - 1:
            P = state.covariance
            np.testing.assert_array_equal(P, P.T)
            scale = np.sqrt(np.diag(P))
            assert np.linalg.eigvalsh(P / np.outer(scale, scale))[0] > -1e-12
            assert min(np.linalg.eigvalsh(member.covariance[POSE, POSE])[0] for member in members_of(state)) > 0


def test_constants_that_are_only_allowed_for_stay_as_they_are() -> None:
    rng, group_filter = np.random.default_rng(7), GroupFilter(replace(CONFIG, estimate_odometry=False))
    state = group_filter.begin(seen(np.array([4.0, 1.5, 0.5, 3.1]), covariance(rng, 4)))
    for _ in range(20):
        state = predicted(group_filter, state, moved(rng))
        state = group_filter.update(state, [hit(0, seen(state.mean[POSE] + 0.01, covariance(rng, 4)))])
    assert not state.mean[CONSTANTS].any()
    np.testing.assert_allclose(np.diag(state.covariance)[CONSTANTS], NOISE.constants**2)


def test_constants_are_learned_while_driving() -> None:
    group_filter, constants = GroupFilter(CONFIG), np.array([0.01, math.radians(0.2)])
    truth = np.array([8.0, 1.5, 0.5, 1.0])
    state = group_filter.begin(seen(truth, SHARP))
    plain = Plain(state)
    for step in range(100):
        motion = NOISE.moved(Twist(0.6 if step < 50 else -0.6, 0.0, 0.1), 0.2)
        truth = plain.f(np.concatenate([truth, constants, np.zeros(4)]), motion, np.zeros(12))[:4]
        state = group_filter.update(predicted(group_filter, state, motion), [hit(0, seen(truth, SHARP))])
    np.testing.assert_allclose(state.mean[CONSTANTS], constants, rtol=0.25)
    assert (np.sqrt(np.diag(state.covariance)[CONSTANTS]) < 0.6 * NOISE.constants).all()


def test_the_others_go_on_the_same_when_a_pallet_that_is_not_seen_is_left_out() -> None:
    rng, group_filter = np.random.default_rng(2), GroupFilter(CONFIG)
    motion, (a, _, c) = moved(rng), KEYS
    whole = TrackGroup(KEYS, drawn(rng, 3))
    observation = seen(whole.members[c].mean[POSE] + 0.01, covariance(rng, 4))
    (after,) = group_filter.predict_groups([whole], motion)
    after = group_filter.update_group(after, [hit(2, observation)])
    (early,) = group_filter.predict_groups([whole.kept([c, a])], motion)
    early = group_filter.update_group(early, [hit(0, observation)])
    late = after.kept([c, a])
    assert late.keys == early.keys == early.carried == (c, a)
    np.testing.assert_allclose(late.state.mean, early.state.mean, atol=1e-12)
    np.testing.assert_allclose(late.state.covariance, early.state.covariance, atol=1e-12)


@pytest.mark.parametrize("estimated", [True, False])
def test_what_one_pallet_tells_of_the_motion_mends_another_that_is_hidden(estimated: bool) -> None:
    group_filter = GroupFilter(replace(CONFIG, estimate_odometry=estimated))
    state = begun(group_filter, [seen(pose, SHARP) for pose in ROW[:2]])
    slipped = ROW[:2] - [0.63, -0.004, 0.0, 0.0]  # five centimetres in the metre, and to the right
    before = predicted(group_filter, state, NOISE.moved(Twist(0.6, 0.0, 0.0), 1.0))
    after = group_filter.update(before, [hit(0, seen(slipped[0], SHARP))])
    off, sigmas = [], []
    for hidden in (members_of(state)[1] for state in (before, after)):
        off.append(abs(hidden.mean[:2] - slipped[1, :2]))
        sigmas.append(np.sqrt(np.diag(hidden.covariance)[:2]))
    assert (off[1] < [0.1, 0.5] * off[0]).all()
    assert (sigmas[1] < 0.7 * sigmas[0]).all()
    assert estimated or not after.mean[CONSTANTS].any()


def test_what_rounding_spoils_is_taken_one_measurement_at_a_time() -> None:
    """Two tracks that cannot differ, a million times vaguer than they are measured: rounding leaves no covariance."""
    group_filter, R = GroupFilter(ALONE), 1e-12 * np.eye(4)
    hits = [hit(member, seen(ROW[member], R)) for member in (0, 1)]
    begin = begun(group_filter, [association.observation for _, association in hits])
    places = places_of(2)[:, POSE].ravel()
    P = begin.covariance.copy()
    P[np.ix_(places, places)] = 1e6 * np.tile(np.eye(4), (2, 2))
    after = group_filter.update(Gaussian(begin.mean, P), hits)
    assert np.isfinite(after.mean).all()
    assert np.abs(after.mean[places] - ROW[:2].ravel()).max() < 1e-3
    variances = np.diag(after.covariance)[places]
    assert ((variances >= 0) & (variances < 1e-3)).all()
