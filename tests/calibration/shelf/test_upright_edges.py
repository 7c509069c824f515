"""Posts drawn by casting rays: a shelf without pallets, seen along a way."""

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from calibration.drive import relative
from calibration.shelf.front_line import upright_line
from calibration.shelf.level_view import LevelView, level_view
from calibration.shelf.plane import Foot
from calibration.shelf.upright_edges import Edges, find_edges, measure_edges, triangulated
from palletloc.cameras import CameraModel, Equirectangular
from palletloc.geometry import FloatArray, Image
from palletloc.mounting import Mounting
from palletloc.shelf import ShelfPlane
from tests.calibration.expecting import present

POSTS = (-1.6, 1.1, 3.8)
WIDTH, DEPTH, FRONT, TOP = 0.1, 0.07, 1.9, 2.6
TURN = float(np.radians(0.7))
MOUNTING = Mounting(
    RigidTransform.from_components([0.2, 0.05, 1.8], Rotation.from_euler("ZYX", [1.5, -1.0, 0.8], degrees=True))
)
POSES = np.stack([np.linspace(0, 2.6, 9), 0.02 * np.sin(np.arange(9)), 0.02 * np.cos(np.arange(9))], axis=1)


def corners(place: float) -> FloatArray:
    """Return the corners of a post on the floor, (4, 2) in odom."""
    local = np.array([[x, y] for x, y in ((0, 0), (WIDTH, 0), (WIDTH, DEPTH), (0, DEPTH))]) + np.array([place, FRONT])
    cos, sin = np.cos(TURN), np.sin(TURN)
    return np.asarray(local @ np.array([[cos, sin], [-sin, cos]]))


def shot(camera: CameraModel, pose: FloatArray, oversampling: int = 2) -> Image:
    """Return what the camera sees: dark posts before a bright wall."""
    count = oversampling
    offsets = (np.arange(count) + 0.5) / count - 0.5
    u = (np.arange(camera.width)[:, None] + offsets).ravel()
    v = np.arange(camera.height, dtype=float)
    rays = camera.unproject(np.stack(np.meshgrid(u, v), axis=-1))
    turned = np.nan_to_num(rays.directions) @ MOUNTING.forklift_from_camera.as_matrix()[:3, :3].T
    azimuth = np.arctan2(turned[..., 1], turned[..., 0])
    tangent = turned[..., 2] / np.maximum(np.hypot(turned[..., 0], turned[..., 1]), 1e-9)
    picture = np.full(azimuth.shape, 190.0)
    for place in POSTS:
        at = relative(pose, np.concatenate([corners(place), np.zeros((4, 1))], axis=1))[:, :2] - MOUNTING.center[:2]
        seen, far = np.arctan2(at[:, 1], at[:, 0]), np.hypot(*at.T)
        inside = (azimuth > seen.min()) & (azimuth < seen.max())
        inside &= (tangent > -MOUNTING.center[2] / far.min()) & (tangent < (TOP - MOUNTING.center[2]) / far.min())
        picture[inside] = 60.0
    picture[~rays.valid] = 0.0
    return np.asarray(picture.reshape(camera.height, camera.width, count).mean(-1).round(), dtype=np.uint8)


def views_of(camera: CameraModel) -> list[LevelView]:
    into = TURN + np.pi / 2
    return [level_view(camera, MOUNTING, shot(camera, pose), float(into - pose[2]), 1.85) for pose in POSES]


@pytest.fixture(scope="module")
def views() -> list[LevelView]:
    return views_of(Equirectangular(1280, 640))


def found_edges(views: list[LevelView], plane: ShelfPlane, depth: float) -> Edges:
    edges = find_edges(views, POSES, plane, depth)
    return triangulated(views, POSES, edges, measure_edges(views, POSES, edges, plane.yaw))[0]


def off_front(edges: Edges) -> tuple[float, float]:
    """Return how far the front is off in distance (metres) and turn (degrees)."""
    foot = Foot(np.array([1.3, 0.0]), np.pi / 2)
    covariance = np.eye(2 * len(edges.vote)) * 1e-5
    line = present(upright_line(edges, edges.places, covariance, foot, float(np.radians(2))))
    front = corners(0.0)[0]
    turn, distance = foot.described(ShelfPlane(float(front[0]), float(front[1]), TURN - np.pi / 2))
    return line.estimate.distance - distance, float(np.degrees(line.estimate.turn - turn))


@pytest.mark.parametrize(("off", "turn_deg", "depth"), [(0.0, 0.0, 0.2), (0.12, 2.0, 0.3), (-0.4, -3.0, 0.6)])
def test_the_front_is_found_around_planes_that_are_off(
    views: list[LevelView], off: float, turn_deg: float, depth: float
) -> None:
    plane = ShelfPlane(1.3, FRONT + off, float(np.radians(turn_deg) - np.pi / 2))
    distance, turn = off_front(found_edges(views, plane, depth))
    assert abs(distance) < 0.01
    assert abs(turn) < 0.3


def test_every_edge_found_is_a_corner_of_a_post(views: list[LevelView]) -> None:
    edges = found_edges(views, ShelfPlane(1.3, FRONT, TURN - np.pi / 2), 0.2)
    real = np.concatenate([corners(place) for place in POSTS])
    tall = edges.places[np.abs(edges.vote) > 0.6]
    nearest = np.linalg.norm(tall[:, None] - real, axis=-1).min(axis=1)
    assert len(tall) >= 6
    assert np.median(nearest) < 0.015
