from __future__ import annotations

import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from palletloc.geometry import FloatArray, wrap_angle
from palletloc.trajectory import Trajectory, TrajectoryError


def wandering(count: int = 20, seed: int = 0) -> Trajectory:
    rng = np.random.default_rng(seed)
    times = np.cumsum(rng.uniform(0.01, 0.03, count))
    x, y, yaw, z = rng.normal(size=(4, count))
    return Trajectory(times, x, y, yaw, z=z)


def steady(times: FloatArray) -> Trajectory:
    """Return a motion at constant rates, which linear interpolation reproduces."""
    return Trajectory(times, 1.0 + 0.5 * times, -2.0 * times, 3.0 + 0.4 * times, z=0.1 * times)


def test_the_pose_at_a_sample_is_the_sample() -> None:
    path = wandering()
    assert path.z is not None
    for time, x, y, z, yaw in zip(path.times, path.x, path.y, path.z, path.yaw, strict=True):
        pose = path.pose_at(float(time))
        assert (pose.x, pose.y, pose.z, pose.yaw) == (x, y, z, wrap_angle(float(yaw)))


@given(st.floats(-0.1, 10.1))
def test_a_steady_motion_is_reproduced_at_any_time(time: float) -> None:
    pose = steady(np.linspace(0, 10, 101)).pose_at(time)
    expected = [1.0 + 0.5 * time, -2.0 * time, 0.1 * time]
    assert_allclose([pose.x, pose.y, pose.z], expected, atol=1e-9)
    assert abs(wrap_angle(pose.yaw - (3.0 + 0.4 * time))) < 1e-9


def test_the_yaw_takes_the_short_way_and_stays_wrapped() -> None:
    path = Trajectory(*np.array([[0.0, 1.0], [0.0, 0.0], [0.0, 0.0], [np.radians(170), np.radians(-170)]]))
    assert path.pose_at(0.25).yaw == pytest.approx(np.radians(175))
    assert path.pose_at(0.75).yaw == pytest.approx(np.radians(-175))
    assert np.diff(path.yaw) == pytest.approx(np.radians(20))


@given(st.lists(st.integers(-3, 3), min_size=20, max_size=20), st.floats(0, 1))
def test_whole_turns_added_to_a_yaw_change_nothing(turns: list[int], share: float) -> None:
    path = wandering()
    turned = Trajectory(path.times, path.x, path.y, path.yaw + 2 * np.pi * np.array(turns))
    time = path.span[0] + share * (path.span[1] - path.span[0])
    assert abs(wrap_angle(turned.pose_at(time).yaw - path.pose_at(time).yaw)) < 1e-9


def test_a_path_on_the_floor_has_no_height() -> None:
    assert Trajectory(*np.zeros((4, 1))).pose_at(0.0).z == 0.0


@pytest.mark.parametrize("time", [-0.11, 10.2, 1e9, float("nan"), float("inf")])
def test_a_time_outside_is_an_error_that_names_time_and_span(time: float) -> None:
    with pytest.raises(TrajectoryError, match=rf"{re.escape(f'{time:.6g}')} s.*between 0 s and 10 s.*0\.1 s outside"):
        steady(np.linspace(0, 10, 101)).pose_at(time)


def test_a_gap_does_not_widen_the_margin() -> None:
    times = np.array([0.0, 0.1, 0.2, 0.3, 5.0])
    with pytest.raises(TrajectoryError):
        steady(times).pose_at(5.2)


def test_a_single_sample_holds_at_its_own_time_only() -> None:
    path = Trajectory(*np.array([[2.0], [1.0], [0.5], [0.1]]))
    assert path.pose_at(2.0).x == 1.0
    with pytest.raises(TrajectoryError):
        path.pose_at(2.001)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"times": [0.0, 2.0, 1.0]}, "times: expected strictly increasing"),
        ({"times": [0.0, 1.0, 1.0]}, "times: expected strictly increasing"),
        ({"x": [0.0, 1.0]}, "x: expected one value per time"),
        ({"y": [0.0, float("nan"), 0.0]}, "y: a value is not finite"),
        ({"speed": [0.0, float("inf"), 0.0]}, "speed: a value is not finite"),
        ({"yaw_rate": [[0.0, 1.0, 2.0]]}, "yaw_rate: expected one value per time"),
    ],
)
def test_samples_that_make_no_path_are_refused(changes: dict[str, list[float]], said: str) -> None:
    samples = {"times": [0.0, 1.0, 2.0]} | {name: [0.0, 0.0, 0.0] for name in ("x", "y", "yaw")} | changes
    with pytest.raises(ValueError, match=said):
        Trajectory(**{name: np.array(values) for name, values in samples.items()})


def test_an_empty_path_is_refused() -> None:
    with pytest.raises(ValueError, match="times"):
        Trajectory(*np.zeros((4, 0)))


def test_the_samples_cannot_be_changed_afterwards() -> None:
    times, x, y, yaw = np.array([[0.0, 1.0], [0.0, 1.0], [0.0, 0.0], [0.0, 0.0]])
    path = Trajectory(times, x, y, yaw)
    x[:] = 7.0
    assert path.pose_at(1.0).x == 1.0
    assert not path.x.flags.writeable
