from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from palletloc.cameras import CameraModel
from palletloc.errors import PalletLocError
from palletloc.mounting import Mounting
from palletloc.pallet import PalletModel
from palletloc.shelf import ShelfPlane
from palletloc.shelf_view import DetectionConfig, ShelfPlaneError, ShelfView, view_shelf
from palletloc.shot import Shot

CONFIG = DetectionConfig()
SHELF = ShelfPlane(1.5, 2.0, -np.pi / 2 + 0.01, (0.0, 1.5))
Mounted = Callable[..., RigidTransform]
Looking = Callable[..., ShelfView]


@pytest.fixture
def forklift_from_camera(mounted: Mounted) -> RigidTransform:
    return mounted(0.3, -0.1, 1.8, 3.0, 1.0, -0.5)


def gray(camera: CameraModel, forklift_from_camera: RigidTransform) -> Shot:
    return Shot(np.full((camera.height, camera.width), 100, np.uint8), camera, Mounting(forklift_from_camera))


@pytest.fixture
def looking(whole_view: CameraModel, t11: PalletModel, forklift_from_camera: RigidTransform) -> Looking:
    shot = gray(whole_view, forklift_from_camera)

    def view(shelf: ShelfPlane = SHELF, level: float | None = 0.0, config: DetectionConfig = CONFIG) -> ShelfView:
        levels = () if level is None else (level,)
        shelf = replace(shelf, levels=levels)
        (seen,) = view_shelf(shot, shelf, [t11], config)
        return seen

    return view


@pytest.mark.parametrize("facing", [-1.5, 1.6, 2.8])
def test_the_view_lies_on_the_plane_with_its_origin_beside_the_camera(
    facing: float, looking: Looking, forklift_from_camera: RigidTransform
) -> None:
    out = np.array([np.cos(facing), np.sin(facing), 0.0])
    center = forklift_from_camera.translation
    along = np.array([out[1], -out[0], 0.0])
    point = center - 2.2 * out + 0.7 * along
    seen = looking(ShelfPlane(point[0], point[1], facing))
    plane = seen.forklift_from_plane
    for corner in ([-1.0, 0.3, 0.0], [2.0, 1.0, 0.0]):
        assert (plane.apply(corner) - point) @ out == pytest.approx(0.0, abs=1e-9)
    np.testing.assert_allclose(plane.rotation.apply([0.0, 0.0, 1.0]), out, atol=1e-9)
    np.testing.assert_allclose(plane.translation, [*(center - 2.2 * out)[:2], 0.0], atol=1e-9)
    assert seen.distance == pytest.approx(2.2)
    assert seen.camera_height == pytest.approx(1.8)
    assert np.cos(seen.yaw - facing) == pytest.approx(-1.0)
    expected = forklift_from_camera.inv() * plane
    np.testing.assert_allclose(seen.view.camera_from_plane.as_matrix(), expected.as_matrix(), atol=1e-9)


@pytest.mark.parametrize("level", [0.0, 1.5, None])
def test_the_view_holds_every_face_that_is_searched(level: float | None, looking: Looking, t11: PalletModel) -> None:
    seen = looking(level=level)
    grid = seen.view.grid
    bottom = grid.top - (grid.rows - 1) * grid.resolution
    right = grid.left + (grid.columns - 1) * grid.resolution
    heights = (level, level) if level is not None else CONFIG.heights
    assert bottom < heights[0]
    assert grid.top > heights[1] + t11.height
    assert grid.left < seen.columns[0] - t11.width / 2
    assert right > seen.columns[1] + t11.width / 2


def test_what_is_searched_lies_in_range_and_not_behind(
    looking: Looking, forklift_from_camera: RigidTransform
) -> None:
    seen = looking()
    for column in seen.columns:
        away = seen.forklift_from_plane.apply([column, 0.0, 0.0]) - forklift_from_camera.translation
        assert np.hypot(*away[:2]) <= CONFIG.max_range + 1e-6
        assert abs(np.degrees(np.arctan2(away[1], away[0]))) <= CONFIG.max_bearing_deg + 3.0
    short = looking(config=replace(CONFIG, max_range=3.0))
    ahead = looking(config=replace(CONFIG, max_bearing_deg=95.0))
    assert np.ptp(short.columns) < np.ptp(seen.columns)
    assert np.ptp(ahead.columns) < np.ptp(seen.columns)


def test_a_shelf_on_the_other_side_is_searched_alike(looking: Looking) -> None:
    left, right = ShelfPlane(1.5, 1.9, -np.pi / 2), ShelfPlane(1.5, -2.1, np.pi / 2)
    there, here = looking(right), looking(left)
    assert there.distance == pytest.approx(here.distance)
    # ahead is to the right of a shelf on the left, and to the left of one on the right
    assert there.columns[0] == pytest.approx(-here.columns[1], abs=0.1)


def test_each_level_has_a_view_of_its_own_on_the_same_plane(
    whole_view: CameraModel, t11: PalletModel, forklift_from_camera: RigidTransform
) -> None:
    views = view_shelf(gray(whole_view, forklift_from_camera), SHELF, [t11], CONFIG)
    assert tuple(seen.level for seen in views) == SHELF.levels
    for seen in views:
        np.testing.assert_array_equal(seen.forklift_from_plane.as_matrix(), views[0].forklift_from_plane.as_matrix())
        assert seen.view.grid.rows < 200


def test_a_side_of_which_less_is_searched_takes_less_of_the_view(looking: Looking, t11: PalletModel) -> None:
    seen = looking(config=replace(CONFIG, max_bearing_deg=95.0))
    grid = seen.view.grid
    left = seen.columns[0] - grid.left - t11.width / 2
    right = grid.left + (grid.columns - 1) * grid.resolution - seen.columns[1] - t11.width / 2
    assert -seen.columns[0] < seen.columns[1]
    assert 0.1 < left < 0.5 * right


def test_drift_widens_the_band(looking: Looking) -> None:
    sure, unsure = looking(), looking(replace(SHELF, drift=np.radians(4.0)))
    assert unsure.view.grid.rows > sure.view.grid.rows
    assert unsure.drift == pytest.approx(np.radians(4.0))


@pytest.mark.parametrize(
    ("shelf", "message"),
    [
        (ShelfPlane(0.3, -2.0, -np.pi / 2), "camera is behind the plane"),
        (ShelfPlane(1.5, 2.0, np.pi / 2), "camera is behind the plane"),
        (ShelfPlane(0.3, -0.1, -np.pi / 2), r"camera is -?0\.00 m from the plane"),
        (ShelfPlane(0.3, 0.1, -np.pi / 2), r"camera is 0\.20 m from the plane"),
    ],
    ids=["behind", "facing_away", "through", "grazing"],
)
def test_a_plane_that_the_camera_is_not_before_is_refused(shelf: ShelfPlane, message: str, looking: Looking) -> None:
    with pytest.raises(ShelfPlaneError, match=message) as caught:
        looking(shelf)
    assert isinstance(caught.value, PalletLocError)
    assert "\n" not in str(caught.value)
    assert "expected at least" in str(caught.value)
