"""Angles, poses, planes, footprints, mountings and trajectories."""

import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.spatial.transform import RigidTransform, Rotation

from palletloc import LevelPose, Mounting, Opening, PalletModel
from palletloc.footprint import outline, overlapping, overlaps
from palletloc.geometry import FloatArray, level_pose, wrap_angle
from palletloc.plane import PALLET_FROM_HORIZONTAL, PALLET_FROM_VERTICAL, PlaneGrid, place_plane
from palletloc.trajectory import Trajectory, TrajectoryError
from tests.palletloc.poses import POSE, Mounted

metres = st.floats(-50.0, 50.0)
angles = st.floats(-3.1, 3.1)
poses = st.builds(LevelPose, metres, metres, metres, angles)


@given(st.floats(-100.0, 100.0))
def test_a_wrapped_angle_is_the_same_direction_within_half_a_turn(angle: float) -> None:
    wrapped = wrap_angle(angle)
    assert -np.pi <= wrapped < np.pi
    np.testing.assert_allclose([np.cos(wrapped), np.sin(wrapped)], [np.cos(angle), np.sin(angle)], atol=1e-12)


def test_half_a_turn_is_the_negative_end_and_arrays_are_wrapped_by_element() -> None:
    assert wrap_angle(np.pi) == -np.pi
    assert wrap_angle(-np.pi) == -np.pi
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


# Planes and their grids.

INTO, LEFT, UP = np.eye(3)


@pytest.mark.parametrize(
    ("plane", "axes"),
    [(PALLET_FROM_VERTICAL, (-LEFT, UP, -INTO)), (PALLET_FROM_HORIZONTAL, (-LEFT, INTO, UP))],
    ids=["vertical", "horizontal"],
)
def test_axes_point_right_up_and_towards_the_viewer(plane: RigidTransform, axes: tuple[np.ndarray, ...]) -> None:
    np.testing.assert_allclose(plane.as_matrix()[:3, :3].T, axes, atol=1e-12)
    np.testing.assert_array_equal(plane.translation, 0.0)


@pytest.mark.parametrize("pallet_from_plane", [PALLET_FROM_VERTICAL, PALLET_FROM_HORIZONTAL])
def test_a_placed_plane_is_the_product_of_the_transforms(pallet_from_plane: RigidTransform) -> None:
    turn = Rotation.from_euler("ZYX", [0.4, -0.02, 0.03])
    camera_from_forklift = RigidTransform.from_components([0.1, -0.2, -1.8], turn)
    pose = LevelPose(2.0, 1.0, 0.3, 1.4)
    placed = place_plane(camera_from_forklift, pose, pallet_from_plane)
    expected = camera_from_forklift * pose.transform() * pallet_from_plane
    np.testing.assert_allclose(placed.as_matrix(), expected.as_matrix(), atol=1e-12)


@given(st.floats(-5.0, 5.0), st.floats(0.01, 4.0), st.floats(-5.0, 5.0), st.floats(0.01, 4.0), st.floats(0.002, 0.1))
def test_a_spanning_grid_covers_its_rectangle_without_waste(
    left: float, width: float, bottom: float, height: float, resolution: float
) -> None:
    grid = PlaneGrid.spanning(left, left + width, bottom, bottom + height, resolution)
    last = grid.points(np.array([grid.columns - 1.0, grid.rows - 1.0]))
    np.testing.assert_allclose(grid.points(np.zeros(2)), [left, bottom + height])
    slack = 1e-6 * resolution
    assert left + width - slack <= last[0] < left + width + resolution
    assert bottom - resolution < last[1] <= bottom + slack


def test_right_grows_with_columns_and_up_against_rows_and_back() -> None:
    grid = PlaneGrid(left=-1.0, top=2.0, resolution=0.5, columns=5, rows=5)
    np.testing.assert_allclose(grid.points(np.array([[1.0, 0.0], [0.0, 1.0]])), [[-0.5, 2.0], [-1.0, 1.5]])
    grid = PlaneGrid(-0.7, 0.4, 0.013, 90, 60)
    pixels = np.random.default_rng(0).uniform(-20.0, 120.0, (4, 5, 2))
    np.testing.assert_allclose(grid.pixels(grid.points(pixels)), pixels, atol=1e-9)


@pytest.mark.parametrize(
    ("resolution", "columns", "rows"), [(0.0, 3, 3), (-0.1, 3, 3), (0.1, 0, 3), (0.1, 3, 0), (float("nan"), 3, 3)]
)
def test_a_grid_that_samples_nothing_is_refused(resolution: float, columns: int, rows: int) -> None:
    with pytest.raises(ValueError, match="positive resolution and size"):
        PlaneGrid(0.0, 0.0, resolution, columns, rows)


# Footprints.

WIDE = PalletModel("wide", 1.2, 0.144, 0.8, (Opening(0.0, 0.02, 0.4, 0.1),))
NARROW = PalletModel("narrow", 0.8, 0.144, 1.2, (Opening(0.0, 0.02, 0.4, 0.1),))

near_metres = st.floats(-20.0, 20.0)
places = st.builds(LevelPose, near_metres, near_metres, st.floats(0.0, 5.0), angles)


def beside(pose: LevelPose, into: float, left: float, up: float = 0.0, turn: float = 0.0) -> LevelPose:
    """A pose given in the frame of another."""
    return level_pose(pose.transform() * LevelPose(into, left, up, turn).transform())


@given(places)
def test_a_pallet_overlaps_itself_and_none_far_away(pose: LevelPose) -> None:
    assert overlapping(pose, WIDE, pose, WIDE)
    assert overlapping(pose, WIDE, pose, NARROW)
    for place in (
        beside(pose, 0.0, 1.3),
        beside(pose, 0.0, -1.3),
        beside(pose, 1.3, 0.0),
        beside(pose, 0.0, 0.0, 1.0),
    ):
        assert not overlapping(pose, WIDE, place, WIDE)


@given(places, st.floats(-1.5, 1.5), st.floats(-1.5, 1.5), st.floats(-0.3, 0.3))
def test_overlap_is_mutual_and_does_not_depend_on_the_frame(
    pose: LevelPose, into: float, left: float, up: float
) -> None:
    other = beside(pose, into, left, up)
    found = overlapping(pose, WIDE, other, NARROW)
    assert overlapping(other, NARROW, pose, WIDE) == found
    origin = LevelPose(0.0, 0.0, 0.0, 0.0)
    margins = [abs(left) - 0.92, abs(up) - 0.144, abs(into) - 0.8]
    if min(abs(margin) for margin in margins) > 1e-6:
        assert overlapping(origin, WIDE, LevelPose(into, left, up, 0.0), NARROW) == found


def test_neighbours_that_touch_and_pallets_on_each_other_do_not_overlap() -> None:
    assert not overlapping(POSE, WIDE, beside(POSE, 0.0, 1.19), WIDE)
    assert not overlapping(POSE, WIDE, beside(POSE, 0.0, 0.0, 0.144), WIDE)
    assert overlapping(POSE, WIDE, beside(POSE, 0.0, 0.5), WIDE)  # shifted by one opening
    assert overlapping(POSE, WIDE, beside(POSE, 0.1, 0.1, 0.03, 0.05), WIDE)


@given(st.lists(places, min_size=1, max_size=4), st.lists(places, min_size=1, max_size=4))
def test_many_at_once_are_each_told_as_two_of_them(ones: list[LevelPose], others: list[LevelPose]) -> None:
    near = [*others, *(beside(pose, 0.1, 0.2) for pose in ones)]
    poses, there = (np.array([pose.as_array() for pose in some]) for some in (ones, near))
    found = overlaps(poses[:, None], outline(WIDE), there, outline(NARROW))
    assert found.tolist() == [[overlapping(pose, WIDE, other, NARROW) for other in near] for pose in ones]


# Mountings.


@pytest.fixture
def mounting(mounted: Mounted) -> Mounting:
    return Mounting(mounted(0.3, -0.1, 1.8, 40.0, 12.0, -5.0), (0.001, 0.002, 0.003), (0.01, 0.02, 0.03))


def test_its_center_sigmas_and_inverse_are_those_of_its_transform_and_cannot_be_changed(mounting: Mounting) -> None:
    np.testing.assert_allclose(mounting.center, [0.3, -0.1, 1.8])
    np.testing.assert_allclose(mounting.forklift_from_camera.apply(np.zeros(3)), mounting.center)
    np.testing.assert_array_equal(mounting.sigma, [0.001, 0.002, 0.003, 0.01, 0.02, 0.03])
    inverse = mounting.forklift_from_camera.inv().as_matrix()
    np.testing.assert_allclose(mounting.camera_from_forklift, inverse, atol=1e-15)
    np.testing.assert_allclose(mounting.to_camera.as_matrix(), inverse, atol=1e-15)
    assert not mounting.center.flags.writeable
    assert not mounting.camera_from_forklift.flags.writeable


# Trajectories.


def wandering(count: int = 20, seed: int = 0) -> Trajectory:
    rng = np.random.default_rng(seed)
    times = np.cumsum(rng.uniform(0.01, 0.03, count))
    x, y, yaw, z = rng.normal(size=(4, count))
    return Trajectory(times, x, y, yaw, z=z)


def steady(times: FloatArray) -> Trajectory:
    """Return a motion at constant rates, which linear interpolation reproduces."""
    return Trajectory(times, 1.0 + 0.5 * times, -2.0 * times, 3.0 + 0.4 * times, z=0.1 * times)


def test_the_pose_at_a_sample_is_the_sample_and_the_yaw_takes_the_short_way() -> None:
    path = wandering()
    assert path.z is not None
    for time, x, y, z, yaw in zip(path.times, path.x, path.y, path.z, path.yaw, strict=True):
        pose = path.pose_at(float(time))
        assert (pose.x, pose.y, pose.z, pose.yaw) == (x, y, z, wrap_angle(float(yaw)))
    path = Trajectory(*np.array([[0.0, 1.0], [0.0, 0.0], [0.0, 0.0], [np.radians(170), np.radians(-170)]]))
    assert path.pose_at(0.25).yaw == pytest.approx(np.radians(175))
    assert path.pose_at(0.75).yaw == pytest.approx(np.radians(-175))
    assert np.diff(path.yaw) == pytest.approx(np.radians(20))


@given(st.floats(-0.1, 10.1))
def test_a_steady_motion_is_reproduced_at_any_time(time: float) -> None:
    pose = steady(np.linspace(0, 10, 101)).pose_at(time)
    expected = [1.0 + 0.5 * time, -2.0 * time, 0.1 * time]
    assert_allclose([pose.x, pose.y, pose.z], expected, atol=1e-9)
    assert abs(wrap_angle(pose.yaw - (3.0 + 0.4 * time))) < 1e-9


@given(st.lists(st.integers(-3, 3), min_size=20, max_size=20), st.floats(0, 1))
def test_whole_turns_added_to_a_yaw_change_nothing(turns: list[int], share: float) -> None:
    path = wandering()
    turned = Trajectory(path.times, path.x, path.y, path.yaw + 2 * np.pi * np.array(turns))
    time = path.span[0] + share * (path.span[1] - path.span[0])
    assert abs(wrap_angle(turned.pose_at(time).yaw - path.pose_at(time).yaw)) < 1e-9


def test_a_path_on_the_floor_has_no_height_and_no_sample_can_be_changed_afterwards() -> None:
    assert Trajectory(*np.zeros((4, 1))).pose_at(0.0).z == 0.0
    times, x, y, yaw = np.array([[0.0, 1.0], [0.0, 1.0], [0.0, 0.0], [0.0, 0.0]])
    path = Trajectory(times, x, y, yaw)
    x[:] = 7.0
    assert path.pose_at(1.0).x == 1.0
    assert not path.x.flags.writeable


@pytest.mark.parametrize("time", [-0.11, 10.2, 1e9, float("nan"), float("inf")])
def test_a_time_outside_is_an_error_that_names_time_and_span(time: float) -> None:
    with pytest.raises(TrajectoryError, match=rf"{re.escape(f'{time:.6g}')} s.*between 0 s and 10 s.*0\.1 s outside"):
        steady(np.linspace(0, 10, 101)).pose_at(time)


def test_a_single_sample_holds_at_its_own_time_only_and_a_gap_widens_no_margin() -> None:
    times = np.array([0.0, 0.1, 0.2, 0.3, 5.0])
    with pytest.raises(TrajectoryError):
        steady(times).pose_at(5.2)
    path = Trajectory(*np.array([[2.0], [1.0], [0.5], [0.1]]))
    assert path.pose_at(2.0).x == 1.0
    with pytest.raises(TrajectoryError):
        path.pose_at(2.001)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"times": [0.0, 2.0, 1.0]}, "times: expected strictly increasing"),
        ({"times": [0.0, 1.0, 1.0]}, "times: expected strictly increasing"),
        ({key: [] for key in ("times", "x", "y", "yaw")}, "times"),
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
