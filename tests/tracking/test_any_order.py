from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tracking import PalletTracker, TrackerConfig
from tracking.tracker import Input

SEEDS = st.integers(0, 2**32 - 1)
FEW = settings(max_examples=4, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
MANY = settings(FEW, max_examples=60)


def pushed(inputs: Sequence[Input], batch: int = 1, together: int = 5) -> PalletTracker:
    tracker = PalletTracker(TrackerConfig(tracks_together=together))
    for start in range(0, len(inputs), batch):
        tracker.push(inputs[start : start + batch])
    return tracker


def any_order(make_site: Callable[..., Any], same_states: Callable[..., None], seed: int, together: int = 5) -> None:
    site = make_site(seed)
    inputs = site.stream(4.0)
    times = [3.0, 3.62, inputs[-1].time, 4.1, 4.4]
    in_order, late = (pushed(ones, together=together) for ones in (inputs, site.late(inputs)))
    same_states(in_order, late, times)


@FEW
@given(SEEDS)
def test_any_order_of_arrival_inside_the_window_gives_the_same_states(
    make_site: Callable[..., Any], same_states: Callable[..., None], seed: int
) -> None:
    any_order(make_site, same_states, seed)


@pytest.mark.parametrize("together", [1, 2])
def test_so_it_does_where_few_tracks_share_an_estimate(
    make_site: Callable[..., Any], same_states: Callable[..., None], together: int
) -> None:
    any_order(make_site, same_states, together, together)


@pytest.mark.slow
@MANY
@given(SEEDS)
def test_any_order_of_arrival_gives_the_same_states_in_many_streams(
    make_site: Callable[..., Any], same_states: Callable[..., None], seed: int
) -> None:
    any_order(make_site, same_states, seed)


@FEW
@given(SEEDS, st.integers(2, 60))
def test_inputs_that_come_together_are_worth_as_much_as_one_by_one(
    make_site: Callable[..., Any], same_states: Callable[..., None], seed: int, batch: int
) -> None:
    inputs = make_site(seed).stream(4.0)
    same_states(pushed(inputs), pushed(inputs, batch), [3.0, 4.0])


@FEW
@given(SEEDS)
def test_the_inputs_of_a_stream_without_shots_for_seconds_may_come_in_any_order(
    make_site: Callable[..., Any], same_states: Callable[..., None], seed: int
) -> None:
    site = make_site(seed)
    odometry = [site.odometry(k / 20) for k in range(200)]
    shots = [site.measured(number, time) for time in (0.3, 0.5, 0.7, 0.91, 9.0) for number in range(3)]
    inputs = sorted([*odometry, *shots], key=lambda given: given.time)
    one, other = pushed(inputs), pushed(site.late(inputs))
    same_states(one, other, [9.0, 9.95, 10.2])
    assert len(one.tracks()) == 3


@FEW
@given(SEEDS)
def test_what_became_of_every_measurement_does_not_depend_on_the_order_either(
    make_site: Callable[..., Any], seed: int
) -> None:
    site = make_site(seed)
    inputs = site.stream(1.8)

    def told(order: Sequence[Input]) -> list[tuple[float, str, float | None]]:
        window = pushed(order)._window  # what was told at first may have been revised
        return [
            (shot.time, str(disposition.kind), disposition.distance and round(disposition.distance, 6))
            for shot, belief in zip(window.shots, window.beliefs, strict=True)
            for disposition in belief.dispositions
        ]

    assert told(inputs) == told(site.late(inputs))


def test_a_number_stays_when_a_late_measurement_turns_out_to_be_the_first(make_site: Callable[..., Any]) -> None:
    site = make_site(1)
    tracker = PalletTracker()
    tracker.push([site.odometry(k / 20) for k in range(20)])
    tracker.push([site.measured(0, 0.5), site.measured(1, 0.5)])
    before = {state.track: state.pose for state in tracker.tracks()}
    tracker.push(site.measured(1, 0.2))
    tracker.push(site.measured(0, 0.1))
    after = {state.track: state.pose for state in tracker.tracks()}
    assert before.keys() == after.keys() == {1, 2}
    for number, pose in before.items():
        assert np.linalg.norm(pose.as_array() - after[number].as_array()) < 0.1


def test_the_same_inputs_give_the_same_events_and_states_to_the_last_bit(make_site: Callable[..., Any]) -> None:
    inputs = make_site(5).late(make_site(5).stream(4.0))
    one, other = PalletTracker(), PalletTracker()
    for given_input in inputs:
        assert repr(one.push(given_input)) == repr(other.push(given_input))
    for a, b in zip(one.tracks(), other.tracks(), strict=True):
        assert a.pose == b.pose
        np.testing.assert_array_equal(a.covariance, b.covariance)
