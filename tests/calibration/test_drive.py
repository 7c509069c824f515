import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calibration.drive import compose, read_drive, relative
from palletloc.geometry import FloatArray, wrap_angle
from palletloc.trajectory import Trajectory, TrajectoryError

POSES = st.tuples(*[st.floats(-20, 20)] * 2, st.floats(-3, 3)).map(np.array)


def path(scale: float = 1.0, bias: float = 0.0) -> Trajectory:
    """Return an S-shaped way of 3 m in 6 s as odometry with constant errors measures it."""
    times = np.arange(0, 6.001, 0.02)
    yaw = 0.2 * np.sin(times)
    steps = 0.5 * 0.02 * np.ones(len(times) - 1) / scale
    seen = yaw + bias * times
    middle = (seen[1:] + seen[:-1]) / 2
    x = np.concatenate([[0], np.cumsum(steps * np.cos(middle))])
    y = np.concatenate([[0], np.cumsum(steps * np.sin(middle))])
    return Trajectory(times, x, y, seen)


@given(POSES, POSES)
def test_relative_undoes_compose(pose: FloatArray, step: FloatArray) -> None:
    back = relative(pose, compose(pose, step))
    assert np.allclose(back[:2], step[:2], atol=1e-9)
    assert abs(wrap_angle(float(back[2] - step[2]))) < 1e-9


def test_increments_add_up_to_the_odometry() -> None:
    times = np.linspace(0, 6, 13)
    poses = read_drive(path(), times.tolist()).poses()
    expected = [path().pose_at(time) for time in times]
    assert np.allclose(poses, [(p.x, p.y, p.yaw) for p in expected], atol=1e-12)


def test_increments_without_scale_error_and_bias_are_those_of_the_true_way() -> None:
    times = np.linspace(0, 6, 13).tolist()
    measured = read_drive(path(scale=1.02, bias=0.01), times)
    truth = read_drive(path(), times).poses()
    assert np.abs(measured.poses() - truth).max() > 0.05
    assert np.abs(measured.poses(scale=1.02, bias=0.01) - truth).max() < 5e-4


def test_errors_grow_with_the_time_between_shots() -> None:
    dense, sparse = (read_drive(path(), np.linspace(0, 6, n).tolist()).sigma for n in (25, 7))
    assert (sparse[1:].min(axis=0) > dense[1:].max(axis=0)).all()


def test_a_shot_beyond_the_odometry_is_refused() -> None:
    with pytest.raises(TrajectoryError):
        read_drive(path(), [1.0, 9.0])
