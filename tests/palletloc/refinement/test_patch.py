from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import RigidTransform, Rotation

from palletloc.cameras import CameraModel, Equirectangular, Pinhole
from palletloc.geometry import FloatArray, Image, LevelPose
from palletloc.measurement import Reason
from palletloc.mounting import Mounting
from palletloc.plane import PALLET_FROM_VERTICAL
from palletloc.refinement.patch import FacePatch, view_patch
from palletloc.shot import MIN_DISTANCE, Shot

CAMERA = Pinhole(480, 320, 300.0, 300.0, 239.5, 159.5)
MOUNTED = RigidTransform.from_components([0.3, -0.1, 1.2], Rotation.from_euler("ZYX", [1.2, 0.25, 0.02]))
BASE = LevelPose(0.9, 2.2, 0.3, 1.4)
EXTENT = (-0.8, 0.8, -0.15, 0.45)
RESOLUTION = 0.006
Paints = Callable[..., Image]


def camera_from_plane(base: LevelPose = BASE) -> FloatArray:
    return np.asarray((MOUNTED.inv() * base.transform() * PALLET_FROM_VERTICAL).as_matrix())


def patch_of(image: Image, camera: CameraModel = CAMERA, base: LevelPose = BASE) -> FacePatch:
    found = view_patch(Shot(image, camera, Mounting(MOUNTED)), base, EXTENT, RESOLUTION)
    assert isinstance(found, FacePatch)
    return found


BLANK = patch_of(np.full((CAMERA.height, CAMERA.width), 90, np.uint8))
small = st.floats(-0.5, 0.5)
poses = st.builds(
    LevelPose,
    small.map(lambda v: BASE.x + v),
    small.map(lambda v: BASE.y + v),
    small.map(lambda v: BASE.z + v),
    st.floats(-0.6, 0.6).map(lambda v: BASE.yaw + v),
)


@given(poses, st.lists(st.tuples(st.floats(-0.6, 0.6), st.floats(0.0, 0.2)), min_size=1, max_size=5))
def test_points_appear_on_the_plane_where_the_camera_sees_them(
    pose: LevelPose, points: list[tuple[float, float]]
) -> None:
    at = np.array(points)
    in_pallet = np.stack([np.zeros(len(at)), -at[:, 0], at[:, 1]], axis=1)
    truth = CAMERA.project(MOUNTED.inv().apply(pose.transform().apply(in_pallet)))
    appearing = BLANK.appearing(pose, at)
    matrix = camera_from_plane()
    found = CAMERA.project(appearing @ matrix[:3, :2].T + matrix[:3, 3])
    np.testing.assert_array_equal(found.valid, truth.valid)
    np.testing.assert_allclose(found.pixels[truth.valid], truth.pixels[truth.valid], atol=1e-6)


def test_on_its_own_plane_every_point_appears_where_it_is() -> None:
    points = np.random.default_rng(0).uniform(-0.5, 0.5, (50, 2))
    np.testing.assert_allclose(BLANK.appearing(BASE, points), points, atol=1e-12)


@given(poses, st.integers(-3, 3))
@settings(max_examples=20)
def test_whole_turns_change_nothing(pose: LevelPose, turns: int) -> None:
    points = np.array([[-0.5, 0.0], [0.4, 0.14]])
    turned = replace(pose, yaw=pose.yaw + 2 * np.pi * turns)
    np.testing.assert_allclose(BLANK.appearing(turned, points), BLANK.appearing(pose, points), atol=1e-9)


def test_a_patch_knows_its_plane_and_where_the_camera_is() -> None:
    np.testing.assert_allclose(BLANK.view.camera_from_plane.as_matrix(), camera_from_plane(), atol=1e-12)
    forklift_from_plane = BASE.transform() * PALLET_FROM_VERTICAL
    np.testing.assert_allclose(forklift_from_plane.apply(BLANK.plane_from_camera), MOUNTED.translation, atol=1e-12)
    assert BLANK.base == BASE


def waves(slope: float) -> Callable[[FloatArray], FloatArray]:
    """Stripes along lines that rise by a slope."""

    def paint(points: FloatArray) -> FloatArray:
        across = (points[..., 1] - slope * points[..., 0]) / np.hypot(1.0, slope)
        return np.asarray(120 + 60 * np.sin(2 * np.pi * across / 0.08))

    return paint


@pytest.mark.parametrize("slope", [-0.35, -0.2, 0.0, 0.12, 0.4])
def test_lines_have_most_energy_along_their_own_slope(slope: float, paint_plane: Paints) -> None:
    patch = patch_of(paint_plane(CAMERA, camera_from_plane(), EXTENT, waves(slope)))
    tried = np.linspace(-0.6, 0.6, 7)
    inside = patch.view.valid.copy()
    inside[:20], inside[-20:], inside[:, :20], inside[:, -20:] = False, False, False, False
    energy = [float(patch.along_level(float(one))[inside].mean()) for one in tried]
    assert tried[int(np.argmax(energy))] == pytest.approx(slope, abs=0.11)
    assert max(energy) > 0.3
    assert (np.diff(energy[: int(np.argmax(energy)) + 1]) > 0).all()
    assert (np.diff(energy[int(np.argmax(energy)) :]) < 0).all()


def test_upright_lines_have_upright_energy_and_level_ones_have_none(paint_plane: Paints) -> None:
    def upright(points: FloatArray) -> FloatArray:
        return np.asarray(120 + 60 * np.sin(2 * np.pi * points[..., 0] / 0.08))

    means = []
    for paint in (upright, waves(0.0)):
        patch = patch_of(paint_plane(CAMERA, camera_from_plane(), EXTENT, paint))
        middle = np.s_[25:-25, 25:-25]
        fields = (patch.upright, patch.along_level(0.0), patch.any_direction)
        means.append([float(field[middle].mean()) for field in fields])
    (upright_up, upright_level, upright_any), (level_up, level_level, level_any) = means
    assert upright_up > 5 * upright_level
    assert level_level > 5 * level_up
    assert min(upright_any, level_any) > 0.2


def test_energy_lies_between_0_and_1_and_in_a_plain_image_there_is_none() -> None:
    noise = np.random.default_rng(0).integers(0, 256, (CAMERA.height, CAMERA.width, 3), dtype=np.uint8)
    for image, most in ((noise, 1.0), (np.full_like(noise, 90), 1e-6)):
        patch = patch_of(image)
        for field in (patch.along_level(0.1), patch.upright, patch.any_direction):
            assert field.shape == patch.view.image.shape[:2]
            assert field.min() >= -1e-6
            assert field.max() <= most + 1e-6


def test_a_fainter_image_has_nearly_the_same_energy(paint_plane: Paints) -> None:
    image = paint_plane(CAMERA, camera_from_plane(), EXTENT, waves(0.1))
    bright, dark = (patch_of(picture).along_level(0.1) for picture in (image, image // 3))
    assert np.corrcoef(bright.ravel(), dark.ravel())[0, 1] > 0.95
    assert dark.mean() > 0.7 * bright.mean()


def test_gray_and_the_same_gray_in_three_channels_agree(paint_plane: Paints) -> None:
    image = paint_plane(CAMERA, camera_from_plane(), EXTENT, waves(0.1))
    gray, colour = (patch_of(picture).any_direction for picture in (image, np.repeat(image[..., None], 3, axis=2)))
    assert np.abs(gray - colour).mean() < 0.05


def test_a_camera_behind_the_plane_or_close_to_it_sees_nothing() -> None:
    shot = Shot(np.zeros((CAMERA.height, CAMERA.width), np.uint8), CAMERA, Mounting(MOUNTED))
    center = np.asarray(MOUNTED.translation)
    into = np.array([np.cos(BASE.yaw), np.sin(BASE.yaw)])
    for distance in (-1.0, 0.0, 0.9 * MIN_DISTANCE):
        x, y = (center[:2] + distance * into).tolist()
        base = replace(BASE, x=x, y=y)
        found = view_patch(shot, base, EXTENT, RESOLUTION)
        assert found is Reason.BEHIND_FACE


def test_a_plane_that_the_image_hardly_shows_is_out_of_view() -> None:
    image = np.zeros((CAMERA.height, CAMERA.width), np.uint8)
    aside = replace(BASE, x=BASE.x + 6.0)
    assert view_patch(Shot(image, CAMERA, Mounting(MOUNTED)), aside, EXTENT, RESOLUTION) is Reason.OUT_OF_VIEW
    sphere = Equirectangular(480, 240)
    whole = np.zeros((240, 480), np.uint8)
    assert isinstance(view_patch(Shot(whole, sphere, Mounting(MOUNTED)), aside, EXTENT, RESOLUTION), FacePatch)
