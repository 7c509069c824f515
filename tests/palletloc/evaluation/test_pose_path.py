import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import RigidTransform, Rotation

from palletloc.evaluation.errors import EvaluationError
from palletloc.evaluation.pose_path import PosePath, associate, interpolate, level_path
from palletloc.evaluation.time_pairing import TimeRule
from palletloc.trajectory import Trajectory

STEADY = np.array([0.3, -0.2, 0.4])
BEGIN = Rotation.from_rotvec([1.0, 0.4, -0.2])


def steady(times: list[float]) -> PosePath:
    """Return a path at constant speed and constant turn rate."""
    seconds = np.array(times)[:, None]
    return PosePath(
        np.array(times),
        RigidTransform.from_components(seconds * [1.0, 0.5, 0.1], BEGIN * Rotation.from_rotvec(seconds * STEADY)),
    )


def same(one: RigidTransform, other: RigidTransform) -> None:
    np.testing.assert_allclose(one.as_matrix(), other.as_matrix(), atol=1e-12)


@given(st.lists(st.floats(0, 6), min_size=1, max_size=8, unique=True).map(sorted))
def test_a_steady_motion_is_interpolated_exactly(times: list[float]) -> None:
    found = interpolate(steady([0.0, 2.0, 3.0, 6.0]), steady(times), limit=3.0)
    same(found.reference, found.estimate)
    assert (found.times.tolist(), found.rule, found.limit) == (times, TimeRule.INTERPOLATED, 3.0)


def test_nothing_is_interpolated_outside_or_across_a_long_gap() -> None:
    found = interpolate(steady([1.0, 2.0, 9.0]), steady([0.5, 1.5, 5.0, 9.0, 9.5]), limit=1.0)
    assert found.times.tolist() == [1.5, 9.0]


def test_association_takes_samples_as_they_are() -> None:
    found = associate(steady([0.0, 1.0, 2.0]), steady([0.006, 2.004, 7.0]), limit=0.01)
    same(found.reference, steady([0.0, 2.0]).poses)
    same(found.estimate, steady([0.006, 2.004]).poses)
    assert found.times.tolist() == [0.006, 2.004]
    assert (found.rule, found.limit) == (TimeRule.NEAREST, 0.01)
    assert found.largest == pytest.approx(0.006)


def test_an_offset_moves_the_estimate_in_time() -> None:
    reference, late = steady([0.0, 1.0]), PosePath(np.array([5.0, 6.0]), steady([0.0, 1.0]).poses)
    for found in (associate(reference, late, offset=-5.0), interpolate(reference, late, 1.0, offset=-5.0)):
        same(found.reference, found.estimate)
        assert found.times.tolist() == [0.0, 1.0]


def test_paths_of_other_times_are_refused() -> None:
    for pairing in (associate, interpolate):
        with pytest.raises(EvaluationError, match="reference from 0 s to 1 s, estimate from 5 s to 6 s: expected"):
            pairing(steady([0.0, 1.0]), steady([5.0, 6.0]), 0.01)


def test_paths_without_a_pair_are_refused() -> None:
    with pytest.raises(EvaluationError, match=r"within 0\.01 s"):
        associate(steady([0.0, 1.0]), steady([0.5]))
    with pytest.raises(EvaluationError, match=r"at most 0\.01 s"):
        interpolate(steady([0.0, 1.0]), steady([0.5]), 0.01)


def test_a_level_trajectory_is_a_path() -> None:
    level = Trajectory(
        times=np.array([0.0, 1.0]),
        x=np.array([1.0, 2.0]),
        y=np.array([3.0, 4.0]),
        yaw=np.array([0.5, 0.7]),
        z=np.array([0.1, 0.2]),
    )
    path = level_path(level)
    for index, time in enumerate(level.times):
        np.testing.assert_allclose(path.poses[index].as_matrix(), level.pose_at(float(time)).matrix(), atol=1e-12)
    flat = level_path(Trajectory(*np.array([[0.0], [1.0], [3.0], [0.5]])))
    assert flat.positions.tolist() == [[1.0, 3.0, 0.0]]


@pytest.mark.parametrize(("times", "what"), [([0.0], "one pose per time"), ([1.0, 1.0], "strictly increasing")])
def test_paths_that_are_none_are_refused(times: list[float], what: str) -> None:
    with pytest.raises(ValueError, match=what):
        PosePath(np.array(times), RigidTransform.identity(2))
