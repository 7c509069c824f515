from collections.abc import Callable

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from calibration.targets.board_detection import DuplicateTargetError, detect_markers, find_target
from calibration.targets.observations import observe
from calibration.targets.patches import (
    HALF_FOV,
    cut_patch,
    patch_directions,
    pixel_density,
    sphere_patches,
    view_axes,
)
from calibration.targets.targets import CharucoBoard, SingleTag, facing
from palletloc.cameras import Equirectangular, Pinhole
from palletloc.geometry import Image

PANORAMA = Equirectangular(1920, 960)
NARROW = Pinhole(800, 600, 900.0, 900.0, 399.5, 299.5)
EVEN = CharucoBoard(5, 4, 0.1, 0.075, "DICT_4X4_50")
ODD = CharucoBoard(4, 3, 0.1, 0.075, "DICT_4X4_50", 20)
TAG = SingleTag(0.2, "DICT_APRILTAG_36h11", 5)


def at(x: float, y: float, z: float) -> RigidTransform:
    return facing(np.array([x, y, z]), np.zeros(3), 0.2, 0.1)


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
    sighting = find_target(PANORAMA, detect_markers(PANORAMA, old, EVEN.dictionary, 1.5), EVEN, "B1")
    assert sighting is not None
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
