import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from palletloc.geometry import LevelPose
from palletloc.measurement import PalletMeasurement, YawSource
from tests.tracking.unchecked import unchecked
from tracking import EventKind, Odometry, PalletTracker, PartialMeasurement, ShotTaken, Twist, UnknownTrackError
from tracking.observation import COMPONENTS
from tracking.tracker import Input
from tracking.validation import BadInputError

FEW = settings(
    max_examples=20, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow]
)
MANY = settings(FEW, max_examples=1000)
ODD = st.sampled_from([0.0, -0.0, math.nan, math.inf, -math.inf, 1e300, -1e300, 1e-300, 1e6, 1e5, 1e3])
TIMES = st.floats(0.0, 6.0) | st.integers(0, 30).map(lambda k: k / 5) | st.floats(-100.0, 1e5) | ODD
NUMBERS = st.floats(-5.0, 5.0) | ODD
POSES = st.builds(LevelPose, NUMBERS, NUMBERS, st.floats(0.0, 2.0) | ODD, NUMBERS) | st.builds(
    LevelPose, st.floats(2.9, 3.1), st.floats(1.9, 2.1), st.floats(0.0, 0.1), st.floats(1.4, 1.6)
)
TWISTS = st.builds(Twist, NUMBERS, NUMBERS, NUMBERS)
MODELS = st.sampled_from(["epal1-1200", "epal1-800", "unknown"])


@st.composite
def covariances(draw: st.DrawFn, size: int) -> np.ndarray:
    kind = draw(st.sampled_from(["sound", "sound", "sound", "scaled", "any"]))
    if kind == "any":
        return np.array(draw(st.lists(NUMBERS, min_size=size * size, max_size=size * size))).reshape(size, size)
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    root = rng.normal(size=(size, size)) + np.eye(size)
    low, high = (-3.0, -1.0) if kind == "sound" else (-7.0, 4.0)
    scale = 10.0 ** rng.uniform(low, high, size)
    return np.asarray(scale[:, None] * (root @ root.T) * scale)


@st.composite
def partials(draw: st.DrawFn) -> PartialMeasurement:
    names = tuple(name for name in COMPONENTS if draw(st.booleans()))
    values = np.array(draw(st.lists(NUMBERS, min_size=len(names), max_size=len(names))))
    covariance = draw(covariances(max(len(names), 1)))
    return PartialMeasurement(draw(TIMES), draw(MODELS), names, values, covariance, draw(st.none() | POSES))


def wholes(time: float, model: str, pose: LevelPose, covariance: np.ndarray) -> PalletMeasurement:
    sound = PalletMeasurement(time, model, pose, np.eye(4), 0.5, YawSource.TOP)
    return unchecked(sound, covariance=covariance)


INPUTS = st.one_of(
    st.builds(Odometry, TIMES, st.none() | POSES, st.none() | TWISTS, st.none() | covariances(3)),
    st.builds(
        Odometry, TIMES, st.builds(LevelPose, st.floats(-1, 1), st.floats(-1, 1), st.just(0.0), st.floats(-1, 1))
    ),
    st.builds(wholes, TIMES, MODELS, POSES, covariances(4)),
    st.builds(wholes, TIMES, MODELS, POSES, covariances(4)),
    partials(),
    st.builds(ShotTaken, TIMES),
)
STREAMS = st.lists(INPUTS | st.lists(INPUTS, max_size=6), max_size=40)


def nothing_breaks(
    make_site: Callable[..., Any], is_sound: Callable[[PalletTracker], None], stream: Sequence[Input | list[Input]]
) -> None:
    tracker = PalletTracker()
    for pushed in stream:
        for event in tracker.push(pushed):
            assert isinstance(event.kind, EventKind)
        is_sound(tracker)
        for time in (0.0, 3.0, 1e4, math.nan):
            try:
                tracker.tracks(time)
            except UnknownTrackError:
                continue
    site = make_site(1)
    begin = 0.0 if tracker.newest is None else min(tracker.newest, 1e6) + 1e3
    follow(tracker, site, begin)
    near = [state for state in tracker.tracks() if math.hypot(state.pose.x - 3.0, state.pose.y - 2.0) < 3.0]
    assert len(near) == 2
    is_sound(tracker)


def follow(tracker: PalletTracker, site: Any, begin: float) -> None:
    """Drive on after all that."""
    for k in range(100):
        time = begin + k / 20
        site_time = k / 20
        tracker.push(Odometry(time, site.forklift(site_time)))
        if k % 4 == 0:
            for number in range(2):
                seen = site.measured(number, site_time)
                tracker.push(wholes(time, seen.model, seen.forklift_from_pallet, seen.covariance))


@FEW
@given(STREAMS)
def test_whatever_comes_nothing_breaks(
    make_site: Callable[..., Any], is_sound: Callable[[PalletTracker], None], stream: Sequence[Input | list[Input]]
) -> None:
    nothing_breaks(make_site, is_sound, stream)


@pytest.mark.slow
@MANY
@given(STREAMS)
def test_whatever_comes_a_thousand_times_nothing_breaks(
    make_site: Callable[..., Any], is_sound: Callable[[PalletTracker], None], stream: Sequence[Input | list[Input]]
) -> None:
    nothing_breaks(make_site, is_sound, stream)


def test_a_fault_of_the_input_is_one_line() -> None:
    assert "\n" not in str(BadInputError("pose", 1.0, "expected another one"))
