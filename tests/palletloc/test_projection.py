import cv2
import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from palletloc import LevelPose
from palletloc.cameras import CameraModel, Equirectangular, KannalaBrandt, Pinhole
from palletloc.geometry import FloatArray, Image
from palletloc.plane import PALLET_FROM_HORIZONTAL, PALLET_FROM_VERTICAL, PlaneGrid, place_plane
from palletloc.projection import MAX_ERROR_PX, Interpolation, Projector, coarse_table, pixel_sizes
from palletloc.remap_table import RemapTable, exact_map
from tests.palletloc.poses import Mounted

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
def test_a_spot_on_a_plane_is_at_its_pixel(camera_from_plane: RigidTransform, point: tuple[float, float]) -> None:
    u, v = CAMERA.project(camera_from_plane.apply([*point, 0.0])).pixels
    columns, rows = np.meshgrid(np.arange(CAMERA.width), np.arange(CAMERA.height))
    across = (columns - u + CAMERA.width / 2) % CAMERA.width - CAMERA.width / 2
    spot = 250 * np.exp(-(across**2 + (rows - v) ** 2) / (2 * 1.5**2))
    view = Projector(CAMERA).view(np.round(spot).astype(np.uint8), camera_from_plane, GRID)
    peak = np.unravel_index(np.argmax(cv2.GaussianBlur(view.image, (0, 0), 1.0)), view.image.shape)
    found = view.grid.points(np.array([peak[1], peak[0]], dtype=np.float64))
    np.testing.assert_allclose(found, point, atol=1.01 * GRID.resolution)


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


# Coarse tables.

SHELF = PlaneGrid.spanning(-2.0, 4.0, -0.3, 0.9, 0.012)


def beside(mounted: Mounted, distance: float, yaw_deg: float = 3.0) -> RigidTransform:
    """The camera's view of a plane on its left, the camera turned in its mounting."""
    camera_from_forklift = mounted(0.3, -0.1, 1.8, yaw_deg, 1.0, -0.5).inv()
    return place_plane(camera_from_forklift, LevelPose(0.3, distance - 0.1, 0.0, np.pi / 2), PALLET_FROM_VERTICAL)


def off_px(table: RemapTable, camera: CameraModel, camera_from_plane: RigidTransform, grid: PlaneGrid) -> FloatArray:
    exact = exact_map(camera, camera_from_plane, grid)
    away = (table.pixels() - exact.pixels)[table.valid & exact.valid]
    if camera.period_px is not None:
        away[:, 0] -= camera.period_px * np.round(away[:, 0] / camera.period_px)
    lengths: FloatArray = np.linalg.norm(away, axis=-1)
    return lengths


@pytest.mark.parametrize("size", [(1920, 960), (3840, 1920)])
@pytest.mark.parametrize("distance", [0.4, 0.8, 1.6, 3.0])
@pytest.mark.parametrize("yaw_deg", [3.0, -90.0], ids=["ahead", "across_the_seam"])
def test_a_coarse_table_is_within_its_error_of_the_exact_map(
    size: tuple[int, int], distance: float, yaw_deg: float, mounted: Mounted
) -> None:
    camera, camera_from_plane = Equirectangular(*size), beside(mounted, distance, yaw_deg)
    table = coarse_table(Projector(camera), camera_from_plane, SHELF)
    assert table.complete
    assert table.places.shape == (SHELF.rows, SHELF.columns, 2)
    assert off_px(table, camera, camera_from_plane, SHELF).max() < 1.1 * MAX_ERROR_PX


def test_an_ordinary_table_is_coarse_shows_the_same_and_cannot_be_written(mounted: Mounted) -> None:
    camera, camera_from_plane = Equirectangular(3840, 1920), beside(mounted, 1.9)
    projector = Projector(camera)
    table, exact = coarse_table(projector, camera_from_plane, SHELF), projector.table(camera_from_plane, SHELF)
    assert (
        off_px(table, camera, camera_from_plane, SHELF).max() > off_px(exact, camera, camera_from_plane, SHELF).max()
    )
    columns, rows = np.meshgrid(np.arange(3840), np.arange(1920))
    image = (127 + 60 * np.sin(columns / 40) + 60 * np.sin(rows / 40)).astype(np.uint8)
    shown = [each.apply(image, Interpolation.LINEAR).astype(int) for each in (table, exact)]
    assert np.abs(shown[0] - shown[1]).max() < 4
    table = coarse_table(Projector(Equirectangular(1920, 960)), beside(mounted, 2.0), SHELF)
    assert not table.places.flags.writeable


def test_where_the_camera_does_not_see_all_of_the_plane_the_exact_table_is_taken(mounted: Mounted) -> None:
    camera, camera_from_plane = Pinhole(640, 480, 400.0, 400.0, 319.5, 239.5), beside(mounted, 1.5, 85.0)
    projector = Projector(camera)
    table = coarse_table(projector, camera_from_plane, SHELF)
    assert table is projector.table(camera_from_plane, SHELF)
    assert not table.complete
    assert table.valid.any()


# The size of a pixel on a plane.

LENSES: dict[str, CameraModel] = {
    "equirectangular": Equirectangular(1920, 960),
    "pinhole": Pinhole(640, 480, 420.0, 400.0, 319.5, 239.5, -0.03, 0.004),
    "fisheye": KannalaBrandt(800, 800, 240.0, 240.0, 399.5, 399.5, 0.01, max_angle=np.radians(97.0)),
}
POINTS = np.random.default_rng(0).uniform([-0.6, 0.0], [0.6, 0.2], (12, 2))
TURNS = np.random.default_rng(1).uniform(-np.pi, np.pi, 12)
DIRECTIONS = np.stack([np.cos(TURNS), np.sin(TURNS)], -1)


def placed(x: float, y: float, z: float, heading: float, plane: RigidTransform) -> RigidTransform:
    return RigidTransform.from_components([x, y, z], Rotation.from_euler("z", heading)) * plane


def brute_force(camera: CameraModel, camera_from_plane: RigidTransform) -> FloatArray:
    """How far a millimetre on the plane, half of it to each side, moves in the image."""
    step = 5e-4
    ends = []
    for side in (-1, 1):
        on_plane = POINTS + side * step * DIRECTIONS
        points = camera_from_plane.apply(np.pad(on_plane, ((0, 0), (0, 1))))
        ends.append(camera.project(points).pixels)
    size: FloatArray = 2 * step / np.linalg.norm(ends[1] - ends[0], axis=-1)
    return size


@pytest.mark.parametrize("camera", LENSES.values(), ids=LENSES)
@pytest.mark.parametrize(
    "camera_from_plane",
    [placed(2.5, 0.2, -0.3, 0.3, PALLET_FROM_VERTICAL), placed(2.5, -0.2, -0.9, -0.2, PALLET_FROM_HORIZONTAL)],
    ids=["vertical", "horizontal"],
)
def test_a_pixel_is_as_large_as_moving_points_say(camera: CameraModel, camera_from_plane: RigidTransform) -> None:
    sizes = pixel_sizes(camera, camera_from_plane, POINTS, DIRECTIONS)
    np.testing.assert_allclose(sizes, brute_force(camera, camera_from_plane), rtol=2e-3)


def test_seen_straight_a_pixel_spans_distance_over_focal_length() -> None:
    camera = Pinhole(640, 480, 400.0, 200.0, 319.5, 239.5)
    sizes = pixel_sizes(camera, placed(3.0, 0.0, 0.0, 0.0, PALLET_FROM_VERTICAL), np.zeros((2, 2)), np.eye(2))
    np.testing.assert_allclose(sizes, [3.0 / 400.0, 3.0 / 200.0], rtol=1e-4)


def test_the_seam_is_like_any_other_place_and_what_is_not_seen_has_no_finite_size() -> None:
    camera = LENSES["equirectangular"]
    points = np.stack([np.linspace(-1e-4, 1e-4, 21), np.full(21, 0.1)], -1)
    right = np.broadcast_to([1.0, 0.0], points.shape)
    ahead = pixel_sizes(camera, placed(2.0, 0.0, -0.5, 0.0, PALLET_FROM_VERTICAL), points, right)
    behind = pixel_sizes(camera, placed(-2.0, 0.0, -0.5, np.pi, PALLET_FROM_VERTICAL), points, right)
    np.testing.assert_allclose(behind, ahead, rtol=1e-6)
    camera = LENSES["pinhole"]
    sizes = pixel_sizes(camera, placed(-2.0, 0.0, 0.0, 0.0, PALLET_FROM_VERTICAL), POINTS, DIRECTIONS)
    assert np.isinf(sizes).all()
    aside = np.array([[0.0, 0.0], [5.0, 0.0]])
    partly = pixel_sizes(camera, placed(2.0, 0.0, 0.0, 0.0, PALLET_FROM_VERTICAL), aside, np.eye(2))
    assert np.isfinite(partly).tolist() == [True, False]
