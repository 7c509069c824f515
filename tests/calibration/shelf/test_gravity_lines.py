"""Lines in shots: what plumb and level ones tell of the tilt, and where edges of drawn posts stand."""

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from calibration.drive import relative
from calibration.shelf.front_line import upright_line
from calibration.shelf.gravity_lines import level_direction, level_heading, level_tilt, vertical_tilt
from calibration.shelf.level_view import LevelView, level_view
from calibration.shelf.line_segments import Segments, find_segments
from calibration.shelf.plane import Foot
from calibration.shelf.upright_edges import Edges, find_edges, measure_edges, triangulated
from palletloc.cameras import CameraModel, Equirectangular
from palletloc.geometry import FloatArray, Image
from palletloc.mounting import Mounting
from palletloc.shelf import ShelfPlane
from tests.calibration.expecting import present

TILT = np.radians([0.3, -0.2])


def seen(points: FloatArray, tilt: FloatArray = TILT, noise: float = 0.0, seed: int = 0) -> Segments:
    """Return segments between pairs of points, (n, 2, 3), as a tilted camera sees them."""
    rays = Rotation.from_rotvec([*tilt, 0.0]).apply(points.reshape(-1, 3)).reshape(-1, 2, 3)
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    normals = np.cross(rays[:, 0], rays[:, 1])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    middles = rays.sum(axis=1)
    middles /= np.linalg.norm(middles, axis=1, keepdims=True)
    turned = Rotation.from_rotvec(middles * noise * np.random.default_rng(seed).standard_normal((len(middles), 1)))
    angles = np.arccos((rays[:, 0] * rays[:, 1]).sum(axis=1))
    return Segments(turned.apply(normals), middles, angles, np.full(len(angles), max(noise, 1e-4)))


def posts(azimuths: FloatArray) -> FloatArray:
    foot = 2.0 * np.stack([np.cos(azimuths), np.sin(azimuths)], axis=1)
    return np.stack([np.column_stack([foot, np.full(len(foot), z)]) for z in (-1.5, 0.8)], axis=1)


def shelf_lines(heading: float, heights: tuple[float, ...]) -> FloatArray:
    """Return level edges of a shelf 2 m to the left of a heading."""
    along = np.array([np.cos(heading), np.sin(heading), 0.0])
    aside = np.array([-np.sin(heading), np.cos(heading), 0.0])
    return np.array(
        [
            (a * along + 2 * aside + (0, 0, z), (a + 0.9) * along + 2 * aside + (0, 0, z))
            for z in heights
            for a in (-2.0, -1.0, 0.0, 1.0)
        ]
    )


def test_the_tilt_of_a_camera_is_found_from_plumb_edges() -> None:
    shots = [seen(posts(np.linspace(0.2, 2.9, 12) + 0.1 * k), noise=0.001, seed=k) for k in range(5)]
    found = present(vertical_tilt(shots))
    sigma = np.sqrt(np.diag(np.linalg.inv(found.information)))
    assert np.abs(found.turn - TILT).max() < np.radians(0.03)
    assert (np.abs(found.turn - TILT) < 2 * sigma).all()


def test_edges_that_lean_either_way_do_not_matter() -> None:
    rng = np.random.default_rng(1)
    upright = posts(np.linspace(0.2, 2.9, 16))
    leaning = posts(rng.uniform(-3, 3, 14))
    leaning[:, 1, :2] += rng.uniform(-0.12, 0.12, (14, 2))
    found = present(vertical_tilt([seen(np.concatenate([upright, leaning]), noise=0.0005)]))
    assert np.abs(found.turn - TILT).max() < np.radians(0.06)


def test_edges_in_one_direction_leave_the_tilt_towards_them_open() -> None:
    found = present(vertical_tilt([seen(posts(np.linspace(1.5, 1.64, 10)), noise=0.0003)]))
    about_x, about_y = np.sqrt(np.diag(np.linalg.pinv(found.information)))
    assert about_x > 5 * about_y


def test_too_few_edges_give_nothing() -> None:
    assert vertical_tilt([seen(posts(np.array([0.5, 1.0])))]) is None


@pytest.mark.parametrize("heading", [0.0, 0.4, -2.8])
def test_level_edges_tell_where_the_shelf_points(heading: float) -> None:
    segments = seen(shelf_lines(heading, (-1.8, -1.2, -0.3, 0.9)), tilt=np.zeros(2), noise=0.001)
    found = present(level_direction(segments, heading + 0.03))
    assert found.heading_if_level()[0] == pytest.approx(heading, abs=np.radians(0.2))
    in_odom = present(level_heading([(found, 0.5)]))
    assert np.degrees(abs(np.angle(np.exp(1j * (in_odom[0] - heading - 0.5))))) < 0.2


def test_level_edges_tell_the_tilt_about_the_axis_across_them() -> None:
    segments = seen(shelf_lines(0.0, (-1.8, -1.2, -0.3, 0.9)), noise=0.0005)
    found = present(level_direction(segments, 0.0))
    tilt = present(level_tilt([(found, 0.0)]))
    axis = np.linalg.eigh(tilt.information)[1][:, -1]
    assert axis @ tilt.turn == pytest.approx(axis @ TILT, abs=np.radians(0.08))
    assert np.linalg.eigvalsh(tilt.information)[0] == pytest.approx(0.0, abs=1e-6)


def test_no_level_edges_give_nothing() -> None:
    assert level_direction(seen(posts(np.linspace(0.2, 2.9, 12))), 0.0) is None
    assert level_heading([]) is None
    assert level_tilt([]) is None


def test_segments_lie_where_a_half_space_ends() -> None:
    camera = Equirectangular(1600, 800)
    mounting = Mounting(RigidTransform.from_rotation(Rotation.from_euler("ZYX", [3.0, -2.0, 1.0], degrees=True)))
    normal = np.array([-0.15, 0.3, 1.0]) / np.linalg.norm([-0.15, 0.3, 1.0])
    u, v = np.meshgrid(np.arange(1600.0), np.arange(800.0))
    rays = camera.unproject(np.stack([u, v], axis=-1)).directions
    side = mounting.forklift_from_camera.rotation.apply(rays.reshape(-1, 3)) @ normal
    picture = 110 + 70 * np.clip(side.reshape(800, 1600) / 0.004, -1, 1)  # an edge as wide as a pixel
    found = find_segments(camera, mounting, picture.round().astype(np.uint8), [np.array([1.0, 0.0, -0.1])])
    long = found.lengths > 0.2
    assert long.any()
    off = np.degrees(np.arccos(np.clip(np.abs(found.normals[long] @ normal), 0, 1)))
    assert off.max() < 0.2


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
