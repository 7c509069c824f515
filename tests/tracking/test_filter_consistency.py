"""Whether the filter's errors are as large as it says, over simulated drives with the noise that it assumes."""

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest

from palletloc.geometry import FloatArray, LevelPose, wrap_angle
from palletloc.measurement import PalletMeasurement, YawSource
from tracking.config import MeasurementErrors, TrackerConfig
from tracking.filter import GroupFilter
from tracking.gating import Association
from tracking.motion import Motion, Twist
from tracking.observation import YAW, Observation, observe
from tracking.odometry import OdometryNoise
from tracking.state import POSE, Gaussian, Key, TrackGroup, members_of, places_of

NOISE = OdometryNoise()
CONFIG = TrackerConfig(errors=MeasurementErrors(0.0, 0.0, wander_m=0.0, wander_yaw_deg=0.0))
"""Measurements that share nothing, of pallets that stand still."""
ROW = np.array([[4.0, 2.0, 0.5, 3.1], [5.3, 2.1, 0.5, 3.0], [2.7, 1.9, 1.8, -3.1]])
R = np.diag([1e-5, 1e-5, 1e-6, 1e-6])


class Squares(NamedTuple):
    """Normalised squares of errors at each shot of a drive, before its measurements, by degree of freedom."""

    every: list[float]
    """Of all pallets."""
    between: list[float]
    """Of one pallet against another."""


def seen(pose: FloatArray, rng: np.random.Generator) -> Observation:
    values = pose + rng.multivariate_normal(np.zeros(4), R)
    (found,) = observe(
        [PalletMeasurement(0.0, "any", LevelPose(*values.tolist()), R, 0.9, YawSource.FACE)], CONFIG.errors
    )
    assert isinstance(found, Observation)
    return found


def normalised(error: FloatArray, covariance: FloatArray) -> float:
    return float(error @ np.linalg.solve(covariance, error)) / len(error)


def drive(
    rng: np.random.Generator, group_filter: GroupFilter, together: bool = True, cross_terms: bool = True
) -> Squares:
    """Return the squares of a drive; pallets that are not together are filtered alone."""
    constants, truth = NOISE.constants * rng.normal(size=2), ROW.copy()
    begun = [group_filter.begin(seen(pose, rng)) for pose in truth]
    if together:
        group = TrackGroup((Key(0.0, "0"),), begun[0])
        for number in (1, 2):
            group = group.joined(Key(0.0, str(number)), begun[number])
        begun = [group.state]
    states, found = begun, Squares([], [])
    for step in range(30):
        motion = NOISE.moved(Twist(0.6 if step % 20 < 10 else -0.6, 0.0, 0.5 if step % 14 < 7 else -0.5), 0.3)
        new = rng.multivariate_normal(np.zeros(3), motion.covariance)
        dx, dy, turn = motion.increment + motion.constants @ constants + new
        back = np.array([[math.cos(turn), math.sin(turn)], [-math.sin(turn), math.cos(turn)]])
        truth[:, :2] = (truth[:, :2] - [dx, dy]) @ back.T
        truth[:, 2] += 1e-3 * NOISE.floor_mm_per_sqrt_m * math.sqrt(motion.path) * rng.normal()
        truth[:, 3] = wrap_angle(truth[:, 3] - turn)
        before, states = states, group_filter.predict(states, motion)
        if not cross_terms:
            states = [without_cross_terms(group_filter, *pair, motion) for pair in zip(before, states, strict=True)]
        members = [member for state in states for member in members_of(state)]
        error = np.array([member.mean[POSE] for member in members]) - truth
        error[:, YAW] = wrap_angle(error[:, YAW])
        P = np.zeros((12, 12))
        for i, member in enumerate(members):
            P[4 * i : 4 * i + 4, 4 * i : 4 * i + 4] = member.covariance[POSE, POSE]
        if together:
            places = places_of(3)[:, POSE].ravel()
            P = states[0].covariance[np.ix_(places, places)]
        found.every.append(normalised(error.ravel(), P))
        pair = np.hstack([np.eye(4), -np.eye(4), np.zeros((4, 4))])
        found.between.append(normalised(pair @ error.ravel(), pair @ P @ pair.T))
        hits = [(member, Association(seen(pose, rng))) for member, pose in enumerate(truth)]
        if together:
            states = [group_filter.update(states[0], hits)]
        else:
            states = [group_filter.update(states[i], [(0, association)]) for i, association in hits]
    return found


def without_cross_terms(group_filter: GroupFilter, before: Gaussian, after: Gaussian, motion: Motion) -> Gaussian:
    """Return a prediction to which the turn's error adds nothing but to the yaw."""
    _, Q, _ = group_filter.transition(before.mean, motion)
    wrong = Q.copy()
    wrong[:2, YAW] = wrong[YAW, :2] = 0.0
    wrong[:2, :2] = motion.covariance[:2, :2]
    return Gaussian(after.mean, after.covariance - Q + wrong)


def means(runs: int, config: TrackerConfig = CONFIG, **options: bool) -> tuple[float, float]:
    """Return the means over all pallets, and of one against another; 1 where errors are as large as stated."""
    rng, group_filter = np.random.default_rng(4), GroupFilter(config)
    squares = [drive(rng, group_filter, **options) for _ in range(runs)]
    return tuple(float(np.mean([run[k] for run in squares])) for k in (0, 1))  # type: ignore[return-value]


@pytest.mark.parametrize("together", [True, False])
@pytest.mark.parametrize(("runs", "tolerance"), [(8, 0.2), pytest.param(60, 0.08, marks=pytest.mark.slow)])
def test_errors_are_as_large_as_they_are_said_to_be(runs: int, tolerance: float, together: bool) -> None:
    every, between = means(runs, together=together)
    if together:
        assert abs(every - 1) < tolerance
        assert abs(between - 1) < tolerance
    else:  # alone, they do not know that odometry moves them alike
        assert between < 0.85


@pytest.mark.parametrize(("runs", "tolerance"), [(8, 0.2), pytest.param(60, 0.08, marks=pytest.mark.slow)])
def test_so_they_are_where_the_odometrys_constants_are_only_allowed_for(runs: int, tolerance: float) -> None:
    every, _ = means(runs, replace(CONFIG, estimate_odometry=False))
    assert abs(every - 1) < tolerance


def test_without_the_cross_terms_of_the_turn_they_are_not() -> None:
    every, _ = means(8, together=False, cross_terms=False)
    assert every > 1.3
