from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from palletloc.geometry import LevelPose, wrap_angle
from tracking import EventKind, Odometry, PalletTracker, TrackerConfig
from tracking.config import GateConfig, MeasurementErrors
from tracking.gating import covariance_scale

CONFIG = GateConfig()
PALLET = LevelPose(6.0, 2.0, 0.0, math.pi / 2)
SETTLED = 20
AS_STATED = MeasurementErrors(wander_m=0.0, wander_yaw_deg=0.0)


def test_honest_innovations_change_nothing() -> None:
    rng = np.random.default_rng(2)
    scales = [covariance_scale((rng.chisquare(4, 12) / 4).tolist(), CONFIG) for _ in range(2000)]
    assert np.mean(np.not_equal(scales, 1.0)) < 0.02


def test_large_innovations_are_believed_from_the_third_on() -> None:
    assert covariance_scale([4.0] * 2, CONFIG) == 1.0
    assert covariance_scale([4.0] * 3, CONFIG) == 4.0


def test_small_innovations_are_believed_when_the_window_is_full() -> None:
    assert covariance_scale([0.1] * (CONFIG.adapt_over - 1), CONFIG) == 1.0
    assert covariance_scale([0.1] * CONFIG.adapt_over, CONFIG) == CONFIG.min_scale


def test_the_factor_is_bounded_and_forgets_what_is_older_than_the_window() -> None:
    assert covariance_scale([1e6] * 12, CONFIG) == CONFIG.max_scale
    assert covariance_scale([1e6, *[1.0] * CONFIG.adapt_over], CONFIG) == 1.0


def test_a_window_of_none_takes_covariances_as_they_are() -> None:
    assert covariance_scale([50.0] * 20, GateConfig(adapt_over=0)) == 1.0


def past(time: float) -> tuple[float, float]:
    return 0.5 + 0.3 * math.sin(time), 0.05


@dataclass(frozen=True)
class Outcome:
    nees: float
    gated: float


def outcome(draw_drive: Callable[..., Any], factor: float, runs: int, gate: GateConfig = CONFIG) -> Outcome:
    """Return the mean NEES of settled tracks where true covariances are `factor` times the stated ones."""
    nees, gated = [], 0
    for seed in range(runs):
        drawn = draw_drive(200 + seed, past, [PALLET], 11.0, 0.2, factor=factor)
        tracker, number = PalletTracker(TrackerConfig(gate=gate, errors=AS_STATED)), 0
        inputs = [(sample.time, sample) for sample in drawn.odometry]
        inputs += [(seen.time + 0.03, seen) for seen in drawn.measurements]
        for _, given in sorted(inputs, key=lambda one: one[0]):
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
