"""Smoothing pallets that share one estimate, against the least squares solution of all measurements at once."""

import math
from itertools import pairwise

import numpy as np
import pytest

from palletloc.geometry import FloatArray, LevelPose
from palletloc.measurement import PalletMeasurement, YawSource
from tracking.config import MeasurementErrors, TrackerConfig
from tracking.filter import GroupFilter
from tracking.gating import Association
from tracking.motion import Twist
from tracking.observation import Observation, observe
from tracking.odometry import OdometryNoise
from tracking.smoother import smoothed_groups
from tracking.state import Key, TrackGroup, regrouped

NOISE = OdometryNoise(
    gyro_bias_deg_s=0.0, gyro_random_walk_deg_per_sqrt_s=0.0, turn_deg_per_sqrt_turn=0.0, wheel_scale_percent=3.0
)
CONFIG = TrackerConfig(odometry=NOISE, errors=MeasurementErrors(wander_m=0.0, wander_yaw_deg=0.0))
"""Of a way without turns, whose equations are linear."""
MOTION = NOISE.moved(Twist(0.6, 0.0, 0.0), 0.5)
STEPS = 9
LIVES = (range(9), range(3, 9), range(6), range(4, 8))
"""At which steps each pallet is known: two come later, two go earlier."""
UNSEEN = {(0, 5), (1, 6), (2, 3)}
"""Pallets that are not seen at some steps."""
KEYS = tuple(Key(float(life[0]), str(number)) for number, life in enumerate(LIVES))
STAYS = math.exp(-MOTION.path / CONFIG.errors.common_path_m)


def measurements() -> dict[tuple[int, int], Observation]:
    """Return one of each pallet that is seen at each step; any values will do."""
    rng, found = np.random.default_rng(8), {}
    for number, life in enumerate(LIVES):
        for step in life:
            if (number, step) not in UNSEEN:
                place = np.array([5.0 + number - 0.3 * step, 2.0, 0.5 * number, 1.5]) + 0.02 * rng.normal(size=4)
                root = 0.01 * rng.normal(size=(4, 4))
                one = PalletMeasurement(
                    float(step),
                    "any",
                    LevelPose(*place.tolist()),
                    root @ root.T + 1e-5 * np.eye(4),
                    0.9,
                    YawSource.FACE,
                )
                (ready,) = observe([one], CONFIG.errors)
                assert isinstance(ready, Observation)
                found[number, step] = ready
    return found


def filtered(most: int) -> list[list[TrackGroup]]:
    group_filter, seen = GroupFilter(CONFIG), measurements()
    groups: list[TrackGroup] = []
    steps = []
    for step in range(STEPS):
        if step:
            groups = group_filter.predict_groups(groups, MOTION)
        alive = {KEYS[number] for number, life in enumerate(LIVES) if step in life}
        groups = regrouped(groups, (), alive & {key for group in groups for key in group.keys}, most)
        numbers = [[KEYS.index(key) for key in group.keys] for group in groups]
        hits = [
            [(at, Association(seen[number, step])) for at, number in enumerate(members) if (number, step) in seen]
            for members in numbers
        ]
        if step:
            groups = [
                group_filter.update_group(*pair) if pair[1] else pair[0] for pair in zip(groups, hits, strict=True)
            ]
        began = [(KEYS[n], group_filter.begin(seen[n, step])) for n, life in enumerate(LIVES) if step == life[0]]
        groups = regrouped(groups, began, alive, most)
        steps.append(groups)
    return steps


def least_squares() -> tuple[FloatArray, FloatArray, dict[tuple[int, int], FloatArray]]:
    """Return the solution, its covariance, and how each pallet's pose at each step depends on it.

    Unknown are the wheels' scale, what each motion adds to odometry and to the height, where each pallet was at the
    first step, and its shared error at every step.
    """
    moves, poses = 1 + 3 * np.arange(STEPS - 1), 1 + 3 * (STEPS - 1) + 4 * np.arange(len(LIVES))
    shared = {}
    size = int(poses[-1]) + 4
    for number, life in enumerate(LIVES):
        for step in life:
            shared[number, step] = size
            size += 4
    rows, values = [np.eye(size)[0] / NOISE.constants[0]], [0.0]
    noise = np.sqrt([*np.diag(MOTION.covariance)[:2], (1e-3 * NOISE.floor_mm_per_sqrt_m) ** 2 * MOTION.path])
    for move in moves:
        rows += list(np.eye(size)[move : move + 3] / noise[:, None])
        values += [0.0] * 3
    depends = {}
    for number, life in enumerate(LIVES):
        for step in life:
            J = np.zeros((4, size))
            J[:, poses[number] : poses[number] + 4] = np.eye(4)
            J[0, 0] = -step * MOTION.constants[0, 0]
            for move in moves[:step]:
                J[0, move] = J[1, move + 1] = -1.0
                J[2, move + 2] = 1.0
            depends[number, step] = J
        rows += list(np.eye(size)[shared[number, life[0]] : shared[number, life[0]] + 4])
        values += [0.0] * 4
        for earlier, later in pairwise(life):
            change = np.eye(size)[shared[number, later] :][:4] - STAYS * np.eye(size)[shared[number, earlier] :][:4]
            rows += list(change / math.sqrt(1 - STAYS**2))
            values += [0.0] * 4
    for (number, step), one in measurements().items():
        model = depends[number, step].copy()
        model[:, shared[number, step] : shared[number, step] + 4] = one.common
        whiten = np.linalg.inv(np.linalg.cholesky(one.own))
        rows += list(whiten @ model)
        values += list(whiten @ (one.values + np.array([step * MOTION.increment[0], 0.0, 0.0, 0.0])))
    A = np.array(rows)
    cov = np.linalg.inv(A.T @ A)
    return cov @ A.T @ np.array(values), cov, depends


@pytest.mark.parametrize("most", [8, 4])
def test_it_is_the_least_squares_solution_though_pallets_come_and_go(most: int) -> None:
    steps = filtered(most)
    solution, cov, depends = least_squares()
    compared = 0
    for step, (groups, states) in enumerate(zip(steps, smoothed_groups(steps), strict=True)):
        for group, state in zip(groups, states, strict=True):
            for key, place in zip(group.keys, places(group), strict=True):
                J = depends[KEYS.index(key), step]
                expected = J @ solution - [step * MOTION.increment[0], 0.0, 0.0, 0.0]
                assert state.mean[place] == pytest.approx(expected, abs=1e-9)
                assert state.covariance[np.ix_(place, place)] == pytest.approx(J @ cov @ J.T, abs=1e-11)
                compared += 1
    assert compared == sum(len(life) for life in LIVES)


def places(group: TrackGroup) -> list[list[int]]:
    """Return where the poses are: behind the first pallet's ten numbers eight for each other one."""
    return [[0, 1, 2, 3], *([10 + 8 * n + k for k in range(4)] for n in range(len(group.keys) - 1))]


def variances(most: int) -> dict[tuple[int, Key], float]:
    steps = filtered(most)
    return {
        (step, key): float(np.diag(state.covariance)[place[:2]].sum())
        for step, (groups, states) in enumerate(zip(steps, smoothed_groups(steps), strict=True))
        for group, state in zip(groups, states, strict=True)
        for key, place in zip(group.keys, places(group), strict=True)
    }


def test_alone_they_are_known_less_well() -> None:
    together, apart = variances(8), variances(1)
    assert together.keys() == apart.keys()
    assert all(together[key] < apart[key] for key in together)
