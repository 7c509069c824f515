import math

import pytest

from tracking.config import WindowConfig
from tracking.window import MOST_KEPT, Arrival, Clock


def running(time: float = 100.0) -> Clock:
    clock = Clock(WindowConfig())
    clock.judge(time)
    return clock


def test_the_first_input_is_the_present() -> None:
    clock = Clock(WindowConfig())
    assert clock.newest == -math.inf
    assert clock.judge(5.0) == Arrival(0.0)
    assert (clock.newest, clock.horizon) == (5.0, 3.0)


@pytest.mark.parametrize("time", [98.0, 99.5, 100.0, 101.0, 102.0])
def test_inside_the_window_on_both_sides_inputs_are_in_time(time: float) -> None:
    clock = running()
    assert clock.judge(time) == Arrival(100.0 - time)
    assert clock.newest == max(time, 100.0)


def test_a_late_input_is_late_and_no_jump() -> None:
    found = running().judge(97.0)
    assert (found.in_time, found.jumped, found.age) == (False, False, 3.0)


def test_a_pause_ends_with_the_second_input_ahead() -> None:
    clock = running()
    assert clock.judge(130.0) == Arrival(-30.0, in_time=False, jumped=True)
    assert clock.newest == 100.0
    found = clock.judge(129.5)
    assert found == Arrival(-29.5, follows=1)
    assert clock.newest == 130.0


def test_an_input_in_between_ends_a_row() -> None:
    clock = running()
    for _ in range(20):
        assert not clock.judge(130.0).in_time
        assert clock.judge(100.1).in_time
    assert clock.newest == 100.1


def test_five_inputs_near_each_other_from_far_away_are_the_present() -> None:
    clock = running()
    found = [clock.judge(-500.0 + 0.1 * k) for k in range(5)]
    assert [each.restarted for each in found] == [False] * 4 + [True]
    assert [each.follows for each in found] == list(range(5))
    assert clock.newest == pytest.approx(-499.6)


def test_far_inputs_that_are_far_from_each_other_are_not() -> None:
    clock = running()
    assert not any(clock.judge(time).restarted for time in (1e6, 2e6, 3e6, -5e6, 1e7, 2e7, 7e7, 8e8))


def test_late_inputs_alone_for_a_whole_window_are_the_present() -> None:
    clock = running()
    found = [clock.judge(90.0 + 0.1 * k) for k in range(21)]
    assert [each.restarted for each in found].index(True) == 20
    assert clock.newest == pytest.approx(92.0)


def test_late_inputs_are_not_kept_without_end() -> None:
    clock = running()
    for _ in range(2 * MOST_KEPT):
        clock.judge(90.0)
    assert len(clock.elsewhere) == MOST_KEPT
