import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from palletloc.geometry import LevelPose, wrap_angle
from palletloc.measurement import PalletMeasurement, YawSource
from tracking import EventKind, Odometry, PalletTracker, TrackerConfig
from tracking.config import GateConfig, MeasurementErrors
from tracking.gating import chi_square_limit, covariance_scale, huber_weight

GATE = GateConfig()
PALLET = LevelPose(6.0, 2.0, 0.0, math.pi / 2)
SETTLED = 20
AS_STATED = MeasurementErrors(wander_m=0.0, wander_yaw_deg=0.0)


@pytest.mark.parametrize("dof", [1, 2, 3, 4])
def test_the_gate_lets_its_part_of_measurements_pass_whatever_their_size(dof: int) -> None:
    squares = (np.random.default_rng(dof).normal(size=(200_000, dof)) ** 2).sum(axis=1)
    assert np.mean(squares <= chi_square_limit(0.99, dof)) == pytest.approx(0.99, abs=0.001)


def test_ordinary_measurements_count_in_full_and_far_ones_less() -> None:
    limit = chi_square_limit(GATE.robust_probability, 4)
    assert huber_weight(limit, 4, GATE) == 1.0
    weights = [huber_weight(limit * factor, 4, GATE) for factor in (1.01, 2.0, 4.0)]
    assert weights == sorted(weights, reverse=True)
    assert weights[-1] == pytest.approx(0.5)


def test_covariances_are_scaled_only_where_innovations_leave_their_band() -> None:
    count = GATE.adapt_over
    assert covariance_scale([4.0] * (GATE.adapt_from - 1), GATE) == 1.0
    assert covariance_scale([4.0] * GATE.adapt_from, GATE) == 4.0
    assert covariance_scale([0.01] * (count - 1), GATE) == 1.0
    assert covariance_scale([1.1] * count, GATE) == 1.0
    assert covariance_scale([4.0] * count, GATE) == 4.0
    assert covariance_scale([9.0] * 5 + [4.0] * count, GATE) == 4.0
    assert covariance_scale([100.0] * count, GATE) == GATE.max_scale
    assert covariance_scale([0.01] * count, GATE) == GATE.min_scale
    assert covariance_scale([4.0] * count, GateConfig(adapt_over=0)) == 1.0


def test_honest_innovations_are_rarely_scaled() -> None:
    rng = np.random.default_rng(0)
    ratios = (rng.normal(size=(2000, GATE.adapt_over, 4)) ** 2).mean(axis=2)
    scaled = np.mean([covariance_scale(row.tolist(), GATE) != 1.0 for row in ratios])
    assert scaled < 0.02


def past(time: float) -> tuple[float, float]:
    return 0.5 + 0.3 * math.sin(time), 0.05


@dataclass(frozen=True)
class Outcome:
    nees: float
    gated: float


def outcome(draw_drive: Callable[..., Any], factor: float, runs: int, gate: GateConfig = GATE) -> Outcome:
    """Return the mean NEES of settled tracks where true covariances are `factor` times the stated ones."""
    nees, gated = [], 0
    for seed in range(runs):
        drawn = draw_drive(200 + seed, past, [PALLET], 11.0, 0.2, factor=factor)
        tracker, number = PalletTracker(TrackerConfig(gate=gate, errors=AS_STATED)), 0
        inputs = [(sample.time, sample) for sample in drawn.odometry]
        inputs += [(seen.time + 0.03, seen) for seen in drawn.measurements]
        for _, given in sorted(inputs, key=lambda pair: pair[0]):
            events = tracker.push(given)
            if isinstance(given, Odometry):
                continue
            gated += sum(event.kind is EventKind.GATED for event in events)
            number += 1
            if number > SETTLED:
                for state in tracker.tracks(given.time):
                    error = state.pose.as_array() - drawn.truth[number - 1]
                    error[3] = wrap_angle(float(error[3]))
                    nees.append(error @ np.linalg.solve(state.covariance, error))
    return Outcome(float(np.mean(nees)), gated / runs)


def test_a_localizer_that_is_too_sure_of_itself_is_scaled(draw_drive: Callable[..., Any]) -> None:
    adapted = outcome(draw_drive, 4.0, 2)
    plain = outcome(draw_drive, 4.0, 2, GateConfig(adapt_over=0))
    assert adapted.nees < 0.7 * plain.nees
    assert adapted.gated < 0.5 * plain.gated


@pytest.mark.slow
def test_nees_over_fifty_runs(draw_drive: Callable[..., Any]) -> None:
    honest = outcome(draw_drive, 1.0, 50)
    plain = outcome(draw_drive, 1.0, 50, GateConfig(adapt_over=0))
    assert 3.2 < honest.nees < 4.8  # the mean of fifty correlated runs strays by 0.27
    assert abs(honest.nees - plain.nees) < 0.15
    assert outcome(draw_drive, 4.0, 50).nees < 6.0
    assert outcome(draw_drive, 0.25, 50).nees > 3.0


@pytest.mark.parametrize("inflation", [1.0, 1.4, 3.0])
def test_a_first_measurement_has_the_inflated_covariance(inflation: float) -> None:
    tracker = PalletTracker(TrackerConfig(errors=MeasurementErrors(inflation=inflation)))
    for time in (0.0, 0.1):
        tracker.push(Odometry(time, LevelPose(0.0, 0.0, 0.0, 0.0)))
    stated = np.diag([4e-5, 3e-5, 1e-5, 2e-5])
    there = LevelPose(2.0, 1.8, 0.0, 1.57)
    tracker.push(PalletMeasurement(0.1, "epal1-1200", there, stated, 0.9, YawSource.FACE))
    np.testing.assert_allclose(tracker.state(1).covariance, inflation * stated, rtol=1e-9, atol=1e-15)
