import json
import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from palletloc.pallet_library import load_library
from tracking import Odometry, PalletTracker, ShotTaken, SnapshotError, TrackerConfig
from tracking.config import GateConfig, LifeConfig

SiteMaker = Callable[..., Any]
FEW = settings(max_examples=4, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


def again(tracker: PalletTracker) -> PalletTracker:
    return PalletTracker.restore(json.loads(json.dumps(tracker.snapshot(), allow_nan=False)))


def assert_same(one: PalletTracker, other: PalletTracker) -> None:
    assert one.newest == other.newest
    for a, b in zip(one.tracks(), other.tracks(), strict=True):
        assert repr(replace(a, covariance=np.zeros(0))) == repr(replace(b, covariance=np.zeros(0)))
        np.testing.assert_array_equal(a.covariance, b.covariance)


@FEW
@given(st.integers(0, 2**32 - 1), st.floats(0.0, 1.0))
def test_after_a_restart_at_any_time_all_goes_on_to_the_last_bit(
    make_site: SiteMaker, seed: int, share: float
) -> None:
    site = make_site(seed)
    inputs = site.late(site.stream(4.0), 0.8)
    cut = round(share * len(inputs))
    tracker = PalletTracker()
    for each in inputs[:cut]:
        tracker.push(each)
    restored = again(tracker)
    assert_same(tracker, restored)
    for each in inputs[cut:]:
        assert repr(tracker.push(each)) == repr(restored.push(each))
    assert_same(tracker, restored)


def test_inputs_of_another_time_that_are_held_are_kept(make_site: SiteMaker) -> None:
    site, tracker = make_site(1), PalletTracker()
    tracker.push([site.odometry(0.0), site.measured(0, 0.0)])
    ahead = [site.odometry(0.0), site.measured(0, 0.0), site.partly(0, 0.0), ShotTaken(0.0)]
    for k, one in enumerate(ahead):
        tracker.push(replace(one, time=1000.0 + k / 10))
    restored = again(tracker)
    last = Odometry(1000.5, site.forklift(0.0))
    events = tracker.push(last)
    assert repr(restored.push(last)) == repr(events)
    assert [str(event.kind) for event in events].count("accepted") >= 3
    assert_same(tracker, restored)


def test_a_rival_and_another_config_are_kept(make_site: SiteMaker) -> None:
    site = make_site(2)
    config = TrackerConfig(gate=GateConfig(adapt_over=4), life=LifeConfig(recovery_hits=30))
    tracker = PalletTracker(config)
    for k in range(40):
        tracker.push([site.odometry(k / 5), site.measured(0, k / 5, (0.3 * (k > 20), 0.0, 0.0, 0.0))])
    assert tracker._window.base.tracks[0].rejected is not None
    restored = again(tracker)
    assert restored.config == config
    for k in range(40, 55):
        inputs = [site.odometry(k / 5), site.measured(0, k / 5, (0.3, 0.0, 0.0, 0.0))]
        assert repr(tracker.push(inputs)) == repr(restored.push(inputs))
    assert_same(tracker, restored)


def test_a_new_tracker_has_a_snapshot_too() -> None:
    restored = again(PalletTracker())
    assert restored.newest is None
    assert restored.tracks() == ()


def test_the_models_of_the_site_are_given_again(make_site: SiteMaker) -> None:
    models = [load_library()["epal1-800"]]
    restored = PalletTracker.restore(PalletTracker(models=models).snapshot(), models)
    site = make_site(3)
    restored.push(site.odometry(0.0))
    assert [str(event.kind) for event in restored.push(site.measured(0, 0.0))] == ["rejected"]


def broken(snapshot: dict[str, Any], place: Sequence[Any], value: Any) -> dict[str, Any]:
    changed: dict[str, Any] = json.loads(json.dumps(snapshot))
    inside: Any = changed
    *steps, last = place
    for step in steps:
        inside = inside[step]
    if value is KeyError:
        del inside[last]
    else:
        inside[last] = value
    return changed


@pytest.mark.parametrize(
    ("path", "value", "words"),
    [
        ("version", 2, "version: expected 4, got 2"),
        ("version", KeyError, "version: expected 4, got None"),
        ("version", True, "version: expected 4, got True"),
        ("shots", KeyError, "shots: is missing"),
        ("more", 1, "more: is unknown"),
        ("newest", "soon", "newest: expected a finite number"),
        ("newest", 10**400, "newest: expected a finite number"),
        ("following", True, "following: expected a whole number, got True"),
        ("following", 1, "following: expected more than all numbers"),
        ("time", 1e6, "time: expected one before the window"),
        ("time", None, "time: expected a time"),
        ("groups.0.state.mean", [1.0], r"groups\.0\.state: expected 10 numbers and their covariance for 1 tracks"),
        ("groups.0.state.mean.0", float("nan"), r"groups\.0\.state\.mean\.0: expected a finite number"),
        ("groups.0.state.mean.0", 7.0, r"tracks\.0\.state: expected what its group knows of the pallet"),
        ("groups.0.state.covariance.3", [1.0], r"groups\.0\.state\.covariance: expected rows of as many numbers"),
        ("groups.0.state.covariance.0.0", -1.0, r"groups\.0\.state\.covariance: expected a positive semidefinite"),
        ("groups.0.state.covariance.0.1", 1.0, r"groups\.0\.state\.covariance: expected a symmetric matrix"),
        ("groups.0.state.covariance.0.0", "1.0", r"groups\.0\.state\.covariance\.0\.0: expected a finite number"),
        ("groups.0.keys", [], "groups: expected every track in one of them"),
        ("groups", [], "groups: expected every track in one of them"),
        ("tracks.0.confirmed", 1, r"tracks\.0\.confirmed: expected true or false, got 1"),
        ("tracks.0.model", None, r"tracks\.0\.model: expected a text, got None"),
        ("tracks.0", 3, r"tracks\.0: expected a mapping, got 3"),
        ("shots.0.1.0.covariance", [[1.0]], "covariance"),
        ("shots.0.1.0.kind", "guess", r"shots\.0\.1\.0\.kind: expected one of PalletMeasurement, PartialMeasurement"),
        ("shots.0.0", 1e9, "shots: expected"),
        ("odometry.0.pose", None, "expected a pose, rates, or both"),
        ("odometry.0.time", 1e9, "odometry: expected"),
        ("statuses.0.1", "sure", r"statuses\.0\.1: expected one of tentative, confirmed, coasting, got 'sure'"),
        ("statuses.0", [1], r"statuses\.0: expected 2 values, got 1"),
        ("tracks.0.hits", 0, r"tracks\.0\.hits: expected at least one measurement"),
        ("tracks.0.misses", -1, r"tracks\.0\.misses: expected none or more, got -1"),
        ("tracks.0.seen", 1e6, r"tracks\.0\.seen: expected a time up to"),
        ("tracks.0.model", "", r"tracks\.0\.model: expected the name of a pallet model"),
        ("tracks.0.ratios", [-1.0], r"tracks\.0\.ratios: expected squares"),
        ("latency_since", -1, "latency_since: expected none or more shots"),
        ("shots.0.1.0.score", 2.0, r"shots\.0\.1\.0: score: expected a number from 0 to 1"),
        ("shots.0.1.0.model", "", r"shots\.0\.1\.0: model: expected the name of a pallet model"),
        ("shots.0.1.0.covariance.0.0", -1.0, r"shots\.0\.1\.0: covariance: expected a"),
        ("elsewhere", 3.0, "elsewhere: expected a list, got 3.0"),
        ("numbers", [], "numbers: expected a number for every track"),
        ("latency_shots.0.around", [1.0], r"latency_shots\.0: expected an array of shape"),
        ("config.gate", KeyError, r"config\.gate: is missing"),
        ("config.gate.probability", "high", r"config\.gate\.probability: expected a finite number"),
        ("config.gate.more", 1, r"config\.gate\.more: is unknown"),
    ],
)
def test_what_is_wrong_with_a_snapshot_is_said_in_one_line(
    make_site: SiteMaker, path: str, value: Any, words: str
) -> None:
    site, tracker = make_site(4), PalletTracker()
    for k in range(100):
        tracker.push([Odometry(k / 20, site.forklift(k / 20)), *([site.measured(0, k / 20)] if k % 4 == 0 else [])])
    place = [int(step) if step.isdecimal() else step for step in path.split(".")]
    with pytest.raises(SnapshotError, match=words) as fault:
        PalletTracker.restore(broken(tracker.snapshot(), place, value))
    assert "\n" not in str(fault.value)
    assert str(fault.value).startswith("snapshot: ")


@pytest.mark.parametrize("name", ["tracks", "numbers", "statuses"])
def test_what_is_named_twice_is_no_snapshot(make_site: SiteMaker, name: str) -> None:
    site, tracker = make_site(4), PalletTracker()
    for k in range(100):
        tracker.push([Odometry(k / 20, site.forklift(k / 20)), *([site.measured(0, k / 20)] if k % 4 == 0 else [])])
    snapshot = json.loads(json.dumps(tracker.snapshot()))
    snapshot[name].append(snapshot[name][0])
    with pytest.raises(SnapshotError, match=f"snapshot: {name}: expected each one once"):
        PalletTracker.restore(snapshot)


def places_in(plain: Any, place: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """Return the places of all values in a snapshot; of long lists those of the first ones."""
    keys = list(plain) if isinstance(plain, dict) else range(min(len(plain), 4)) if isinstance(plain, list) else ()
    return [place] * bool(place) + [inside for key in keys for inside in places_in(plain[key], (*place, key))]


@pytest.mark.parametrize("count", [60, pytest.param(1000, marks=pytest.mark.slow)])
def test_a_damaged_snapshot_is_refused_in_one_line_or_does_no_harm(make_site: SiteMaker, count: int) -> None:
    site, tracker, rng = make_site(5), PalletTracker(), np.random.default_rng(0)
    *inputs, last = site.stream(3.5, rate=10)
    for given_input in inputs:
        tracker.push(given_input)
    snapshot = json.loads(json.dumps(tracker.snapshot()))
    places = [place for place in places_in(snapshot) if place[0] != "config"]  # parameters may be any
    wrong: list[Any] = [None, True, -1, 0, 1e29, -1e29, math.nan, math.inf, 10**400, "1.0", [], {}, [[1.0]], KeyError]
    for at, value in zip(rng.integers(len(places), size=count), rng.integers(len(wrong), size=count), strict=True):
        place = places[at]
        damage = 0.0 if wrong[value] is KeyError and isinstance(place[-1], int) else wrong[value]
        restored = restored_or_fault(broken(snapshot, place, damage))
        if isinstance(restored, str):
            assert "\n" not in restored
        else:
            restored.push(last)
            json.dumps(restored.snapshot(), allow_nan=False)


def restored_or_fault(snapshot: Any) -> PalletTracker | str:
    try:
        return PalletTracker.restore(snapshot)
    except SnapshotError as fault:
        return str(fault)


@pytest.mark.parametrize("given_snapshot", [None, [], "{}", 3])
def test_something_else_is_no_snapshot(given_snapshot: Any) -> None:
    with pytest.raises(SnapshotError, match="snapshot"):
        PalletTracker.restore(given_snapshot)


@pytest.mark.parametrize("seed", [0, 7, 10])
def test_tracks_that_a_late_first_measurement_renamed_can_be_restored(make_site: SiteMaker, seed: int) -> None:
    site, tracker = make_site(seed), PalletTracker()
    for number, each in enumerate(site.late(site.stream(3.0))):
        tracker.push(each)
        if number % 15 == 7:
            assert_same(tracker, again(tracker))
