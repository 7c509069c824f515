import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from benchmarks.approaches import composed
from palletloc.geometry import LevelPose
from tracking import (
    Event,
    EventKind,
    Knowledge,
    Odometry,
    PalletTracker,
    PartialMeasurement,
    ShotTaken,
    Status,
    TrackerConfig,
    UnknownTrackError,
)
from tracking.config import GateConfig, MeasurementErrors

SiteMaker = Callable[..., Any]


def kinds(events: list[Event]) -> list[str]:
    return [str(event.kind) for event in events]


def followed(site: Any, until: float, numbers: tuple[int, ...] = (0,), start: float = 0.0) -> list[Any]:
    """Return odometry 20 times and shots 5 times a second."""
    inputs = [site.odometry(k / 20) for k in range(round(20 * start), round(20 * until) + 1)]
    for k in range(math.ceil(5 * start), math.floor(5 * until + 1e-6) + 1):
        inputs += [ShotTaken(k / 5), *(site.measured(number, k / 5) for number in numbers)]
    return sorted(inputs, key=lambda given: given.time)


def gone_by(tracker: PalletTracker, inputs: list[Any]) -> list[Event]:
    return [event for given in inputs for event in tracker.push(given)]


def test_a_track_is_born_confirmed_coasts_and_is_lost(make_site: SiteMaker) -> None:
    site, tracker = make_site(1), PalletTracker()
    events = gone_by(tracker, followed(site, 1.0))
    lives = [event for event in events if event.kind not in (EventKind.ACCEPTED,)]
    assert kinds(lives) == ["born", "confirmed"]
    assert [event.time for event in lives] == [0.0, pytest.approx(0.4)]
    assert tracker.state(1).status is Status.CONFIRMED
    events = gone_by(tracker, followed(site, 3.5, (), 1.05))
    assert "coasting" in kinds(events)
    assert tracker.state(1).status is Status.COASTING
    assert tracker.state(1).knowledge is Knowledge.COASTING
    events = gone_by(tracker, followed(site, 70.0, (), 3.55))
    lost = [event for event in events if event.kind is EventKind.LOST]
    assert [event.track for event in lost] == [1]
    assert lost[0].reason
    with pytest.raises(UnknownTrackError, match="now live: none"):
        tracker.state(1)


def test_a_single_false_detection_is_never_confirmed(make_site: SiteMaker, make_measurement: Any) -> None:
    site, tracker = make_site(2), PalletTracker()
    rng = np.random.default_rng(2)
    false = []
    for k in range(40):
        spot = LevelPose(1.0 + 2.0 * (k % 4), -3.0 - 2.0 * (k // 4 % 3), 0.0, float(rng.uniform(-3, 3)))
        false.append(make_measurement(k / 5, spot))
    inputs = sorted([*followed(site, 8.0), *false], key=lambda given: given.time)
    events = gone_by(tracker, inputs)
    assert {event.track for event in events if event.kind is EventKind.CONFIRMED} == {1}


def test_a_track_that_is_not_confirmed_ends_with_time_where_no_shots_come(make_site: SiteMaker) -> None:
    site, tracker = make_site(3), PalletTracker()
    tracker.push([site.odometry(0.0), site.measured(0, 0.0)])
    events = gone_by(tracker, [site.odometry(k / 20) for k in range(1, 120)])
    assert kinds(events)[-1] == "accepted"
    assert [event.time for event in events if event.kind is EventKind.LOST] == [pytest.approx(5.05)]


def test_a_pallet_that_was_hidden_for_30_s_is_found_under_its_number(make_site: SiteMaker) -> None:
    site, tracker = make_site(4), PalletTracker()
    site.twist = replace(site.twist, forward=0.1, turn=0.03)
    gone_by(tracker, followed(site, 3.0, (0, 1)))
    gone_by(tracker, followed(site, 33.0, (), 3.05))
    for number in (0, 1):
        state = tracker.state(number + 1)
        away = state.pose.as_array() - site.truth(number, state.time).as_array()
        assert np.linalg.norm(away[:3]) < 0.3
        assert state.status is Status.COASTING
        assert state.age == pytest.approx(30.0)
    events = gone_by(tracker, followed(site, 34.0, (0, 1), 33.05))
    assert {event.track for event in events if event.kind is EventKind.ACCEPTED} <= {None, 1, 2}
    assert not {"born", "lost", "reinitialized"} & set(kinds(events))
    assert [state.track for state in tracker.tracks()] == [1, 2]


def test_a_gap_of_odometry_of_2_s_is_bridged(make_site: SiteMaker) -> None:
    site, tracker = make_site(5), PalletTracker()
    inputs = [each for each in followed(site, 6.0) if not (2.0 < each.time < 4.1 and hasattr(each, "twist"))]
    events = gone_by(tracker, inputs)
    assert {"born", "lost"} & set(kinds(events)) == {"born"}
    assert "waiting" in kinds(events)
    state = tracker.state(1)
    assert state.status is Status.CONFIRMED
    assert np.linalg.norm((state.pose.as_array() - site.truth(0, state.time).as_array())[:3]) < 0.05


def test_a_pallet_that_was_moved_is_taken_up_again_after_consistent_rejects(make_site: SiteMaker) -> None:
    site, tracker = make_site(6), PalletTracker()
    gone_by(tracker, followed(site, 3.0))
    site.pallets[0] = replace(site.pallets[0], x=site.pallets[0].x + 0.3, yaw=site.pallets[0].yaw + 0.2)
    events = gone_by(tracker, followed(site, 4.0, (0,), 3.05))
    told = [event for event in events if event.kind in (EventKind.GATED, EventKind.REINITIALIZED)]
    assert kinds(told) == ["gated", "gated", "gated", "reinitialized"]
    assert told[0].distance is not None
    assert told[0].limit is not None
    assert told[0].distance > told[0].limit
    assert told[-1].track == 1
    state = tracker.state(1)
    assert state.status is Status.CONFIRMED
    assert np.linalg.norm((state.pose.as_array() - site.truth(0, state.time).as_array())[:3]) < 0.05
    assert len(tracker.tracks()) == 1


def test_rejects_that_contradict_each_other_do_not_move_a_track(make_site: SiteMaker) -> None:
    site, tracker = make_site(7), PalletTracker()
    gone_by(tracker, followed(site, 3.0))
    burst = [site.odometry(k / 20) for k in range(61, 90)]
    offs = [(0.3 * (-1) ** k, 0.25 * math.cos(2.1 * k), 0.0, 0.1 * k) for k in range(6)]
    burst += [site.measured(0, 3.2 + k / 5, off) for k, off in enumerate(offs)]
    events = gone_by(tracker, sorted(burst, key=lambda given: given.time))
    assert kinds(events).count("gated") == 6
    assert not {"reinitialized", "born", "lost"} & set(kinds(events))
    state = tracker.state(1)
    assert np.linalg.norm((state.pose.as_array() - site.truth(0, state.time).as_array())[:3]) < 0.05


def test_two_neighbours_never_swap_and_there_are_never_two_tracks_on_a_pallet(make_site: SiteMaker) -> None:
    for seed in range(4):
        site, tracker = make_site(seed), PalletTracker()
        rng = np.random.default_rng(seed)
        gone_by(tracker, followed(site, 0.6, (0, 1, 2)))
        owner = {}
        for state in tracker.tracks():
            aways = [np.linalg.norm(state.pose.as_array() - site.truth(n, state.time).as_array()) for n in range(3)]
            owner[state.track] = int(np.argmin(aways))
        for step in range(3, 30):
            seen = tuple(n for n in range(3) if rng.uniform() < 0.6)
            gone_by(tracker, followed(site, (step + 1) / 5, seen, step / 5 + 0.05))
            states = tracker.tracks()
            assert [state.track for state in states] == sorted(owner)
            for state in states:
                away = state.pose.as_array() - site.truth(owner[state.track], state.time).as_array()
                assert np.linalg.norm(away[:3]) < 0.15


def test_a_shot_with_the_same_pallet_twice_makes_no_second_track(make_site: SiteMaker) -> None:
    site, tracker = make_site(8), PalletTracker()
    inputs = followed(site, 2.0) + [site.measured(0, k / 5) for k in range(10)]
    events = gone_by(tracker, sorted(inputs, key=lambda given: given.time))
    assert kinds(events).count("born") == 1
    assert kinds(events).count("gated") >= 8


def test_an_uncertain_height_makes_no_second_track(make_site: SiteMaker, make_measurement: Any) -> None:
    site, tracker = make_site(9), PalletTracker()
    loose = np.diag([0.02, 0.02, 0.06, 0.01]) ** 2
    for k in range(20):
        off = 0.3 if k == 10 else 0.0
        truth = site.truth(0, k / 5)
        tracker.push([site.odometry(k / 5), make_measurement(k / 5, replace(truth, z=truth.z + off), loose)])
    assert len(tracker.tracks()) == 1


def test_another_model_in_the_place_of_a_track_takes_over_when_it_persists(
    make_site: SiteMaker, make_measurement: Any
) -> None:
    site, tracker = make_site(10), PalletTracker()
    gone_by(tracker, followed(site, 1.0))
    events = []
    for k in range(6, 10):
        one = make_measurement(k / 5, site.truth(0, k / 5), model="epal1-800")
        events += tracker.push([site.odometry(k / 5), one])
    assert kinds(events).count("reinitialized") == 1
    assert tracker.state(1).model == "epal1-800"


def test_of_two_tracks_that_run_into_each_other_the_better_one_stays(
    make_site: SiteMaker, make_measurement: Any
) -> None:
    site, tracker = make_site(11), PalletTracker()
    gone_by(tracker, followed(site, 1.0, (0,)))
    beside = replace(site.pallets[0], x=site.pallets[0].x + 1.12)
    site.pallets.append(beside)
    wide = np.diag([0.3, 0.05, 0.05, 0.05]) ** 2
    tracker.push([site.odometry(1.2), make_measurement(1.2, site.truth(3, 1.2), wide), site.measured(0, 1.2)])
    assert len(tracker.tracks()) == 2
    near = site.truth(3, 1.4)
    merged = tracker.push(
        [site.odometry(1.4), make_measurement(1.4, replace(near, x=near.x - 0.4), wide), site.measured(0, 1.4)]
    )
    lost = [event for event in merged if event.kind is EventKind.LOST]
    assert [event.reason for event in lost] == ["another track is in its place"] or len(tracker.tracks()) == 1


def test_where_a_pallet_was_is_and_will_be(make_site: SiteMaker) -> None:
    site, tracker = make_site(12), PalletTracker()
    gone_by(tracker, followed(site, 3.0, (0,)))
    expected = {2.0: "exact", 2.13: "interpolated", 3.0: "exact", 3.3: "extrapolated"}
    for time, knowledge in expected.items():
        state = tracker.state(1, time)
        assert (str(state.knowledge), state.time) == (knowledge, time)
        np.testing.assert_allclose(state.pose.as_array(), site.truth(0, time).as_array(), atol=0.03)
    spread = [np.trace(tracker.state(1, time).covariance) for time in (3.0, 3.3, 5.0)]
    assert spread == sorted(spread)
    with pytest.raises(UnknownTrackError, match=r"expected a time from"):
        tracker.state(1, 0.1)
    with pytest.raises(UnknownTrackError, match="finite"):
        tracker.tracks(math.nan)
    with pytest.raises(UnknownTrackError, match="track 7"):
        tracker.state(7)
    assert tracker.tracks(1e12) == ()
    assert tracker.tracks(1e300) == ()


def test_before_any_input_there_is_nothing() -> None:
    tracker = PalletTracker()
    assert tracker.newest is None
    assert tracker.tracks() == ()
    assert tracker.push([]) == []
    with pytest.raises(UnknownTrackError, match="track 1"):
        tracker.state(1)


def test_a_part_of_a_pose_helps_the_track_that_it_is_near(make_site: SiteMaker) -> None:
    site, tracker = make_site(13), PalletTracker()
    gone_by(tracker, followed(site, 1.0, (0, 1)))
    sharp, near = np.array([[1e-6]]), site.truth(1, 1.2)
    number = min(tracker.tracks(1.2), key=lambda each: math.dist((each.pose.x, each.pose.y), (near.x, near.y))).track
    before = tracker.state(number, 1.2)
    yaw = PartialMeasurement(1.2, before.model, ("yaw",), np.array([near.yaw]), sharp, near)
    tracker.push([site.odometry(1.2), yaw])
    after = tracker.state(number, 1.2)
    assert after.covariance[3, 3] < before.covariance[3, 3]
    assert after.hits == before.hits + 1
    events = tracker.push(replace(yaw, near=LevelPose(-5.0, 0.0, 0.0, 0.0), values=np.array([near.yaw + 1e-3])))
    assert kinds(events) == ["gated"]
    assert "no track" in events[0].reason
    far = replace(yaw, values=np.array([near.yaw + 0.5]))
    gated = [event for event in tracker.push(far) if event.kind is EventKind.GATED]
    assert gated[0].track == number


def test_a_part_of_a_pose_begins_no_track_and_neither_does_a_vague_one(
    make_site: SiteMaker, make_measurement: Any
) -> None:
    site, tracker = make_site(14), PalletTracker()
    tracker.push(site.odometry(0.0))
    assert kinds(tracker.push(site.partly(0, 0.0))) == ["gated"]
    vague = make_measurement(0.0, site.truth(0, 0.0), np.diag([1.0, 1.0, 0.01, 0.01]))
    (event,) = tracker.push(vague)
    assert event.kind is EventKind.GATED
    assert "too uncertain" in event.reason
    assert tracker.tracks() == ()


def test_covariances_that_are_too_small_are_scaled_where_that_is_asked_for(make_site: SiteMaker) -> None:
    def nees(gate: GateConfig) -> float:
        site, tracker = (
            make_site(15),
            PalletTracker(TrackerConfig(gate=gate, errors=MeasurementErrors(0.0, 0.0, inflation=1.0))),
        )
        found = []
        for k in range(60):
            one = site.measured(0, k / 5)
            tracker.push([site.odometry(k / 5), replace(one, covariance=one.covariance / 4)])
            if k > 20:
                state = tracker.state(1)
                away = state.pose.as_array() - site.truth(0, state.time).as_array()
                found.append(float(away @ np.linalg.solve(state.covariance, away)))
        return float(np.mean(found))

    assert nees(GateConfig()) < 0.6 * nees(GateConfig(adapt_over=0))


def test_a_hidden_pallet_is_carried_along_with_those_that_are_seen(make_site: SiteMaker) -> None:
    """The wheels slip by four centimetres in half a metre, once the third pallet is hidden."""

    def off(together: int) -> tuple[float, float, float]:
        site, tracker = make_site(7), PalletTracker(TrackerConfig(tracks_together=together))
        for k in range(40):
            time = k / 10
            slipped = composed(site.forklift(time), (0.04, 0.0, 0.0)) if time > 2.5 else site.forklift(time)
            tracker.push(Odometry(time, slipped))
            tracker.push([site.measured(n, time) for n in range(2 if time > 2.0 else 3)])
        state = next(state for state in tracker.tracks(3.9) if state.pose.z > 1.0)
        wrong = state.pose.as_array() - site.truth(2, 3.9).as_array()
        return (
            float(np.hypot(*wrong[:2])),
            float(np.trace(state.covariance[:2, :2])),
            float(wrong @ np.linalg.solve(state.covariance, wrong)),
        )

    alone, mended = off(1), off(5)
    assert alone[0] > 0.03
    assert mended[0] < 0.6 * alone[0]
    assert mended[1] < alone[1]
    assert mended[2] < alone[2]
