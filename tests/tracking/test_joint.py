"""Pallets that share one estimate: the textbook's equations for all of them, and what they tell each other."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from palletloc.geometry import FloatArray, LevelPose, wrap_angle
from palletloc.measurement import PalletMeasurement, YawSource
from tracking.config import MeasurementErrors, TrackerConfig
from tracking.filter import PalletFilter
from tracking.joint import Joint, alone, joined, joint_of, kept, places_of, regrouped
from tracking.joint_filter import JointFilter, Seen
from tracking.motion import Motion, Twist
from tracking.observation import COMPONENTS, YAW, Observation, PartialMeasurement, observe
from tracking.odometry import OdometryNoise
from tracking.state import COMMON, CONSTANTS, POSE, Gaussian
from tracking.track import Key

CONFIG = TrackerConfig()
NOISE = OdometryNoise()
PARTS = (("x", "y", "z", "yaw"), ("yaw",), ("x", "y", "z"), ("x", "y"), ("z", "yaw"))
ROW = np.array([[4.0, 2.0, 0.5, 3.1], [5.3, 2.1, 0.5, 3.0], [2.7, 1.9, 1.8, -3.1]])
KEYS = tuple(Key(0.0, name) for name in "abcdefgh")


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


def begun(engine: PalletFilter, observations: Sequence[Observation]) -> Joint:
    first, *others = (engine.begin(one) for one in sights)
    joint = alone(KEYS[0], first)
    for key, state in zip(KEYS[1:], others, strict=False):
        joint = joined(joint, key, state)
    return joint


class Plain:
    """All poses, then the constants, then all shared errors, by textbook and numbers alone."""

    def __init__(self, joint: Joint) -> None:
        places = places_of(len(joint.keys))
        self.count = len(joint.keys)
        self.order = np.concatenate([places[:, POSE].ravel(), places[0, CONSTANTS], places[:, COMMON].ravel()])
        mean, P = self.of(joint)
        self.x, self.P = mean, P

    def of(self, joint: Joint) -> tuple[FloatArray, FloatArray]:
        """Return the state of a joint estimate in this order."""
        return joint.state.mean[self.order], joint.state.covariance[np.ix_(self.order, self.order)]

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

    def predict(self, motion: Motion) -> None:
        step, size, others = 1e-30, len(self.x), 4 + 8 * self.count  # along the imaginary axis: no cancellation
        none = np.zeros(others)
        F = np.array([self.f(self.x + step * 1j * e, motion, none).imag / step for e in np.eye(size)]).T
        G = np.array([self.f(self.x + 0j, motion, step * 1j * e).imag / step for e in np.eye(others)]).T
        q = (1 - math.exp(-2 * motion.path / CONFIG.errors.common_path_m)) * np.eye(others)
        errors = CONFIG.errors
        wander = [errors.wander_m**2] * 3 + [math.radians(errors.wander_yaw_deg) ** 2]
        q[4 + 4 * self.count :, 4 + 4 * self.count :] = np.diag(wander * self.count) * motion.path
        q[:3, :3] = motion.covariance
        q[3, 3] = (1e-3 * NOISE.floor_mm_per_sqrt_m) ** 2 * motion.path
        self.x, self.P = self.f(self.x, motion, none), F @ self.P @ F.T + G @ q @ G.T

    def update(self, hits: Sequence[Seen]) -> None:
        H, R, away = [], [], []
        for member, one, scale, weight in hits:
            rows = np.zeros((len(one.components), len(self.x)))
            rows[range(len(one.components)), [4 * member + part for part in one.components]] = 1.0
            begin = 4 * self.count + 2 + 4 * member
            rows[:, begin : begin + 4] = math.sqrt(scale) * one.common
            off = one.values - rows @ self.x
            if YAW in one.components:
                off[-1] = math.remainder(off[-1], 2 * math.pi)
            H.append(rows)
            R.append(scale / weight * one.own)
            away.append(off)
        whole = np.concatenate(H)
        noise = np.zeros((len(whole), len(whole)))
        at = 0
        for block in R:
            noise[at : at + len(block), at : at + len(block)] = block
            at += len(block)
        S = whole @ self.P @ whole.T + noise
        K = self.P @ whole.T @ np.linalg.inv(S)
        self.x, self.P = self.x + K @ np.concatenate(away), self.P - K @ S @ K.T


def test_it_is_the_textbooks_filter_of_all_pallets_with_all_kinds_of_measurements() -> None:
    rng = np.random.default_rng(0)
    engine = PalletFilter(CONFIG)
    together = JointFilter(engine)
    truth = ROW.copy()
    joint = begun(engine, [seen(pose, covariance(rng, 4)) for pose in truth])
    plain = Plain(joint)
    for step in range(200):
        motion = moved(rng, 0.6 if step % 80 < 40 else -0.6)
        (joint,) = together.predicted([joint], motion)
        plain.predict(motion)
        exact = np.concatenate([truth.ravel(), np.zeros(2 + 4 * len(ROW))])
        truth = plain.f(exact, motion, np.zeros(4 + 8 * len(ROW)))[: truth.size].reshape(-1, 4)
        hits = []
        for member in np.flatnonzero(rng.uniform(size=len(ROW)) < 0.7).tolist():
            parts = PARTS[int(rng.integers(len(PARTS)))]
            one = seen(truth[member] + 0.01 * rng.normal(size=4), covariance(rng, len(parts)), parts)
            hits.append(Seen(member, one, float(rng.choice([1.0, 3.0])), float(rng.choice([1.0, 0.4]))))
        if hits:
            (joint,) = together.updated([joint], [hits])
            plain.update(hits)
        mean, P = plain.of(joint)
        away = mean - plain.x
        away[YAW : 4 * len(ROW) : 4] = wrap_angle(away[YAW : 4 * len(ROW) : 4])
        np.testing.assert_allclose(away, 0.0, atol=1e-9)
        np.testing.assert_allclose(P, plain.P, atol=1e-10)
        for own, place in zip(joint.members, places_of(len(ROW)), strict=True):
            np.testing.assert_array_equal(own.mean, joint.state.mean[place])
            np.testing.assert_array_equal(own.covariance, joint.state.covariance[np.ix_(place, place)])


def drawn(rng: np.random.Generator, count: int) -> Joint:
    """Return an estimate in which all depend on each other."""
    size = 2 + 8 * count
    return joint_of(KEYS[:count], Gaussian(rng.normal(size=size), covariance(rng, size)))


def test_many_estimates_at_once_come_out_as_each_alone() -> None:
    rng = np.random.default_rng(1)
    together, motion = JointFilter(PalletFilter(CONFIG)), moved(rng)
    joints = [drawn(rng, count) for count in (2, 1, 3, 2, 1, 1)]
    hits = [[Seen(0, seen(one.members[0].mean[POSE] + 0.01, covariance(rng, 4)))] for one in joints]
    all_of = together.updated(together.predicted(joints, motion), hits)
    for i, one in enumerate(all_of):
        (other,) = together.updated(together.predicted([joints[i]], motion), [hits[i]])
        assert one.keys == joints[i].keys == one.carried
        np.testing.assert_allclose(one.state.mean, other.state.mean, rtol=0, atol=1e-12)
        np.testing.assert_allclose(one.state.covariance, other.state.covariance, rtol=0, atol=1e-12)
    assert together.predicted([], motion) == []
    assert together.updated([], []) == []


def test_the_others_go_on_the_same_when_one_that_is_not_seen_is_left_out() -> None:
    rng = np.random.default_rng(2)
    together, motion = JointFilter(PalletFilter(CONFIG)), moved(rng)
    whole, (a, b, c) = drawn(rng, 3), KEYS[:3]
    one = seen(whole.members[2].mean[POSE] + 0.01, covariance(rng, 4))
    (after,) = together.updated(together.predicted([whole], motion), [[Seen(2, one)]])
    (early,) = together.updated(together.predicted([kept(whole, [c, a])], motion), [[Seen(0, one)]])
    late = kept(after, [c, a])
    assert late.keys == early.keys == (c, a)
    np.testing.assert_allclose(late.state.mean, early.state.mean, atol=1e-12)
    np.testing.assert_allclose(late.state.covariance, early.state.covariance, atol=1e-12)
    assert kept(whole, [a, b, c]) is whole


def test_new_tracks_go_where_there_is_room_and_what_began_anew_knows_nothing_of_the_others() -> None:
    rng = np.random.default_rng(3)
    first, fresh = drawn(rng, 3), drawn(rng, 1).state
    a, b, c, d, e = KEYS[:5]
    one, other = regrouped([first], [(d, fresh), (e, fresh)], {a, c, d, e}, 3)
    assert (one.keys, other.keys) == ((a, c, d), (e,))
    np.testing.assert_array_equal(one.members[1].covariance, first.members[2].covariance)
    (anew,) = regrouped([first], [(b, fresh)], {a, b, c}, 3)
    assert anew.keys == (a, c, b)
    of_others = np.concatenate(places_of(3)[:2])
    assert not anew.state.covariance[np.ix_(of_others, places_of(3)[2, POSE])].any()
    np.testing.assert_array_equal(anew.members[2].mean[POSE], fresh.mean[POSE])
    np.testing.assert_array_equal(
        anew.members[2].covariance[CONSTANTS, CONSTANTS], first.members[0].covariance[CONSTANTS, CONSTANTS]
    )
    assert regrouped([first], [], set(), 3) == []


def drive(rng: np.random.Generator, keep: bool = True) -> tuple[list[float], list[float]]:
    """Return normalised squares of all errors, and of those of one pallet against another, at each shot of a drive.

    Pallets that are not kept together are filtered alone.
    """
    config = replace(CONFIG, errors=MeasurementErrors(0.0, 0.0, wander_m=0.0, wander_yaw_deg=0.0))
    engine = PalletFilter(config)
    together, R = JointFilter(engine), np.diag([1e-4, 1e-4, 1e-6, 1e-5])
    constants, truth = NOISE.constants * rng.normal(size=2), ROW.copy()

    def shot() -> list[Observation]:
        return [seen(pose + rng.multivariate_normal(np.zeros(4), R), R, config=config) for pose in truth]

    whole = begun(engine, shot())
    joints = [whole] if keep else [alone(key, state) for key, state in zip(whole.keys, whole.members, strict=True)]
    every, apart = [], []
    for step in range(30):
        motion = NOISE.moved(Twist(0.6 if step % 20 < 10 else -0.6, 0.0, 0.5 if step % 14 < 7 else -0.5), 0.5)
        dx, dy, turn = (
            motion.increment + motion.constants @ constants + rng.multivariate_normal(np.zeros(3), motion.covariance)
        )
        back = np.array([[math.cos(turn), math.sin(turn)], [-math.sin(turn), math.cos(turn)]])
        truth[:, :2] = (truth[:, :2] - [dx, dy]) @ back.T
        truth[:, 2] += 1e-3 * NOISE.floor_mm_per_sqrt_m * math.sqrt(motion.path) * rng.normal()
        truth[:, 3] = wrap_angle(truth[:, 3] - turn)
        hits = [Seen(member, one) for member, one in enumerate(shot())]
        joints = together.predicted(joints, motion)
        joints = together.updated(joints, [hits] if keep else [[hit._replace(member=0)] for hit in hits])
        members = [state for joint in joints for state in joint.members]
        away = np.array([state.mean[POSE] for state in members]) - truth
        away[:, 3] = wrap_angle(away[:, 3])
        P = np.zeros((12, 12))
        places = places_of(3)[:, POSE].ravel()
        if keep:
            P = joints[0].state.covariance[np.ix_(places, places)]
        else:
            for i, state in enumerate(members):
                P[4 * i : 4 * i + 4, 4 * i : 4 * i + 4] = state.covariance[POSE, POSE]
        every.append(float(away.ravel() @ np.linalg.solve(P, away.ravel())))
        between = np.hstack([np.eye(4), -np.eye(4), np.zeros((4, 4))])
        off = between @ away.ravel()
        apart.append(float(off @ np.linalg.solve(between @ P @ between.T, off)))
    return every, apart


def test_errors_of_all_and_of_one_against_another_are_as_large_as_they_are_said_to_be() -> None:
    rng = np.random.default_rng(4)
    runs = [drive(rng) for _ in range(40)]
    every, apart = (float(np.mean([run[k] for run in runs])) for k in (0, 1))
    assert abs(every / 12 - 1) < 0.1
    assert abs(apart / 4 - 1) < 0.1


def test_of_pallets_alone_it_is_not_known_that_the_odometry_moves_them_alike() -> None:
    rng = np.random.default_rng(4)
    apart = np.mean([drive(rng, keep=False)[1] for _ in range(40)])
    assert apart < 3.3


@pytest.mark.parametrize("estimated", [True, False])
def test_what_one_pallet_tells_of_the_motion_mends_another_that_is_hidden(estimated: bool) -> None:
    engine = PalletFilter(replace(CONFIG, estimate_odometry=estimated))
    together, R = JointFilter(engine), np.diag([1e-6, 1e-6, 1e-6, 1e-7])
    joint = begun(engine, [seen(pose, R) for pose in ROW[:2]])
    motion = NOISE.moved(Twist(0.6, 0.0, 0.0), 1.0)
    slipped = ROW[:2] - [0.63, -0.004, 0.0, 0.0]  # five centimetres in the metre, and to the right
    (before,) = together.predicted([joint], motion)
    (after,) = together.updated([before], [[Seen(0, seen(slipped[0], R))]])
    off = [abs(one.members[1].mean[:2] - slipped[1, :2]) for one in (before, after)]
    assert (off[1] < [0.1, 0.5] * off[0]).all()
    sigmas = [np.sqrt(np.diag(one.members[1].covariance)[:2]) for one in (before, after)]
    assert (sigmas[1] < 0.7 * sigmas[0]).all()
    if not estimated:
        assert not after.state.mean[CONSTANTS].any()


def test_what_rounding_spoils_is_taken_one_by_one_and_hurts_no_other_estimate() -> None:
    """Two tracks that cannot differ, a million times vaguer than they are measured: rounding leaves no covariance."""
    rng = np.random.default_rng(5)
    engine = PalletFilter(replace(CONFIG, errors=MeasurementErrors(0.0, 0.0, wander_m=0.0, wander_yaw_deg=0.0)))
    together, R = JointFilter(engine), 1e-12 * np.eye(4)
    hits = [Seen(member, seen(ROW[member], R)) for member in (0, 1)]
    begin = begun(engine, [hit.observation for hit in hits])
    places = places_of(2)[:, POSE].ravel()
    P = begin.state.covariance.copy()
    P[np.ix_(places, places)] = 1e6 * np.tile(np.eye(4), (2, 2))
    stuck, fine = joint_of(begin.keys, Gaussian(begin.state.mean, P)), drawn(rng, 2)
    one = Seen(1, seen(fine.members[1].mean[POSE], np.eye(4)))
    (expected,) = together.updated([fine], [[one]])
    first, after = together.updated([fine, stuck], [[one], hits])
    np.testing.assert_array_equal(first.state.covariance, expected.state.covariance)
    assert np.isfinite(after.state.mean).all()
    assert np.abs(after.state.mean[places] - ROW[:2].ravel()).max() < 1e-3
    variances = np.diag(after.state.covariance)
    assert ((variances[places] >= 0) & (variances[places] < 1e-3)).all()


@pytest.mark.slow
@pytest.mark.parametrize("estimated", [True, False])
def test_after_100_000_steps_the_covariance_is_still_one(estimated: bool) -> None:
    still_one(100_000, estimated)


@pytest.mark.parametrize("estimated", [True, False])
def test_after_many_steps_the_covariance_is_still_one(estimated: bool) -> None:
    still_one(2000, estimated)


def still_one(steps: int, estimated: bool) -> None:
    rng = np.random.default_rng(6)
    engine = PalletFilter(replace(CONFIG, estimate_odometry=estimated))
    together, R = JointFilter(engine), np.diag([1e-6, 4e-4, 1e-8, 1e-6])
    ones = [seen(pose, R) for pose in ROW]
    joint = begun(engine, ones)
    ways = [moved(rng) for _ in range(20)] + [moved(rng, -0.6) for _ in range(20)]
    for step in range(steps):
        (joint,) = together.predicted([joint], ways[step % 40])
        hits = [
            Seen(i, replace(ones[i], values=joint.members[i].mean[POSE])) for i in range(len(ROW)) if (step + i) % 3
        ]
        (joint,) = together.updated([joint], [hits])
        if step % 97 == 0 or step == steps - 1:
            P = joint.state.covariance
            np.testing.assert_array_equal(P, P.T)
            scale = np.sqrt(np.diag(P))
            assert np.linalg.eigvalsh(P / np.outer(scale, scale))[0] > -1e-12
            assert min(np.linalg.eigvalsh(one.covariance[POSE, POSE])[0] for one in joint.members) > 0
