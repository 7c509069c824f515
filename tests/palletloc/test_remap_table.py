from functools import cache

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from palletloc.cameras import CameraModel, DualFisheye, Equirectangular, FisheyeLens, KannalaBrandt, Pinhole
from palletloc.geometry import BoolArray, FloatArray, Image
from palletloc.plane import PALLET_FROM_HORIZONTAL, PALLET_FROM_VERTICAL, PlaneGrid
from palletloc.remap_table import MAX_ERROR_PX, Interpolation, build_table, exact_map

FISHEYE_TERMS = {"k1": 0.03, "k2": -0.012, "k3": 0.002, "k4": -0.0002}


def dual_lens(cx: float, cy: float) -> KannalaBrandt:
    return KannalaBrandt(1920, 960, 280.0, 282.0, cx, cy, **FISHEYE_TERMS, max_angle=np.radians(96.0))


CAMERAS: dict[str, CameraModel] = {
    "equirectangular": Equirectangular(1920, 960),
    "equirectangular_4k": Equirectangular(3840, 1920),
    "fisheye": KannalaBrandt(1000, 960, 255.0, 257.0, 498.0, 483.0, **FISHEYE_TERMS, max_angle=np.radians(110.0)),
    "pinhole": Pinhole(640, 480, 300.0, 310.0, 322.0, 236.5),
    "brown": Pinhole(800, 600, 420.0, 425.0, 405.0, 296.0, k1=-0.28, k2=0.09, p1=0.002, p2=-0.001, k3=-0.012),
    "dual_fisheye": DualFisheye(
        FisheyeLens(
            dual_lens(478.0, 481.5),
            RigidTransform.from_components([0.012, 0.001, -0.002], Rotation.from_rotvec([0.01, -0.02, 0.005])),
        ),
        FisheyeLens(
            dual_lens(1441.0, 477.0),
            RigidTransform.from_components([-0.013, 0.0, 0.001], Rotation.from_euler("zx", [3.13, 0.02])),
        ),
    ),
}
every_camera = pytest.mark.parametrize("camera", CAMERAS.values(), ids=CAMERAS.keys())


def plane(x: float, y: float, z: float, yaw_deg: float, axes: RigidTransform) -> RigidTransform:
    heading = Rotation.from_euler("z", yaw_deg, degrees=True)
    return RigidTransform.from_components([x, y, z], heading) * axes


PLANES: dict[str, tuple[RigidTransform, PlaneGrid]] = {
    "ahead": (plane(2.5, 0.2, -1.5, 5, PALLET_FROM_VERTICAL), PlaneGrid.spanning(-1, 1, 0, 1, 0.004)),
    "strip": (plane(2.5, 0.2, -1.5, 5, PALLET_FROM_HORIZONTAL), PlaneGrid.spanning(-0.55, 0.55, -0.1, 0.1, 0.004)),
    "near": (plane(0.3, 0.0, -0.2, 10, PALLET_FROM_VERTICAL), PlaneGrid.spanning(-0.4, 0.4, 0, 0.4, 0.002)),
    "grazing": (plane(1.0, 0.05, -0.3, 90, PALLET_FROM_VERTICAL), PlaneGrid.spanning(-2, 2, 0, 0.5, 0.01)),
    "level_with_the_camera": (
        plane(1.5, 0.0, -0.02, 0, PALLET_FROM_HORIZONTAL),
        PlaneGrid.spanning(-1, 1, -1, 1, 0.01),
    ),
    "left_shelf": (plane(1.0, 1.5, -1.2, 90, PALLET_FROM_VERTICAL), PlaneGrid.spanning(-3, 3, 0, 2, 0.01)),
    "behind": (plane(-2.5, 0.2, -1.5, 175, PALLET_FROM_VERTICAL), PlaneGrid.spanning(-1, 1, 0, 2, 0.005)),
    "behind_flat": (
        plane(-2.0, 0.1, -1.0, 180, PALLET_FROM_HORIZONTAL),
        PlaneGrid.spanning(-0.5, 0.5, -0.3, 0.3, 0.004),
    ),
    "straight_below": (
        plane(0.0, 0.0, -1.5, 0, PALLET_FROM_HORIZONTAL),
        PlaneGrid.spanning(-1.5, 1.5, -1.5, 1.5, 0.01),
    ),
    "straight_above": (plane(0.1, 0.0, 1.0, 30, PALLET_FROM_HORIZONTAL), PlaneGrid.spanning(-1, 1, -1, 1, 0.01)),
    "through_the_camera": (plane(0, 0, 0, 20, PALLET_FROM_VERTICAL), PlaneGrid.spanning(-1, 1, -1, 1, 0.01)),
    "far": (plane(40.0, 0.0, -5.0, 0, PALLET_FROM_VERTICAL), PlaneGrid.spanning(-60, 60, 0, 20, 0.2)),
    "one_pixel": (plane(2.0, 0.0, -0.5, 0, PALLET_FROM_VERTICAL), PlaneGrid(0.0, 0.0, 0.01, 1, 1)),
    "one_row": (plane(2.0, 0.0, -0.5, 0, PALLET_FROM_VERTICAL), PlaneGrid(-0.5, 0.0, 0.01, 101, 1)),
    "one_column": (plane(-2.0, 0.0, -0.5, 180, PALLET_FROM_VERTICAL), PlaneGrid(0.0, 0.5, 0.01, 1, 101)),
}


def random_plane(rng: np.random.Generator) -> tuple[RigidTransform, PlaneGrid]:
    columns, rows = (int(10 ** rng.uniform(0, 2.3)) for _ in range(2))
    resolution = 10 ** rng.uniform(-3, -1.5)
    left, top = -resolution * columns * rng.uniform(), resolution * rows * rng.uniform()
    place = Rotation.random(rng=rng).apply([10 ** rng.uniform(-1, 1), 0.0, 0.0])
    pose = RigidTransform.from_components(place, Rotation.random(rng=rng))
    return pose, PlaneGrid(left, top, resolution, columns, rows)


def largest_distance(camera: CameraModel, a: FloatArray, b: FloatArray) -> float:
    """Return how far pixels that both have lie apart at most."""
    difference = a - b
    if camera.period_px is not None:
        difference[..., 0] -= camera.period_px * np.round(difference[..., 0] / camera.period_px)
    distances = np.linalg.norm(difference, axis=-1)
    return float(np.max(distances, initial=0.0, where=np.isfinite(distances)))


def plane_points(camera_from_plane: RigidTransform, grid: PlaneGrid) -> FloatArray:
    columns, rows = np.meshgrid(np.arange(float(grid.columns)), np.arange(float(grid.rows)))
    in_plane = grid.points(np.stack([columns, rows], axis=-1))
    flat = np.concatenate([in_plane, np.zeros((*in_plane.shape[:-1], 1))], axis=-1).reshape(-1, 3)
    return np.asarray(camera_from_plane.apply(flat)).reshape(grid.rows, grid.columns, 3)


@cache
def direction_image(name: str) -> tuple[Image, BoolArray]:
    """Colour every pixel by the direction it looks along, and tell which have only seen ones around them."""
    camera = CAMERAS[name]
    u, v = np.meshgrid(np.arange(float(camera.width)), np.arange(float(camera.height)))
    rays = camera.unproject(np.stack([u, v], axis=-1))
    colours = np.where(rays.valid[..., None], 127.5 + 120 * rays.directions, 0.0)
    seen = rays.valid.astype(np.uint8)
    inside = cv2.erode(seen, np.ones((15, 15), np.uint8), borderType=cv2.BORDER_REPLICATE)
    return np.round(colours).astype(np.uint8), inside.astype(bool)


@every_camera
def test_the_table_is_the_exact_map(camera: CameraModel) -> None:
    for name, (camera_from_plane, grid) in PLANES.items():
        table = build_table(camera, camera_from_plane, grid)
        exact = exact_map(camera, camera_from_plane, grid)
        np.testing.assert_array_equal(table.valid, exact.valid, err_msg=name)
        assert table.complete == exact.valid.all(), name
        assert largest_distance(camera, table.pixels(), exact.pixels) < MAX_ERROR_PX, name
        assert not table.places.flags.writeable
        assert not table.valid.flags.writeable
        assert table.nbytes >= table.places.nbytes + table.valid.nbytes


@every_camera
def test_the_table_is_the_exact_map_of_any_plane(camera: CameraModel) -> None:
    rng = np.random.default_rng(5)
    for _ in range(60):
        camera_from_plane, grid = random_plane(rng)
        table = build_table(camera, camera_from_plane, grid)
        exact = exact_map(camera, camera_from_plane, grid)
        # What is seen between two nodes only may be missed, but nothing is made up.
        assert not (table.valid & ~exact.valid).any()
        assert (table.valid != exact.valid).sum() <= 0.02 * table.valid.size + 16
        assert largest_distance(camera, table.pixels(), exact.pixels) < MAX_ERROR_PX


@every_camera
def test_the_exact_map_projects_the_points_of_the_grid(camera: CameraModel) -> None:
    for name, (camera_from_plane, grid) in PLANES.items():
        exact = exact_map(camera, camera_from_plane, grid)
        expected = camera.project(plane_points(camera_from_plane, grid))
        # Rounding decides for a point in the camera itself, and on which side of the seam a point on it lies.
        assert (exact.valid != expected.valid).sum() <= 1, name
        assert largest_distance(camera, exact.pixels, expected.pixels) < 1e-6, name


@pytest.mark.parametrize("name", ["behind", "behind_flat", "one_column"])
def test_columns_run_on_across_the_seam(name: str) -> None:
    camera = CAMERAS["equirectangular"]
    columns = build_table(camera, *PLANES[name]).pixels()[..., 0]
    assert columns.min() < -0.5 or columns.max() > camera.width - 0.5 or name == "one_column"
    for axis in (0, 1):
        assert np.abs(np.diff(columns, axis=axis)).max(initial=0.0) < 10


SEEN = [
    (camera, plane_name, Interpolation.LINEAR)
    for camera in CAMERAS
    for plane_name in ("ahead", "left_shelf", "behind", "straight_below")
    if plane_name == "ahead" or "equirectangular" in camera or "fisheye" in camera
    if camera != "equirectangular_4k"
    if (camera, plane_name) != ("fisheye", "behind")
]
OTHERS = [("equirectangular", "behind", other) for other in Interpolation if other is not Interpolation.LINEAR]


@pytest.mark.parametrize(("name", "plane_name", "interpolation"), [*SEEN, *OTHERS])
def test_the_view_shows_what_lies_in_each_direction(name: str, plane_name: str, interpolation: Interpolation) -> None:
    camera, (camera_from_plane, grid) = CAMERAS[name], PLANES[plane_name]
    image, seen_around = direction_image(name)
    table = build_table(camera, camera_from_plane, grid)
    view = table.apply(image, interpolation).astype(np.float64)
    assert not view[~table.valid].any()
    columns, rows = np.round(table.pixels()[table.valid]).astype(int).T
    inside = table.valid.copy()
    inside[table.valid] = seen_around[rows.clip(0, camera.height - 1), columns % camera.width]
    assert inside.mean() > 0.1
    points = plane_points(camera_from_plane, grid)[inside]
    along = points - camera.centers(points)
    along /= np.linalg.norm(along, axis=-1, keepdims=True)
    # Two roundings, and for the nearest pixel half a pixel's diagonal.
    tolerance = 1.5 + (0.75 * 120 / 255 if interpolation is Interpolation.NEAREST else 0.0)
    assert np.abs(view[inside] - (127.5 + 120 * along)).max() < tolerance


@pytest.mark.parametrize("interpolation", Interpolation)
@pytest.mark.parametrize(("name", "expected"), [("straight_below", 200), ("straight_above", 40)])
def test_the_image_does_not_wrap_over_the_poles(interpolation: Interpolation, name: str, expected: int) -> None:
    camera = CAMERAS["equirectangular"]
    image = np.full((camera.height, camera.width), 40, dtype=np.uint8)
    image[camera.height // 2 :] = 200
    view = build_table(camera, *PLANES[name]).apply(image, interpolation)
    np.testing.assert_array_equal(np.unique(view), [expected])


@pytest.mark.parametrize("resolution", [0.0005, 0.01])
@pytest.mark.parametrize("interpolation", [Interpolation.LINEAR, Interpolation.CUBIC, Interpolation.LANCZOS])
def test_the_seam_leaves_no_trace(interpolation: Interpolation, resolution: float) -> None:
    camera = CAMERAS["equirectangular"]
    grid = PlaneGrid(-30 * resolution, 30 * resolution, resolution, 61, 61)
    image = np.random.default_rng(0).integers(0, 256, (camera.height, camera.width), dtype=np.uint8)
    behind = build_table(camera, plane(-2.5, 0.0, -0.5, 180, PALLET_FROM_VERTICAL), grid)
    ahead = build_table(camera, plane(2.5, 0.0, -0.5, 0, PALLET_FROM_VERTICAL), grid)
    assert behind.window.columns < camera.width
    assert ahead.window.columns == camera.width
    turned = np.roll(image, camera.width // 2, axis=1)
    difference = np.abs(behind.apply(turned, interpolation).astype(int) - ahead.apply(image, interpolation))
    # OpenCV's weights come in steps of 1/32 px: rounding may put a pixel into the next one.
    assert (difference > 2).mean() < 0.01
    assert difference.max() < 10


@pytest.mark.parametrize("name", ["ahead", "behind", "straight_below"])
def test_nearest_reads_the_very_pixel(name: str) -> None:
    camera = CAMERAS["equirectangular"]
    image = np.random.default_rng(0).integers(0, 256, (camera.height, camera.width), dtype=np.uint8)
    view = build_table(camera, *PLANES[name]).apply(image, Interpolation.NEAREST)
    pixels = exact_map(camera, *PLANES[name]).pixels
    nearest = np.round(pixels).astype(int)
    clear = (np.abs(pixels - nearest) < 0.5 - MAX_ERROR_PX).all(axis=-1)
    assert clear.mean() > 0.7
    expected = image[nearest[..., 1].clip(0, camera.height - 1), nearest[..., 0] % camera.width]
    np.testing.assert_array_equal(view[clear], expected[clear])
