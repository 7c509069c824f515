import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from palletloc.geometry import LevelPose
from tracking import Event, EventKind, PalletTracker, TrackerConfig
from tracking.config import LatencyConfig, MeasurementErrors
from tracking.latency import LatencyEstimate

PALLETS = (LevelPose(6.0, 2.0, 0.0, math.pi / 2), LevelPose(8.0, 2.0, 0.0, 1.5), LevelPose(9.0, 2.1, 1.5, 1.6))


def varying(time: float) -> tuple[float, float]:
    return 0.6 + 0.45 * math.sin(2 * math.pi * time / 6), 0.1 * math.sin(2 * math.pi * time / 9)


def constant(_: float) -> tuple[float, float]:
    return 0.6, 0.0


Inputs = list[tuple[float, Any]]


def inputs_of(drawn: Any, late: float = 0.05) -> Inputs:
    inputs = [(sample.time, sample) for sample in drawn.odometry]
    inputs += [(seen.time + late, seen) for seen in drawn.measurements]
    return sorted(inputs, key=lambda pair: pair[0])


def tracked(inputs: Inputs, latency: float = 0.0) -> tuple[PalletTracker, list[Event]]:
    tracker = PalletTracker(TrackerConfig(errors=MeasurementErrors(inflation=1.0, latency_s=latency)))
    events = [event for _, given in inputs for event in tracker.push(given)]
    return tracker, [event for event in events if event.kind is EventKind.LATENCY]


def found_in(tracker: PalletTracker) -> LatencyEstimate:
    found = tracker.latency()
    assert found.observable
    return found


@pytest.mark.parametrize("latency", [-0.08, 0.03, 0.2])
def test_latency_is_found_within_its_error_and_told(draw_drive: Callable[..., Any], latency: float) -> None:
    tracker, events = tracked(inputs_of(draw_drive(3, varying, PALLETS, 14.0, latency=latency)))
    found = found_in(tracker)
    assert abs(found.offset - latency) < 3.5 * found.sigma
    assert 0.001 < found.sigma < 0.008
    assert events
    assert ("later" if latency > 0 else "earlier") in events[-1].reason


def test_errors_are_as_large_as_sigma_says(draw_drive: Callable[..., Any]) -> None:
    """Chi-square of ten runs: outside of these bounds once in ten thousand."""
    ratios = []
    for seed in range(10):
        tracker, _ = tracked(inputs_of(draw_drive(100 + seed, varying, PALLETS[:1], 9.0, latency=0.04)))
        found = found_in(tracker)
        ratios.append((found.offset - 0.04) / found.sigma)
    assert 0.9 < np.sum(np.square(ratios)) < 35.6


def test_nothing_is_left_when_the_estimate_is_applied(draw_drive: Callable[..., Any]) -> None:
    inputs = inputs_of(draw_drive(5, varying, PALLETS, 14.0, latency=0.12))
    first = found_in(tracked(inputs)[0])
    tracker, events = tracked(inputs, first.offset)
    again = found_in(tracker)
    assert abs(again.offset) < 0.5 * again.sigma
    assert not events


@pytest.mark.parametrize("seed", range(3))
def test_constant_speed_tells_nothing(draw_drive: Callable[..., Any], seed: int) -> None:
    drawn = draw_drive(seed, constant, PALLETS, 13.0, latency=0.1)
    tracker, events = tracked(inputs_of(drawn))
    found = tracker.latency()
    assert not found.observable
    assert math.isnan(found.offset)
    assert not events


def test_no_latency_raises_no_event(draw_drive: Callable[..., Any]) -> None:
    tracker, events = tracked(inputs_of(draw_drive(7, varying, PALLETS, 14.0)))
    assert abs(found_in(tracker).offset) < 0.015
    assert not events


def test_any_order_inside_the_window_gives_the_same_estimate(draw_drive: Callable[..., Any]) -> None:
    drawn = draw_drive(9, varying, PALLETS[:2], 12.0, latency=0.05)
    inputs = inputs_of(drawn)
    rng = np.random.default_rng(1)
    moved = sorted(((time + rng.uniform(0, 0.8), given) for time, given in inputs), key=lambda pair: pair[0])
    moved.append((0.0, inputs[-1][1]))  # both end with the same newest time
    ends = [found_in(tracked(some)[0]) for some in (inputs, moved)]
    assert ends[0].offset == pytest.approx(ends[1].offset, abs=1e-6)
    assert ends[0].sigma == pytest.approx(ends[1].sigma, rel=1e-4)
    assert ends[0].shots == ends[1].shots


def test_before_any_input_nothing_is_told() -> None:
    assert not PalletTracker().latency().observable


def test_odometry_without_samples_around_the_shots_tells_nothing(draw_drive: Callable[..., Any]) -> None:
    """Between samples a second apart the speed is not known, so it must not be compared."""
    drawn = draw_drive(3, varying, PALLETS, 14.0, latency=0.1)
    thin = [(sample.time, sample) for sample in drawn.odometry[::50]]
    inputs = sorted(
        thin + [(measurement.time + 0.05, measurement) for measurement in drawn.measurements],
        key=lambda pair: pair[0],
    )
    assert not tracked(inputs)[0].latency().observable


def test_memory_stays_within_its_span(draw_drive: Callable[..., Any]) -> None:
    config = TrackerConfig(latency=LatencyConfig(span_s=4.0))
    tracker = PalletTracker(config)
    for _, given in inputs_of(draw_drive(3, varying, PALLETS, 12.0)):
        tracker.push(given)
    assert 10 <= tracker.latency().shots <= 17


def test_odometry_that_is_hardly_known_does_no_harm(draw_drive: Callable[..., Any]) -> None:
    drawn = draw_drive(3, varying, PALLETS[:1], 8.0)
    vague = [replace(sample, covariance=1e11 * np.eye(3)) for sample in drawn.odometry]
    inputs = sorted(
        [(each.time, each) for each in vague]
        + [(measurement.time + 0.05, measurement) for measurement in drawn.measurements],
        key=lambda pair: pair[0],
    )
    assert not tracked(inputs)[0].latency().observable
