import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from palletloc.geometry import LevelPose
from palletloc.pallet_library import load_library
from tests.tracking.unchecked import unchecked
from tracking import Event, EventKind, Odometry, PalletTracker, PartialMeasurement, ShotTaken, Twist
from tracking.tracker import Input

SiteMaker = Callable[..., Any]
DAY = 86400.0
POSE = LevelPose(3.0, 2.0, 0.1, 1.5)
EYE = 1e-4 * np.eye(4)


def kinds(events: list[Event]) -> list[str]:
    return [str(event.kind) for event in events]


def running(site: Any, until: float = 2.0) -> PalletTracker:
    tracker = PalletTracker()
    go_on(tracker, site, 0.0, until)
    return tracker


def go_on(tracker: PalletTracker, site: Any, start: float, until: float, shift: float = 0.0) -> list[Event]:
    events = []
    for k in range(round(start * 20), round(until * 20)):
        inputs: list[Input] = [replace(site.odometry(k / 20), time=k / 20 + shift)]
        if k % 4 == 0:
            inputs += [replace(site.measured(n, k / 20), time=k / 20 + shift) for n in range(2)]
        for given in inputs:
            events += tracker.push(given)
    return events


def part(time: float = 2.0, **changes: Any) -> PartialMeasurement:
    given = PartialMeasurement(time, "epal1-1200", ("yaw",), np.array([1.5]), np.array([[1e-4]]), POSE)
    return replace(given, **changes)


BAD: list[tuple[Any, str]] = [
    (Odometry(math.nan, POSE), "time"),
    (Odometry(2.0, frame="map", pose=POSE), "frame"),
    (ShotTaken(math.inf), "time"),
    (part(math.nan), "time"),
    (part(components=()), "components"),
    (part(components=("yaw", "x"), values=np.zeros(2)), "components"),
    (part(components=("x", "x"), values=np.zeros(2)), "components"),
    (part(components=("pitch",)), "components"),
    (part(values=np.zeros(2)), "values"),
    (part(values=np.array([math.inf])), "finite"),
    (part(values=["no number"]), "expected numbers"),
    (part(covariance=np.array([[-1.0]])), "positive definite"),
    (part(covariance=np.eye(2)), "1 x 1"),
    (part(near=LevelPose(math.nan, 0.0, 0.0, 0.0)), "near"),
]
POSES = [LevelPose(math.nan, 0.0, 0.0, 0.0), LevelPose(0.0, math.inf, 0.0, 0.0), LevelPose(1e9, 0.0, 0.0, 0.0)]
COVARIANCES = [
    (np.full((4, 4), math.nan), "finite"),
    (np.diag([1.0, 1.0, 1.0, math.inf]), "finite"),
    (np.diag([1e20, 1.0, 1.0, 1.0]), "standard deviations"),
    (np.zeros((4, 4)), "positive definite"),
    (np.diag([1.0, 1.0, -1.0, 1.0]), "positive definite"),
    (np.ones((4, 4)), "positive definite"),
    (np.eye(4) + np.diag([0.1] * 3, 1), "symmetric"),
    (np.diag([1e5, 1e-8, 1e-4, 1e-4]), "eigenvalues"),
    (np.eye(3), "4 x 4"),
    (None, "expected"),
]


@pytest.mark.parametrize(("given", "words"), BAD, ids=range(len(BAD)))
def test_what_cannot_be_used_is_rejected_with_a_reason(make_site: SiteMaker, given: Input, words: str) -> None:
    harmless(make_site(1), given, words)


@pytest.mark.parametrize("pose", POSES)
def test_a_pose_that_is_none_is_rejected(make_site: SiteMaker, make_measurement: Any, pose: LevelPose) -> None:
    harmless(make_site(1), make_measurement(2.0, pose), "pose")


@pytest.mark.parametrize(("covariance", "words"), COVARIANCES, ids=range(len(COVARIANCES)))
def test_a_covariance_that_is_none_is_rejected(
    make_site: SiteMaker, make_measurement: Any, covariance: Any, words: str
) -> None:
    harmless(make_site(1), unchecked(make_measurement(2.0, POSE), covariance=covariance), words)


def harmless(site: Any, given: Input, words: str) -> None:
    tracker = running(site)
    before = tracker.tracks(1.99)
    (event,) = tracker.push(given)
    assert event.kind is EventKind.REJECTED
    assert words in event.reason
    assert repr(given.time) in event.reason
    assert "\n" not in event.reason
    assert repr(tracker.tracks(1.99)) == repr(before)
    events = go_on(tracker, site, 2.0, 2.5)
    assert not {"lost", "born", "reset"} & set(kinds(events))


def test_a_model_that_is_not_of_the_site_is_rejected(make_measurement: Any) -> None:
    tracker = PalletTracker(models=[load_library()["epal1-1200"]])
    tracker.push(Odometry(0.0, POSE))
    (event,) = tracker.push(make_measurement(0.0, POSE, model="t11-plastic"))
    assert event.kind is EventKind.REJECTED
    assert "epal1-1200" in event.reason
    assert "'t11-plastic'" in event.reason
    assert kinds(tracker.push(make_measurement(0.0, POSE))) == ["accepted", "born"]


def test_without_a_list_of_models_any_name_is_taken(make_measurement: Any) -> None:
    tracker = PalletTracker()
    tracker.push(Odometry(0.0, POSE))
    assert kinds(tracker.push(make_measurement(0.0, POSE, model="of the site's own"))) == ["accepted", "born"]


def test_something_else_is_a_fault_of_the_caller() -> None:
    given: Any = ["odometry"]
    with pytest.raises(TypeError, match="got str"):
        PalletTracker().push(given)


def test_a_duplicate_is_told_and_changes_nothing(make_site: SiteMaker) -> None:
    site, tracker = make_site(2), running(make_site(2))
    tracker.push([site.odometry(2.0), one := site.measured(0, 2.0)])
    before = repr(tracker.tracks())
    assert kinds(tracker.push(one)) == ["duplicate"]
    assert kinds(tracker.push(site.odometry(2.0))) == ["duplicate"]
    assert repr(tracker.tracks()) == before


def test_of_two_samples_of_the_same_time_the_same_one_is_kept_in_any_order() -> None:
    samples = [Odometry(0.1, LevelPose(x, 0.0, 0.0, 0.0)) for x in (0.05, 0.06)]
    kept = []
    for order in (samples, samples[::-1]):
        tracker = PalletTracker()
        tracker.push(Odometry(0.0, LevelPose(0.0, 0.0, 0.0, 0.0)))
        events = [event for given in order for event in tracker.push(given)]
        assert set(kinds(events)) <= {"accepted", "duplicate"}
        kept.append(next(each.pose for each in tracker._window.path if each.time == 0.1))
    assert kept[0] == kept[1]


def test_what_comes_too_late_is_told_with_its_age(make_site: SiteMaker) -> None:
    site = make_site(3)
    tracker = running(site, 5.0)
    before = repr(tracker.tracks())
    for late in (site.odometry(1.0), site.measured(0, 1.0), ShotTaken(1.0)):
        (event,) = tracker.push(late)
        assert event.kind is EventKind.TOO_LATE
        assert event.age == pytest.approx(3.95)
        assert event.window == 2.0
    assert repr(tracker.tracks()) == before


@pytest.mark.parametrize("shift", [-DAY, -100.0, -10.0, 30.0, 100.0, DAY, 1e9, -1e300, 1e300])
def test_a_single_input_from_another_time_harms_nothing(make_site: SiteMaker, shift: float) -> None:
    site = make_site(4)
    tracker, undisturbed = running(site), running(make_site(4))
    wrong = replace(site.odometry(2.0), time=2.0 + shift)
    (event,) = tracker.push(wrong)
    assert event.kind in (EventKind.TIME_JUMP, EventKind.TOO_LATE, EventKind.REJECTED)
    events = go_on(tracker, make_site(5), 2.0, 6.0)
    assert not {"reset", "lost", "born"} & set(kinds(events))
    go_on(undisturbed, make_site(5), 2.0, 6.0)
    assert repr(tracker.tracks()) == repr(undisturbed.tracks())


@pytest.mark.parametrize("shift", [-DAY, -100.0, -10.0, 100.0, DAY])
def test_when_time_itself_has_jumped_it_starts_anew(make_site: SiteMaker, shift: float) -> None:
    site = make_site(6)
    tracker = running(site)
    events = go_on(tracker, site, 2.0, 7.0, shift)
    assert kinds(events).count("reset") == 1
    assert {event.track for event in events if event.kind is EventKind.LOST} == {1, 2}
    assert [state.track for state in tracker.tracks()] == [3, 4]
    assert tracker.newest == pytest.approx(6.95 + shift)


def test_a_pause_is_no_jump(make_site: SiteMaker) -> None:
    site = make_site(7)
    site.twist = Twist(0.0, 0.0, 0.0)
    tracker = running(site)
    events = go_on(tracker, site, 2.0, 4.0, 20.0)
    assert kinds(events)[0] == "time_jump"
    assert not {"reset", "lost", "born"} & set(kinds(events))
    assert [state.track for state in tracker.tracks()] == [1, 2]
    held = [event for event in events if event.time == 22.0 and event.kind is EventKind.ACCEPTED]
    assert held, "the input that was held is used in the end"


def test_a_jump_of_the_odometry_is_told_and_loses_no_track(make_site: SiteMaker) -> None:
    site = make_site(8)
    tracker = running(site)
    events = []
    for k in range(40, 60):
        truth = site.odometry(k / 20)
        moved = replace(truth, pose=replace(truth.pose, x=truth.pose.x + 7.0))
        events += tracker.push(moved)
        if k % 4 == 0:
            events += tracker.push([site.measured(n, k / 20) for n in range(2)])
    assert "reset" in kinds(events)
    assert not {"lost", "born"} & set(kinds(events))
    for n, state in enumerate(sorted(tracker.tracks(), key=lambda state: state.pose.x)):
        assert np.linalg.norm((state.pose.as_array() - site.truth(n, state.time).as_array())[:3]) < 0.05


def test_measurements_wait_for_odometry_and_are_used_when_it_comes(make_site: SiteMaker) -> None:
    site, tracker = make_site(9), PalletTracker()
    for k in range(3):
        assert kinds(tracker.push(site.measured(0, k / 5))) == ["waiting"]
    assert tracker.tracks() == ()
    events = [event for k in range(12) for event in tracker.push(site.odometry(k / 20))]
    revised = [event for event in events if event.revised]
    assert kinds(revised) == ["accepted"] * 3
    assert {"born", "confirmed"} <= set(kinds(events))
    assert tracker.state(1).hits == 3


def test_odometry_that_never_comes_is_told_once_the_window_is_over(make_site: SiteMaker) -> None:
    site, tracker = make_site(10), PalletTracker()
    events = [event for k in range(40) for event in tracker.push(site.measured(0, k / 5))]
    refused = [event for event in events if event.kind is EventKind.REJECTED]
    assert len(refused) == 19
    assert all("no odometry" in event.reason and event.revised for event in refused)
    assert tracker.tracks() == ()
    assert len(tracker._window.shots) <= 21


def test_odometry_that_ends_leaves_what_is_known(make_site: SiteMaker) -> None:
    site = make_site(11)
    tracker = running(site)
    events = [event for k in range(10, 60) for event in tracker.push(site.measured(0, k / 5))]
    assert "rejected" in kinds(events)
    assert len(tracker.tracks()) == 2


def test_a_wild_rate_harms_for_as_long_as_it_lasts(make_site: SiteMaker) -> None:
    site = make_site(12)
    tracker = running(site)
    tracker.push(Odometry(2.01, None, Twist(9e5, 0.0, 9e5)))
    events = go_on(tracker, site, 2.05, 3.0)
    assert not {"lost", "born"} & set(kinds(events))
