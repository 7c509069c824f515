from collections.abc import Callable

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from calibration.targets.board_detection import (
    INVERTED,
    MIRRORED,
    DuplicateTargetError,
    detect_markers,
    find_target,
    misprint,
)
from calibration.targets.observations import observe
from calibration.targets.patches import (
    HALF_FOV,
    cut_patch,
    patch_directions,
    pixel_density,
    sphere_patches,
    view_axes,
)
from calibration.targets.targets import CharucoBoard, SingleTag, board_pattern, facing, on_board, patterns
from calibration.targets.texture_alignment import align_corners
from palletloc.cameras import CameraModel, DualFisheye, Equirectangular, FisheyeLens, KannalaBrandt, Pinhole
from palletloc.geometry import FloatArray, Image
from tests.calibration.expecting import present

PANORAMA = Equirectangular(1920, 960)
NARROW = Pinhole(800, 600, 900.0, 900.0, 399.5, 299.5)
EVEN = CharucoBoard(5, 4, 0.1, 0.075, "DICT_4X4_50")
ODD = CharucoBoard(4, 3, 0.1, 0.075, "DICT_4X4_50", 20)
TAG = SingleTag(0.2, "DICT_APRILTAG_36h11", 5)


def at(x: float, y: float, z: float) -> RigidTransform:
    return facing(np.array([x, y, z]), np.zeros(3), 0.2, 0.1)


def test_prints_that_are_wrong_are_told(render: Callable[..., Image]) -> None:
    camera = Pinhole(400, 300, 450.0, 450.0, 199.5, 149.5)
    middle = at(1.3, 0.15, 0.2)
    shot = render(camera, [(EVEN, middle)])
    assert misprint(camera, np.ascontiguousarray(shot[:, ::-1]), EVEN) == MIRRORED
    assert misprint(camera, np.asarray(255 - shot), EVEN) == INVERTED
    assert misprint(camera, shot, EVEN) == ""
    assert misprint(camera, np.ascontiguousarray(shot[:, ::-1]), ODD) == ""


def test_patches_cover_the_sphere_with_room_for_a_marker() -> None:
    rng = np.random.default_rng(0)
    directions = rng.normal(size=(2000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    inside = np.zeros(len(directions), dtype=bool)
    for middle in patch_directions():
        x, y, z = (directions @ view_axes(middle).T).T
        edge = np.tan(HALF_FOV - np.radians(1.5))
        inside |= (z > 0) & (np.abs(x) < edge * z) & (np.abs(y) < edge * z)
    assert inside.all()


@pytest.mark.parametrize("direction", [(1.0, 0.0, 0.0), (0.0, 0.0, 1.0), (0.0, 0.0, -1.0), (-0.3, 0.5, 0.9)])
def test_view_axes_are_right_handed(direction: tuple[float, float, float]) -> None:
    axes = view_axes(np.array(direction))
    np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(axes) == pytest.approx(1.0)


@pytest.mark.parametrize("direction", [(1.0, 0.0, 0.0), (-1.0, 0.0, 0.0), (0.0, 0.0, 1.0), (0.0, 0.6, -0.8)])
def test_a_panorama_is_as_dense_everywhere_as_at_its_equator(direction: tuple[float, float, float]) -> None:
    density = pixel_density(PANORAMA, np.array([direction]))
    assert density[0] == pytest.approx(1920 / (2 * np.pi), rel=0.01)


def test_a_patch_shows_the_shot_across_the_seam() -> None:
    u, v = np.meshgrid(np.arange(1920), np.arange(960))
    x = PANORAMA.unproject(np.stack([u, v], -1).astype(float)).directions[..., 1]
    shot = np.round(128 + 100 * x).astype(np.uint8)
    patch, valid = cut_patch(PANORAMA, shot, np.array([-1.0, 0.0, 0.0]), 300.0)
    columns, rows = np.meshgrid(np.arange(10, 330, 20), np.arange(10, 330, 20))
    expected = 128 + 100 * patch.directions(np.stack([columns, rows], -1))[..., 1]
    assert valid.all()
    assert np.abs(patch.image[rows, columns] - expected).max() < 1.5


def test_a_narrow_camera_needs_few_patches() -> None:
    shot = np.zeros((600, 800), np.uint8)
    assert 1 <= len(list(sphere_patches(NARROW, shot, 1.0))) < 8


@pytest.fixture(scope="module")
def shot(render: Callable[..., Image]) -> Image:
    """Return a panorama with a board across the seam, one ahead and a tag above."""
    hung = [(EVEN, at(-1.0, -0.25, 0.2)), (ODD, at(1.0, 0.2, -0.1)), (TAG, at(0.35, 0.1, 1.0))]
    return render(PANORAMA, hung)


def test_targets_are_found_and_measured_anywhere(shot: Image) -> None:
    told: list[str] = []
    seen = observe(PANORAMA, shot, "a.png", {"seam": EVEN, "ahead": ODD, "above": TAG}, told.append)
    assert [found.target for found in seen] == ["seam", "ahead", "above"]
    assert [len(found.corners.points) for found in seen] == [12, 6, 4]
    for found, pose in zip(seen, (at(-1.0, -0.25, 0.2), at(1.0, 0.2, -0.1), at(0.35, 0.1, 1.0)), strict=True):
        assert np.linalg.norm(found.corners.camera_from_board.translation - pose.translation) < 0.01
    assert not seen[0].pattern.legacy
    assert told


def test_a_legacy_pattern_is_told(render: Callable[..., Image]) -> None:
    old = render(PANORAMA, [(EVEN, at(1.0, 0.3, 0.1))], legacy=True)
    sighting = present(find_target(PANORAMA, detect_markers(PANORAMA, old, EVEN.dictionary, 1.5), EVEN, "B1"))
    assert sighting.pattern.legacy
    assert sighting.markers == 10


def test_a_board_that_hangs_twice_is_refused(render: Callable[..., Image]) -> None:
    twice = render(PANORAMA, [(ODD, at(1.0, 0.2, 0.0)), (ODD, at(0.2, 1.2, 0.0))])
    markers = detect_markers(PANORAMA, twice, ODD.dictionary, 1.5)
    with pytest.raises(DuplicateTargetError, match=r"target B2: .* twice .*expected every id once"):
        find_target(PANORAMA, markers, ODD, "B2")


def test_a_target_that_is_not_there_is_not_found(shot: Image) -> None:
    absent = CharucoBoard(5, 5, 0.1, 0.075, "DICT_4X4_50", 30)
    assert observe(PANORAMA, shot, "a.png", {"absent": absent}) == []


FISHEYE = KannalaBrandt(800, 800, 195.0, 196.0, 398.0, 402.0, 0.02, -0.005, 0.001, 0.0, max_angle=np.radians(108))
DUAL = DualFisheye(
    *(
        FisheyeLens(
            KannalaBrandt(1600, 800, 250.0, 250.0, cx, 400.0, max_angle=np.radians(95)),
            RigidTransform.from_components([x, 0.0, 0.0], Rotation.from_euler("z", yaw, degrees=True)),
        )
        for cx, x, yaw in ((400.0, 0.02, 0), (1200.0, -0.02, 180))
    )
)
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
    shot = render(camera, [(EVEN, pose)])
    aligned = present(align_corners(camera, shot, board_pattern(EVEN), disturbed(pose)))
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
    (seen,) = observe(camera, render(camera, [(EVEN, pose)]), "a.png", {"B1": EVEN})
    assert (seen.markers, len(seen.corners.points)) == (10, 12)
    assert np.linalg.norm(seen.corners.camera_from_board.translation - pose.translation) < 0.002


def test_a_tag_is_aligned_too(render: Callable[..., Image]) -> None:
    tag = SingleTag(0.3, "DICT_APRILTAG_36h11", 5)
    pose = hung((1.0, 0.3, 0.1))
    near = RigidTransform.from_components(pose.translation + 0.004, pose.rotation)
    aligned = present(align_corners(PANORAMA, render(PANORAMA, [(tag, pose)]), patterns(tag)[0], near))
    assert len(aligned.points) == 4
    assert np.sqrt((errors_px(PANORAMA, pose, aligned.points, aligned.pixels) ** 2).mean()) < 0.06


def test_corners_that_are_covered_are_refused(render: Callable[..., Image]) -> None:
    pose = hung((1.0, 0.1, -0.2))
    shot = render(PANORAMA, [(EVEN, pose)])
    pattern = board_pattern(EVEN)
    u, v = PANORAMA.project(pose.apply([0.1, 0.1, 0.0])).pixels.round().astype(int)
    shot[v - 25 : v + 25, u - 25 : u + 25] = 128
    aligned = present(align_corners(PANORAMA, shot, pattern, pose))
    assert 4 <= len(aligned.points) < 12
    assert not (np.abs(aligned.points - [0.1, 0.1]).max(-1) < 1e-9).any()
    assert errors_px(PANORAMA, pose, aligned.points, aligned.pixels).max() < 0.4


@pytest.mark.parametrize("seed", range(2))
def test_nothing_is_measured_where_no_board_is(seed: int) -> None:
    noise = np.random.default_rng(seed).integers(0, 255, (960, 1920)).astype(np.uint8)
    assert align_corners(PANORAMA, noise, board_pattern(EVEN), hung((1.0, 0.1, -0.2))) is None
