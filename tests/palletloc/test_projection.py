from __future__ import annotations

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from palletloc.cameras import Equirectangular, KannalaBrandt
from palletloc.geometry import Image
from palletloc.plane import PALLET_FROM_HORIZONTAL, PALLET_FROM_VERTICAL, PlaneGrid
from palletloc.projection import Interpolation, Projector

CAMERA = Equirectangular(960, 480)
GRID = PlaneGrid.spanning(-0.6, 0.6, 0.0, 0.3, resolution=0.01)


def vertical(x: float, y: float = 0.0, yaw_deg: float = 0.0) -> RigidTransform:
    heading = Rotation.from_euler("z", yaw_deg, degrees=True)
    return RigidTransform.from_components([x, y, -0.8], heading) * PALLET_FROM_VERTICAL


@pytest.fixture
def image() -> Image:
    return np.random.default_rng(0).integers(0, 256, (CAMERA.height, CAMERA.width, 3), dtype=np.uint8)


def test_a_view_keeps_its_plane_and_grid(image: Image) -> None:
    camera_from_plane = vertical(2.0)
    view = Projector(CAMERA).view(image, camera_from_plane, GRID)
    assert view.image.shape == (GRID.rows, GRID.columns, 3)
    assert view.image.dtype == np.uint8
    assert view.valid.all()
    assert view.grid is GRID
    assert view.camera_from_plane is camera_from_plane


@pytest.mark.parametrize("interpolation", Interpolation)
def test_gray_is_one_channel_of_colour(image: Image, interpolation: Interpolation) -> None:
    projector = Projector(CAMERA)
    colour = projector.view(image, vertical(-2.0, yaw_deg=180.0), GRID, interpolation).image
    gray = projector.view(image[..., 1], vertical(-2.0, yaw_deg=180.0), GRID, interpolation).image
    assert gray.shape == (GRID.rows, GRID.columns)
    # OpenCV may round the channels of one image otherwise than those of another.
    assert np.abs(colour[..., 1].astype(int) - gray).max() <= 1


@pytest.mark.parametrize(
    "camera_from_plane",
    [
        vertical(2.0),
        vertical(-2.0, yaw_deg=170.0),
        vertical(0.5, 1.5, yaw_deg=90.0),
        RigidTransform.from_translation([1.5, -0.5, -1.0]) * PALLET_FROM_HORIZONTAL,
    ],
    ids=["ahead", "across_the_seam", "left", "floor"],
)
@pytest.mark.parametrize("point", [(0.0, 0.15), (-0.41, 0.07), (0.37, 0.22)])
def test_a_spot_on_the_plane_appears_at_its_pixel(
    camera_from_plane: RigidTransform, point: tuple[float, float]
) -> None:
    u, v = CAMERA.project(camera_from_plane.apply([*point, 0.0])).pixels
    columns, rows = np.meshgrid(np.arange(CAMERA.width), np.arange(CAMERA.height))
    across = (columns - u + CAMERA.width / 2) % CAMERA.width - CAMERA.width / 2
    spot = 250 * np.exp(-(across**2 + (rows - v) ** 2) / (2 * 1.5**2))
    view = Projector(CAMERA).view(np.round(spot).astype(np.uint8), camera_from_plane, GRID)
    peak = np.unravel_index(np.argmax(cv2.GaussianBlur(view.image, (0, 0), 1.0)), view.image.shape)
    found = view.grid.points(np.array([peak[1], peak[0]], dtype=np.float64))
    np.testing.assert_allclose(found, point, atol=1.01 * GRID.resolution)


def test_metres_and_pixels_of_a_view_are_inverse(image: Image) -> None:
    grid = Projector(CAMERA).view(image, vertical(2.0), GRID).grid
    pixels = np.random.default_rng(1).uniform(-50, 200, (100, 2))
    np.testing.assert_allclose(grid.pixels(grid.points(pixels)), pixels, atol=1e-9)
    np.testing.assert_allclose(grid.points(np.array([0.0, grid.rows - 1.0])), [-0.6, 0.0], atol=1e-12)


def test_what_the_camera_does_not_see_is_black_and_not_valid() -> None:
    lens = KannalaBrandt(400, 400, 120.0, 120.0, 199.5, 199.5, max_angle=np.radians(80.0))
    white = np.full((400, 400, 3), 255, dtype=np.uint8)
    projector = Projector(lens)
    part = projector.view(white, vertical(0.5, 1.0, yaw_deg=60.0), PlaneGrid.spanning(-2, 2, 0, 1, 0.01))
    assert 0.1 < part.valid.mean() < 0.9
    np.testing.assert_array_equal(part.image == 255, np.repeat(part.valid[..., None], 3, axis=-1))
    behind = projector.view(white, vertical(-2.0, yaw_deg=180.0), GRID)
    assert not behind.valid.any()
    assert not behind.image.any()


class TestCache:
    def test_gives_the_same_table_for_the_same_plane(self, image: Image) -> None:
        projector = Projector(CAMERA)
        first = projector.table(vertical(2.0), GRID)
        assert projector.table(vertical(2.0), PlaneGrid.spanning(-0.6, 0.6, 0.0, 0.3, 0.01)) is first
        assert projector.view(image, vertical(2.0), GRID).valid is first.valid
        assert projector.view(image[..., 0], vertical(2.0), GRID, Interpolation.CUBIC).valid is first.valid

    def test_tells_planes_and_grids_apart(self) -> None:
        projector = Projector(CAMERA)
        first = projector.table(vertical(2.0), GRID)
        assert projector.table(vertical(2.0 + 1e-12), GRID) is not first
        assert projector.table(vertical(2.0), PlaneGrid.spanning(-0.6, 0.6, 0.0, 0.3, 0.02)) is not first

    def test_its_tables_cannot_be_changed(self, image: Image) -> None:
        projector = Projector(CAMERA)
        view = projector.view(image, vertical(2.0), GRID)
        assert not view.valid.flags.writeable
        assert not projector.table(vertical(2.0), GRID).places.flags.writeable
        view.image[:] = 0
        assert projector.view(image, vertical(2.0), GRID).image.any()

    def test_forgets_what_was_used_least_recently(self) -> None:
        size = Projector(CAMERA).table(vertical(2.0), GRID).nbytes
        projector = Projector(CAMERA, cache_bytes=2 * size)
        first, second = projector.table(vertical(2.0), GRID), projector.table(vertical(2.1), GRID)
        assert projector.table(vertical(2.0), GRID) is first
        projector.table(vertical(2.2), GRID)
        assert projector.table(vertical(2.0), GRID) is first
        assert projector.table(vertical(2.1), GRID) is not second

    def test_does_not_keep_a_table_that_is_too_large(self) -> None:
        small = PlaneGrid.spanning(-0.1, 0.1, 0.0, 0.1, 0.02)
        projector = Projector(CAMERA, cache_bytes=Projector(CAMERA).table(vertical(2.0), GRID).nbytes - 1)
        kept = projector.table(vertical(2.0), small)
        assert projector.table(vertical(2.0), GRID) is not projector.table(vertical(2.0), GRID)
        assert projector.table(vertical(2.0), small) is kept


@pytest.mark.parametrize(
    "wrong",
    [
        np.zeros((480, 961, 3), np.uint8),
        np.zeros((960, 480), np.uint8),
        np.zeros((480, 960, 4), np.uint8),
        np.zeros((480, 960, 1), np.uint8),
        np.zeros((480, 960, 3), np.float32),
        np.zeros(480, np.uint8),
    ],
    ids=["width", "turned", "four_channels", "one_channel", "float", "one_axis"],
)
def test_refuses_an_image_that_is_not_the_cameras(wrong: Image) -> None:
    with pytest.raises(ValueError, match=r"images of 960 x 480 pixels, got an array of shape"):
        Projector(CAMERA).view(wrong, vertical(2.0), GRID)
