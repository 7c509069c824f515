from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import RigidTransform, Rotation

from palletloc.geometry import LevelPose
from palletloc.plane import PALLET_FROM_HORIZONTAL, PALLET_FROM_VERTICAL, PlaneGrid, place_plane

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


@given(
    st.floats(-5.0, 5.0),
    st.floats(0.01, 4.0),
    st.floats(-5.0, 5.0),
    st.floats(0.01, 4.0),
    st.floats(0.002, 0.1),
)
def test_a_spanning_grid_covers_its_rectangle_without_waste(
    left: float, width: float, bottom: float, height: float, resolution: float
) -> None:
    grid = PlaneGrid.spanning(left, left + width, bottom, bottom + height, resolution)
    last = grid.points(np.array([grid.columns - 1.0, grid.rows - 1.0]))
    np.testing.assert_allclose(grid.points(np.zeros(2)), [left, bottom + height])
    slack = 1e-6 * resolution
    assert left + width - slack <= last[0] < left + width + resolution
    assert bottom - resolution < last[1] <= bottom + slack


def test_right_grows_with_columns_and_up_against_rows() -> None:
    grid = PlaneGrid(left=-1.0, top=2.0, resolution=0.5, columns=5, rows=5)
    np.testing.assert_allclose(grid.points(np.array([[1.0, 0.0], [0.0, 1.0]])), [[-0.5, 2.0], [-1.0, 1.5]])


def test_points_and_pixels_are_inverse() -> None:
    grid = PlaneGrid(-0.7, 0.4, 0.013, 90, 60)
    pixels = np.random.default_rng(0).uniform(-20.0, 120.0, (4, 5, 2))
    np.testing.assert_allclose(grid.pixels(grid.points(pixels)), pixels, atol=1e-9)


@pytest.mark.parametrize(
    ("resolution", "columns", "rows"),
    [(0.0, 3, 3), (-0.1, 3, 3), (0.1, 0, 3), (0.1, 3, 0), (float("nan"), 3, 3)],
)
def test_a_grid_that_samples_nothing_is_refused(resolution: float, columns: int, rows: int) -> None:
    with pytest.raises(ValueError, match="positive resolution and size"):
        PlaneGrid(0.0, 0.0, resolution, columns, rows)
