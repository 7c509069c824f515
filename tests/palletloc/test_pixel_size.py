from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from palletloc.cameras import CameraModel, Equirectangular, KannalaBrandt, Pinhole
from palletloc.geometry import FloatArray
from palletloc.plane import PALLET_FROM_HORIZONTAL, PALLET_FROM_VERTICAL
from palletloc.projection import pixel_sizes

CAMERAS: dict[str, CameraModel] = {
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


@pytest.mark.parametrize("camera", CAMERAS.values(), ids=CAMERAS)
@pytest.mark.parametrize(
    "camera_from_plane",
    [
        placed(2.5, 0.2, -0.3, 0.3, PALLET_FROM_VERTICAL),
        placed(2.5, -0.2, -0.9, -0.2, PALLET_FROM_HORIZONTAL),
    ],
    ids=["vertical", "horizontal"],
)
def test_a_pixel_is_as_large_as_moving_points_say(camera: CameraModel, camera_from_plane: RigidTransform) -> None:
    sizes = pixel_sizes(camera, camera_from_plane, POINTS, DIRECTIONS)
    np.testing.assert_allclose(sizes, brute_force(camera, camera_from_plane), rtol=2e-3)


def test_seen_straight_a_pixel_spans_distance_over_focal_length() -> None:
    camera = Pinhole(640, 480, 400.0, 200.0, 319.5, 239.5)
    sizes = pixel_sizes(camera, placed(3.0, 0.0, 0.0, 0.0, PALLET_FROM_VERTICAL), np.zeros((2, 2)), np.eye(2))
    np.testing.assert_allclose(sizes, [3.0 / 400.0, 3.0 / 200.0], rtol=1e-4)


def test_the_seam_of_a_closed_image_is_like_any_other_place() -> None:
    camera = CAMERAS["equirectangular"]
    points = np.stack([np.linspace(-1e-4, 1e-4, 21), np.full(21, 0.1)], -1)
    right = np.broadcast_to([1.0, 0.0], points.shape)
    ahead = pixel_sizes(camera, placed(2.0, 0.0, -0.5, 0.0, PALLET_FROM_VERTICAL), points, right)
    behind = pixel_sizes(camera, placed(-2.0, 0.0, -0.5, np.pi, PALLET_FROM_VERTICAL), points, right)
    np.testing.assert_allclose(behind, ahead, rtol=1e-6)


def test_what_is_not_seen_has_no_finite_size() -> None:
    camera = CAMERAS["pinhole"]
    sizes = pixel_sizes(camera, placed(-2.0, 0.0, 0.0, 0.0, PALLET_FROM_VERTICAL), POINTS, DIRECTIONS)
    assert np.isinf(sizes).all()
    aside = np.array([[0.0, 0.0], [5.0, 0.0]])
    partly = pixel_sizes(camera, placed(2.0, 0.0, 0.0, 0.0, PALLET_FROM_VERTICAL), aside, np.eye(2))
    assert np.isfinite(partly).tolist() == [True, False]
