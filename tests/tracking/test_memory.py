import gc
import sys
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest

from tracking import Odometry, PalletTracker, ShotTaken, Twist


def sizes(tracker: PalletTracker) -> dict[str, int]:
    """Return how many of each thing it holds."""
    window, log, clock = tracker._window, tracker._log, tracker._clock
    return {
        "samples": len(window.path),
        "kept motions": len(window.path._kept),
        "shots": len(window.shots),
        "beliefs": len(window.beliefs),
        "tracks": len(window.current.tracks),
        "numbers": len(log.numbering.numbers),
        "dispositions": len(log.dispositions),
        "statuses": len(log.statuses),
        "renewed": len(log.renewed),
        "elsewhere": len(clock.elsewhere),
        "snapshot": len(repr(tracker.snapshot())),
    }


def sizes_over(site: Any, duration: int, every: int, shots: int = 5) -> list[dict[str, int]]:
    """Drive to and fro before two pallets, with false detections and pallets that are moved."""
    tracker, found = PalletTracker(), []
    for k in range(duration * 20):
        time = k / 20
        forward = 0.3 if k // 100 % 2 == 0 else -0.3
        tracker.push(Odometry(time, None, Twist(forward, 0.0, 0.0)))
        if k % (20 // shots) == 0:
            ahead = 0.3 * (time % 10 if time % 10 < 5 else 10 - time % 10)
            inputs: list[Any] = [ShotTaken(time)]
            for number in range(2):
                seen = site.measured(number, 0.0, (0.3 * (time % 60 > 30) - ahead, 0.0, 0.0, 0.0))
                inputs.append(_at(seen, time))
            if k % 40 == 0:
                inputs.append(_at(site.measured(0, 0.0, (0.0, -6.0 + 0.1 * (k % 7), 0.0, 0.0)), time))
            tracker.push(inputs)
        if (k + 1) % (every * 20) == 0:
            found.append(sizes(tracker))
    return found


def _at(seen: Any, time: float) -> Any:
    return replace(seen, time=time)


def test_what_is_kept_does_not_grow(make_site: Callable[..., Any]) -> None:
    first, last = sizes_over(make_site(1), 120, 60)
    for name, size in first.items():
        assert last[name] <= 1.2 * size + 3, name


@pytest.mark.slow
def test_over_an_hour_nothing_grows(make_site: Callable[..., Any]) -> None:
    gc.collect()
    first, *_, last = sizes_over(make_site(1), 3600, 600)
    for name, size in first.items():
        assert last[name] <= 1.2 * size + 3, name


@pytest.mark.parametrize("kind", ["odometry", "shots", "late"])
def test_one_kind_of_input_alone_does_not_grow_either(make_site: Callable[..., Any], kind: str) -> None:
    site, tracker, found = make_site(2), PalletTracker(), []
    tracker.push([site.odometry(0.0), site.measured(0, 0.0)])
    for k in range(1500):
        time = k / 20
        if kind == "odometry":
            tracker.push(Odometry(time, None, Twist(0.1, 0.0, 0.0)))
        elif kind == "shots":
            tracker.push(_at(site.measured(0, 0.0), time))
        else:
            tracker.push(ShotTaken(time if k % 20 == 0 else -50.0))
        if k in (700, 1499):
            found.append(sizes(tracker))
    first, last = found
    assert all(last[name] <= 1.2 * size + 3 for name, size in first.items()), (first, last)
    assert sys.getsizeof(tracker._held) < 1000
