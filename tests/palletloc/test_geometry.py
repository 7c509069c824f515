from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import RigidTransform, Rotation

from palletloc.geometry import LevelPose, level_pose, wrap_angle

metres = st.floats(-50.0, 50.0)
angles = st.floats(-3.1, 3.1)
poses = st.builds(LevelPose, metres, metres, metres, angles)


@given(st.floats(-100.0, 100.0))
def test_a_wrapped_angle_is_the_same_direction_within_half_a_turn(angle: float) -> None:
    wrapped = wrap_angle(angle)
    assert -np.pi <= wrapped < np.pi
    np.testing.assert_allclose([np.cos(wrapped), np.sin(wrapped)], [np.cos(angle), np.sin(angle)], atol=1e-12)


def test_half_a_turn_is_the_negative_end() -> None:
    assert wrap_angle(np.pi) == -np.pi
    assert wrap_angle(-np.pi) == -np.pi


def test_arrays_are_wrapped_element_by_element() -> None:
    several = np.linspace(-9.0, 9.0, 12).reshape(3, 4)
    expected = [[wrap_angle(float(angle)) for angle in row] for row in several]
    np.testing.assert_array_equal(wrap_angle(several), expected)


@given(poses)
def test_a_pose_is_a_turn_about_the_vertical_and_a_shift(pose: LevelPose) -> None:
    expected = RigidTransform.from_components([pose.x, pose.y, pose.z], Rotation.from_euler("z", pose.yaw))
    np.testing.assert_allclose(pose.transform().as_matrix(), expected.as_matrix(), atol=1e-12)
    np.testing.assert_array_equal(pose.matrix(), pose.transform().as_matrix())


@given(poses)
def test_the_level_part_of_a_level_transform_is_the_pose(pose: LevelPose) -> None:
    np.testing.assert_allclose(level_pose(pose.transform()).as_array(), pose.as_array(), atol=1e-12)


@given(poses, poses)
def test_composed_poses_add_their_headings(first: LevelPose, second: LevelPose) -> None:
    both = level_pose(first.transform() * second.transform())
    assert wrap_angle(both.yaw - first.yaw - second.yaw) == pytest.approx(0.0, abs=1e-9)
    assert both.z == pytest.approx(first.z + second.z)


@pytest.mark.parametrize("heading", [-2.0, 0.0, 0.7])
def test_the_level_part_keeps_place_and_heading_of_a_tilted_transform(heading: float) -> None:
    tilted = Rotation.from_euler("ZYX", [heading, 0.3, -0.2])
    pose = level_pose(RigidTransform.from_components([1.0, -2.0, 0.5], tilted))
    np.testing.assert_allclose(pose.as_array(), [1.0, -2.0, 0.5, heading], atol=1e-12)
