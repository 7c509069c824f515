"""Measurements that a gate rejects and that agree with each other: the pallet is there, or they are the exception."""

import json
import math
import runpy
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from palletloc.geometry import LevelPose
from palletloc.measurement import PalletMeasurement, YawSource
from tracking import EventKind, Odometry, PalletTracker, Status, Twist
from tracking.tracker import Input

FAULT = Path(__file__).resolve().parents[2].parent / "shared/data/faults/track-locked-to-first-shot/case.py"
SIGMA = np.array([2e-3, 2e-3, 1e-3, 4e-3])
ASIDE = {
    "0.10 m": (0.0, 0.10, 0.0, 0.0),
    "0.27 m": (0.0, 0.27, 0.0, 0.0),
    "an opening": (0.0, 0.53, 0.0, 0.0),
    "depth": (0.53, 0.0, 0.0, 0.0),
    "turned": (0.0, 0.0, 0.0, math.pi),
}
IsOff = Callable[[int], bool]


def every_third(number: int) -> bool:
    return number % 3 == 0


def approach(off: Sequence[float], is_off: IsOff, pallets: Sequence[float] = (2.0,), shots: int = 30) -> list[Input]:
    """Return odometry at constant speed, and shots of pallets in a row; where one is off, all of its pallets are."""
    rng, inputs = np.random.default_rng(1), list[Input]()
    for number in range(shots):
        for k in range(4):
            time = 0.2 * number + 0.05 * k
            inputs.append(Odometry(time, LevelPose(0.5 * time, 0.0, 0.0, 0.0), Twist(0.5, 0.0, 0.0)))
        time = 0.2 * number + 0.15
        for y in pallets:
            true = np.array([6.0 - 0.5 * time, y, 0.0, 0.2]) + is_off(number) * np.array(off)
            pose = LevelPose(*(true + rng.normal(size=4) * SIGMA).tolist())
            inputs.append(PalletMeasurement(time, "t11-plastic", pose, np.diag(SIGMA**2), 0.9, YawSource.FACE))
    return inputs


def run(inputs: Sequence[Input]) -> tuple[PalletTracker, list[EventKind]]:
    tracker = PalletTracker()
    return tracker, [event.kind for given in inputs for event in tracker.push(given)]


@pytest.mark.parametrize(
    ("off", "pallets"),
    [*((off, (2.0,)) for off in ASIDE.values()), (ASIDE["an opening"], (0.7, 2.0, 3.3))],
    ids=[*ASIDE, "a group"],
)
def test_a_track_that_began_with_the_exception_goes_where_most_are(
    off: Sequence[float], pallets: Sequence[float]
) -> None:
    tracker, kinds = run(approach(off, every_third, pallets))
    assert kinds.count(EventKind.REINITIALIZED) == len(pallets)
    states = sorted(tracker.tracks(), key=lambda state: state.pose.y)
    assert [state.pose.y for state in states] == pytest.approx(pallets, abs=0.01)
    assert [state.pose.yaw for state in states] == pytest.approx([0.2] * len(pallets), abs=0.01)
    assert [state.status for state in states] == [Status.CONFIRMED] * len(pallets)


@pytest.mark.parametrize("off", ASIDE.values(), ids=ASIDE)
def test_it_stays_where_most_are(off: Sequence[float]) -> None:
    tracker, kinds = run(approach(off, lambda number: number % 3 == 2))
    assert EventKind.REINITIALIZED not in kinds
    (state,) = tracker.tracks()
    assert state.pose.y == pytest.approx(2.0, abs=0.01)
    assert state.hits == 20


def test_exceptions_that_are_scattered_never_move_a_track() -> None:
    rng = np.random.default_rng(5)
    chosen = set(rng.choice(np.arange(1, 60), 20, replace=False).tolist())
    inputs = approach((0.0, 0.0, 0.0, 0.0), every_third, shots=60)
    measured = [i for i, given in enumerate(inputs) if isinstance(given, PalletMeasurement)]
    for i in (measured[number] for number in chosen):
        given = inputs[i]
        assert isinstance(given, PalletMeasurement)
        values = given.forklift_from_pallet.as_array() + rng.uniform(-1, 1, 4) * (0.4, 0.4, 0.05, 0.4)
        inputs[i] = replace(given, forklift_from_pallet=LevelPose(*values.tolist()))
    tracker, kinds = run(inputs)
    assert kinds.count(EventKind.GATED) == 20
    assert EventKind.REINITIALIZED not in kinds
    assert tracker.state(1).pose.y == pytest.approx(2.0, abs=0.01)


def test_exceptions_in_a_row_move_it_only_until_the_next_that_is_none() -> None:
    """Three in a row look like a pallet that was moved; the fourth tells that it was not."""
    tracker, kinds = run(approach(ASIDE["0.27 m"], lambda number: number in (12, 13, 14), shots=20))
    assert kinds.count(EventKind.REINITIALIZED) == 2
    (state,) = tracker.tracks()
    assert state.pose.y == pytest.approx(2.0, abs=0.01)
    assert state.hits == 17


def test_a_track_is_not_confirmed_while_as_many_contradict_it() -> None:
    inputs = approach(ASIDE["0.27 m"], every_third, shots=9)
    tracker, kinds = run(inputs[:-5])  # after eight shots: three where it is, five elsewhere
    (state,) = tracker.tracks()
    assert (state.hits, state.status) == (3, Status.TENTATIVE)
    assert EventKind.CONFIRMED not in kinds
    events = tracker.push(inputs[-5:])
    assert {EventKind.REINITIALIZED, EventKind.CONFIRMED} <= {event.kind for event in events}


def test_the_count_survives_a_restart_and_any_order(same_states: Callable[..., None]) -> None:
    inputs, rng = approach(ASIDE["0.27 m"], every_third), np.random.default_rng(3)
    tracker, _ = run(inputs)
    late = [inputs[i] for i in np.argsort([given.time + rng.uniform(0.0, 1.9) for given in inputs], kind="stable")]
    begun, _ = run(late[:80])  # between the first and the last of what is counted
    restored = PalletTracker.restore(json.loads(json.dumps(begun.snapshot())))
    kept: Any = restored.snapshot()
    assert any(len(track["rejected"]) for track in kept["tracks"])
    for given in late[80:]:
        restored.push(given)
    same_states(tracker, restored, [inputs[-1].time])


@pytest.mark.skipif(not FAULT.exists(), reason="the shared recordings are not there")
def test_every_third_measurement_aside_from_the_first_on() -> None:
    state = runpy.run_path(str(FAULT))["state"]
    assert abs(state.pose.y - 2.0) < 0.01
    assert state.hits == 20
