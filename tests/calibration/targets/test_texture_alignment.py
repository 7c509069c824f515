from collections.abc import Callable

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from calibration.targets.observations import observe
from calibration.targets.targets import CharucoBoard, SingleTag, board_pattern, facing, on_board, patterns
from calibration.targets.texture_alignment import align_corners
from palletloc.cameras import CameraModel, DualFisheye, Equirectangular, FisheyeLens, KannalaBrandt
from palletloc.geometry import FloatArray, Image

PANORAMA = Equirectangular(1920, 960)
FISHEYE = KannalaBrandt(800, 800, 195.0, 196.0, 398.0, 402.0, 0.02, -0.005, 0.001, 0.0, max_angle=np.radians(108))
TURNED = Rotation.from_euler("z", 180, degrees=True)
DUAL = DualFisheye(
    FisheyeLens(
        KannalaBrandt(1600, 800, 250.0, 250.0, 400.0, 400.0, max_angle=np.radians(95)),
        RigidTransform.from_components([0.02, 0.0, 0.0], Rotation.identity()),
    ),
    FisheyeLens(
        KannalaBrandt(1600, 800, 250.0, 250.0, 1200.0, 400.0, max_angle=np.radians(95)),
        RigidTransform.from_components([-0.02, 0.0, 0.0], TURNED),
    ),
)
BOARD = CharucoBoard(5, 4, 0.1, 0.075, "DICT_4X4_50")
DIRECTIONS: dict[str, tuple[CameraModel, tuple[float, float, float]]] = {
    "ahead": (PANORAMA, (1.0, 0.1, -0.2)),
    "seam": (PANORAMA, (-1.0, 0.15, 0.1)),
    "pole": (PANORAMA, (0.05, 0.05, -1.0)),
    "fisheye": (FISHEYE, (1.0, 0.4, 0.2)),
    "beyond 90 degrees": (FISHEYE, (-0.06, 1.0, 0.1)),
    "far off axis": (FISHEYE, (0.1, 1.0, 0.1)),
    "front lens": (DUAL, (1.0, 0.2, -0.3)),
    "back lens": (DUAL, (-1.0, 0.3, 0.2)),
}


def hung(direction: tuple[float, float, float], distance: float = 1.0) -> RigidTransform:
    """Return a board that is seen with its middle in a direction, turned a little."""
    middle = distance * np.array(direction) / np.linalg.norm(direction)
    pose = facing(middle, np.zeros(3), 0.3, np.arcsin(middle[2] / distance) + 0.1)
    return RigidTransform.from_components(middle - pose.rotation.apply([0.25, 0.2, 0.0]), pose.rotation)


def disturbed(pose: RigidTransform) -> RigidTransform:
    """Return a pose that is a fifth of a square off, and turned."""
    turn = Rotation.from_rotvec([0.01, -0.015, 0.01])
    return RigidTransform.from_components(pose.translation + np.array([0.01, -0.008, 0.012]), pose.rotation * turn)


def errors_px(camera: CameraModel, pose: RigidTransform, points: FloatArray, pixels: FloatArray) -> FloatArray:
    off = pixels - camera.project(pose.apply(on_board(points))).pixels
    if camera.period_px is not None:
        off[:, 0] -= np.round(off[:, 0] / camera.period_px) * camera.period_px
        true = camera.unproject(pixels).directions
        off[:, 0] *= np.hypot(true[:, 0], true[:, 1])  # columns are narrow near the poles
    return np.asarray(np.abs(off))


@pytest.mark.parametrize(("camera", "direction"), DIRECTIONS.values(), ids=DIRECTIONS)
def test_corners_are_exact_to_a_few_hundredths_of_a_pixel(
    camera: CameraModel, direction: tuple[float, float, float], render: Callable[..., Image]
) -> None:
    pose = hung(direction)
    shot = render(camera, [(BOARD, pose)])
    aligned = align_corners(camera, shot, board_pattern(BOARD), disturbed(pose))
    assert aligned is not None
    assert len(aligned.points) == 12
    off = errors_px(camera, pose, aligned.points, aligned.pixels)
    assert np.sqrt((off**2).mean()) < 0.04
    assert off.max() < 0.12
    rays = pose.apply(on_board(aligned.points)) - aligned.origins
    cross = np.linalg.norm(np.cross(rays, aligned.bearings), axis=-1) / np.linalg.norm(rays, axis=-1)
    assert np.sqrt((cross**2).mean() / 2) < 3 * np.median(aligned.sigma)
    assert np.linalg.norm(aligned.camera_from_board.translation - pose.translation) < 0.003


@pytest.mark.parametrize("name", ["fisheye", "far off axis", "front lens", "back lens"])
def test_a_board_is_found_by_fisheye_lenses_too(name: str, render: Callable[..., Image]) -> None:
    camera, direction = DIRECTIONS[name]
    pose = hung(direction, 0.8)
    (seen,) = observe(camera, render(camera, [(BOARD, pose)]), "a.png", {"B1": BOARD})
    assert (seen.markers, len(seen.corners.points)) == (10, 12)
    assert np.linalg.norm(seen.corners.camera_from_board.translation - pose.translation) < 0.002


def test_a_tag_is_aligned_too(render: Callable[..., Image]) -> None:
    tag = SingleTag(0.3, "DICT_APRILTAG_36h11", 5)
    pose = hung((1.0, 0.3, 0.1))
    near = RigidTransform.from_components(pose.translation + 0.004, pose.rotation)
    aligned = align_corners(PANORAMA, render(PANORAMA, [(tag, pose)]), patterns(tag)[0], near)
    assert aligned is not None
    assert len(aligned.points) == 4
    assert np.sqrt((errors_px(PANORAMA, pose, aligned.points, aligned.pixels) ** 2).mean()) < 0.06


def test_corners_that_are_covered_are_refused(render: Callable[..., Image]) -> None:
    pose = hung((1.0, 0.1, -0.2))
    shot = render(PANORAMA, [(BOARD, pose)])
    pattern = board_pattern(BOARD)
    u, v = PANORAMA.project(pose.apply([0.1, 0.1, 0.0])).pixels.round().astype(int)
    shot[v - 25 : v + 25, u - 25 : u + 25] = 128
    aligned = align_corners(PANORAMA, shot, pattern, pose)
    assert aligned is not None
    assert 4 <= len(aligned.points) < 12
    assert not (np.abs(aligned.points - [0.1, 0.1]).max(-1) < 1e-9).any()
    assert errors_px(PANORAMA, pose, aligned.points, aligned.pixels).max() < 0.4


@pytest.mark.parametrize("seed", range(2))
def test_nothing_is_measured_where_no_board_is(seed: int) -> None:
    noise = np.random.default_rng(seed).integers(0, 255, (960, 1920)).astype(np.uint8)
    assert align_corners(PANORAMA, noise, board_pattern(BOARD), hung((1.0, 0.1, -0.2))) is None
