import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import pairwise

import numpy as np
import pytest
from scipy.stats import chi2

from palletloc.geometry import FloatArray, LevelPose, level_pose, wrap_angle
from palletloc.measurement import PalletMeasurement, YawSource
from tracking.config import GateConfig, MeasurementErrors, TrackerConfig, WindowConfig
from tracking.filter import GroupFilter, model_of
from tracking.gating import Association
from tracking.motion import Motion, Twist
from tracking.observation import Observation, ShotTaken, observe
from tracking.odometry import Odometry, OdometryNoise
from tracking.smoother import SmoothedMoment, smoothed, smoothed_groups
from tracking.state import POSE, Gaussian, Key, TrackGroup
from tracking.tracker import Input, PalletTracker

NOISE = OdometryNoise(wheel_scale_percent=2.0, gyro_bias_deg_s=0.3)
ALONE = MeasurementErrors(common_position_m=0.0, common_yaw_deg=0.0, wander_m=0.0, wander_yaw_deg=0.0)
HONEST = TrackerConfig(
    odometry=NOISE, errors=ALONE, gate=GateConfig(probability=1 - 1e-6, robust_probability=1 - 1e-6, adapt_over=0)
)
"""Believes what the simulated approaches do, outliers apart: they have none."""
PALLET = LevelPose(5.5, 2.2, 0.3, 1.5)
SIGMA = np.array([0.012, 0.012, 0.006, math.radians(0.6)])
STEP, EVERY, SHOTS = 0.05, 6, 24


@dataclass(frozen=True)
class Approach:
    """A simulated approach: what the tracker gets, and where the pallet truly was."""

    inputs: list[list[Input]]
    truth: dict[float, FloatArray]


def approach(seed: int) -> Approach:
    """Drive along a curve past a pallet with the odometry's errors drawn from `NOISE`."""
    random = np.random.default_rng(seed)
    scale, bias = random.normal(size=2) * NOISE.constants
    true, odometry = LevelPose(0.0, 0.0, 0.0, 0.0), LevelPose(0.0, 0.0, 0.0, 0.0)
    inputs: list[list[Input]] = []
    truth = {}
    for number in range((SHOTS - 1) * EVERY + 1):
        time = number * STEP
        if number:
            twist = Twist(0.6, 0.0, 0.25 * math.sin(time))
            motion = NOISE.moved(twist, STEP)
            error = random.multivariate_normal(np.zeros(3), motion.covariance)
            true = moved(true, motion.increment + motion.constants @ [scale, bias] + error)
            odometry = moved(odometry, motion.increment)
        inputs.append([Odometry(time, odometry)])
        if number % EVERY == 0:
            there = level_pose(true.transform().inv() * PALLET.transform()).as_array()
            truth[time] = there
            inputs.append([ShotTaken(time), measured(time, there + random.normal(size=4) * SIGMA)])
    return Approach(inputs, truth)


def moved(pose: LevelPose, increment: FloatArray) -> LevelPose:
    x, y, turn = increment
    return level_pose(pose.transform() * LevelPose(x, y, 0.0, turn).transform())


def measured(time: float, values: FloatArray) -> PalletMeasurement:
    pose = LevelPose(*(float(value) for value in values))
    return PalletMeasurement(time, "t11", pose, np.diag(SIGMA**2), 0.9, YawSource.FACE)


def followed(one: Approach, config: TrackerConfig = HONEST) -> PalletTracker:
    tracker = PalletTracker(config, keep_history=True)
    for given in one.inputs:
        tracker.push(given)
    return tracker


def errors(state: Gaussian, true: FloatArray) -> FloatArray:
    away = state.mean[POSE] - true
    away[3] = wrap_angle(float(away[3]))
    return np.asarray(away)


def nees(state: Gaussian, true: FloatArray) -> float:
    away = errors(state, true)
    return float(away @ np.linalg.solve(state.covariance[POSE, POSE], away))


def chain_of(tracker: PalletTracker) -> dict[float, TrackGroup]:
    return {moment.time: group for moment in tracker.history() for group in moment.groups}


def smoothed_chain(chain: Sequence[TrackGroup]) -> list[Gaussian]:
    return [state for (state,) in smoothed_groups([[group] for group in chain])]


def without_odometry(chain: Sequence[TrackGroup]) -> list[TrackGroup]:
    """Return a track as a smoother for motions without input has it: expected is F times the state before."""
    blind = [chain[0]]
    for before, group in pairwise(chain):
        assert group.predicted is not None
        expected = Gaussian(group.predicted.F @ before.state.mean, group.predicted.state.covariance)
        blind.append(replace(group, predicted=replace(group.predicted, state=expected)))
    return blind


@cache
def run_of(seed: int) -> Approach:
    return approach(seed)


@cache
def chain_of_run(seed: int) -> dict[float, TrackGroup]:
    return chain_of(followed(run_of(seed)))


def rms(all_errors: Sequence[FloatArray]) -> FloatArray:
    return np.asarray(np.sqrt(np.mean(np.square(all_errors), axis=0)))


def test_the_smoother_beats_the_filter_and_one_without_odometry_fails() -> None:
    of_filter, of_smoother, of_blind = [], [], []
    for seed in range(8):
        chain, run = chain_of_run(seed), run_of(seed)
        tracks = list(chain.values())
        smooth, blind = smoothed_chain(tracks), smoothed_chain(without_odometry(tracks))
        for i, time in enumerate(chain):
            of_filter.append(errors(tracks[i].state, run.truth[time]))
            of_smoother.append(errors(smooth[i], run.truth[time]))
            of_blind.append(errors(blind[i], run.truth[time]))
    assert (rms(of_smoother) < 0.85 * rms(of_filter)).all()
    assert (rms(of_blind)[:2] > 10 * rms(of_smoother)[:2]).all()


@pytest.mark.parametrize("step", [0, SHOTS // 2, SHOTS - 1])
@pytest.mark.parametrize("runs", [8, pytest.param(60, marks=pytest.mark.slow)])
def test_the_smoothers_covariance_is_honest(step: int, runs: int) -> None:
    """The sum of n squared normalised errors of four degrees of freedom is a chi-square variable of 4 n."""
    values = []
    for seed in range(runs):
        chain = chain_of_run(seed)
        time = list(chain)[step]
        values.append(nees(smoothed_chain(list(chain.values()))[step], run_of(seed).truth[time]))
    low, high = (float(chi2.ppf(p, 4 * len(values))) / len(values) for p in (0.0005, 0.9995))
    assert low < np.mean(values) < high


def test_more_is_known_than_the_filter_knew_and_at_the_end_the_same() -> None:
    chain = list(chain_of_run(0).values())
    smooth = smoothed_chain(chain)
    for track, state in zip(chain, smooth, strict=True):
        gained = track.state.covariance - state.covariance
        assert np.linalg.eigvalsh(gained[POSE, POSE])[0] > -1e-12
        assert np.linalg.eigvalsh(state.covariance)[0] > -1e-12
    assert smooth[-1] is chain[-1].state


def test_what_odometry_gets_wrong_is_known_from_the_begin() -> None:
    """The wheels' scale is one constant: the smoother has its final estimate at every step."""
    smooth = smoothed_chain(list(chain_of_run(1).values()))
    assert [state.mean[4] for state in smooth] == pytest.approx([smooth[-1].mean[4]] * len(smooth), abs=1e-9)


def straight(config: TrackerConfig, count: int = 8) -> tuple[list[TrackGroup], list[Motion], list[Observation]]:
    """Filter a way without turns, whose equations are linear."""
    random, group_filter = np.random.default_rng(5), GroupFilter(config)
    chain: list[TrackGroup] = []
    motions: list[Motion] = []
    observations: list[Observation] = []
    for step in range(count):
        values = PALLET.as_array() - [0.3 * step, 0.0, 0.0, 0.0] + random.normal(size=4) * SIGMA
        (ready,) = observe([measured(0.5 * step, values)], config.errors)
        assert isinstance(ready, Observation)
        observations.append(ready)
        if not chain:
            chain.append(TrackGroup((Key(0.0, ""),), group_filter.begin(observations[0])))
        else:
            motions.append(config.odometry.moved(Twist(0.6, 0.0, 0.0), 0.5))
            (predicted,) = group_filter.predict_groups([chain[-1]], motions[-1])
            chain.append(group_filter.update_group(predicted, [(0, Association(observations[-1]))]))
    return chain, motions, observations


STRAIGHT = OdometryNoise(
    gyro_bias_deg_s=0.0, gyro_random_walk_deg_per_sqrt_s=0.0, turn_deg_per_sqrt_turn=0.0, wheel_scale_percent=3.0
)


@pytest.mark.parametrize("errors_alike", [ALONE, MeasurementErrors(inflation=1.0)], ids=["independent", "shared"])
def test_on_a_linear_way_it_is_the_least_squares_solution(errors_alike: MeasurementErrors) -> None:
    """All states together, conditioned on all measurements at once; a gyroscope without bias makes it singular."""
    config = replace(HONEST, odometry=STRAIGHT, errors=errors_alike)
    chain, motions, observations = straight(config)
    group_filter, size, count = GroupFilter(config), 10, len(chain)
    mean = np.zeros((count, size))
    covariance = np.zeros((count, size, count, size))
    mean[0], covariance[0, :, 0] = group_filter.begin(observations[0])
    for k, motion in enumerate(motions):
        F, Q, mean[k + 1] = group_filter.transition(mean[k], motion)
        for j in range(k + 1):
            covariance[k + 1, :, j] = F @ covariance[k, :, j]
            covariance[j, :, k + 1] = covariance[k + 1, :, j].T
        covariance[k + 1, :, k + 1] = F @ covariance[k, :, k] @ F.T + Q
    models = [model_of(observation) for observation in observations[1:]]
    H = np.zeros((4 * len(models), count * size))
    R = np.zeros((4 * len(models), 4 * len(models)))
    for k, (rows, noise) in enumerate(models):
        H[4 * k : 4 * k + 4, size * (k + 1) : size * (k + 2)] = rows
        R[4 * k : 4 * k + 4, 4 * k : 4 * k + 4] = noise
    joint = covariance.reshape(count * size, count * size)
    gain = np.linalg.solve(H @ joint @ H.T + R, H @ joint).T
    away = np.concatenate([observation.values for observation in observations[1:]]) - H @ mean.ravel()
    best = (mean.ravel() + gain @ away).reshape(count, size)
    left = (joint - gain @ H @ joint).reshape(count, size, count, size)
    for k, state in enumerate(smoothed_chain(chain)):
        assert state.mean == pytest.approx(best[k], abs=1e-9)
        assert state.covariance == pytest.approx(left[k, :, k], abs=1e-10)


def test_a_perfect_odometry_makes_one_pallet_of_all_shots() -> None:
    """Nothing is uncertain but the measurements: every step gets the mean of all, carried there."""
    perfect = OdometryNoise(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    chain, _, observations = straight(replace(HONEST, odometry=perfect))
    start = np.mean([one.values + np.array([0.3 * k, 0, 0, 0]) for k, one in enumerate(observations)], axis=0)
    for k, state in enumerate(smoothed_chain(chain)):
        assert state.mean[POSE] == pytest.approx(start - [0.3 * k, 0, 0, 0], abs=1e-9)
        assert state.covariance[POSE, POSE] == pytest.approx(np.diag(SIGMA**2) / len(chain), abs=1e-12)


def test_nothing_is_carried_back_over_a_break() -> None:
    chain, _, _ = straight(HONEST)
    broken = [*chain[:4], replace(chain[4], predicted=None, carried=()), *chain[5:]]
    states, alone = smoothed_chain(broken), [*smoothed_chain(chain[:4]), *smoothed_chain(broken[4:])]
    for state, expected in zip(states, alone, strict=True):
        assert (state.mean == expected.mean).all()
        assert (state.covariance == expected.covariance).all()
    assert abs(states[3].mean[0] - smoothed_chain(chain)[3].mean[0]) > 1e-6


def turned(by: float) -> list[TrackGroup]:
    """Return a run's track with another heading of the pallet."""

    def rotated(one: Input) -> Input:
        if not isinstance(one, PalletMeasurement):
            return one
        pose = one.forklift_from_pallet
        return replace(one, forklift_from_pallet=replace(pose, yaw=wrap_angle(pose.yaw + by)))

    tracker = PalletTracker(HONEST, keep_history=True)
    for given in run_of(2).inputs:
        tracker.push([rotated(each) for each in given])
    return list(chain_of(tracker).values())


@pytest.mark.parametrize("step", [3, 11, 19])
def test_a_yaw_may_pass_through_half_a_turn(step: int) -> None:
    """With another heading the same errors come out, also where the cut lies between two states of one step."""
    tracks = turned(0.0)
    plain, predicted = smoothed_chain(tracks), tracks[step].predicted
    assert predicted is not None
    by = math.pi - float(plain[step].mean[3] + predicted.state.mean[3]) / 2
    over = smoothed_chain(turned(by))
    assert len({np.sign(state.mean[3]) for state in over}) == 2
    for one, other in zip(plain, over, strict=True):
        assert -math.pi <= other.mean[3] < math.pi
        assert abs(wrap_angle(float(other.mean[3] - one.mean[3] - by))) < 1e-9
        assert other.mean[:3] == pytest.approx(one.mean[:3], abs=1e-9)


@pytest.mark.parametrize("window", [0.2, 20.0])
def test_the_window_does_not_matter_even_where_nothing_is_seen_for_longer(window: float) -> None:
    """Where no shot comes, the tracker carries its tracks on; the smoother goes back through that, too."""
    gap = [given for given in run_of(4).inputs if not (isinstance(given[0], ShotTaken) and 1.9 < given[0].time < 5.5)]
    tracker = followed(Approach(gap, {}), replace(HONEST, window=WindowConfig(window_s=window)))
    other = followed(Approach(gap, {}))
    shots = {given[0].time for given in gap if isinstance(given[0], ShotTaken)}
    states = [
        all_of([moment for moment in smoothed(each.history()) if moment.time in shots]) for each in (tracker, other)
    ]
    assert len(states[0]) == len(shots) == 12
    # a way in pieces has other linearisation points: micrometres; a step too many moves millimetres
    assert states[0] == pytest.approx(states[1], abs=5e-5)


def all_of(moments: Sequence[SmoothedMoment]) -> FloatArray:
    return np.array([state.state.mean for moment in moments for state in moment.states])


def test_late_shots_lead_to_the_same_history() -> None:
    shots = [given for given in run_of(3).inputs if isinstance(given[0], ShotTaken)]
    late = sorted(
        run_of(3).inputs, key=lambda given: given[0].time + (1.3 if any(given is shot for shot in shots) else 0.0)
    )
    assert late != run_of(3).inputs
    in_order = smoothed(followed(run_of(3)).history())
    delayed = smoothed(followed(Approach(late, {})).history())
    times = {moment.time for moment in in_order}
    shared = [moment for moment in delayed if moment.time in times]
    assert [moment.time for moment in shared] == [moment.time for moment in in_order]
    assert all_of(shared) == pytest.approx(all_of(in_order), abs=1e-8)


def test_a_history_is_kept_over_more_than_the_window_and_only_where_asked() -> None:
    tracker = followed(run_of(0))
    assert {moment.time for moment in tracker.history()} >= run_of(0).truth.keys()
    with pytest.raises(ValueError, match="keep_history"):
        PalletTracker().history()
