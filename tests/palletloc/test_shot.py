from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from palletloc.geometry import Image, LevelPose, wrap_angle
from palletloc.localizer import Localizer
from palletloc.pallet import PalletModel
from palletloc.shelf import ShelfPlane
from palletloc.shot import BRIGHT, MOST_GAIN, Shot, brightened, points_about, shelf_points

SHELF = ShelfPlane(1.3, 2.02, -np.pi / 2 + 0.01, (0.0,))
Placed = tuple[PalletModel, LevelPose]


def darkened(image: Image, gain: float, noise: float = 0.0) -> Image:
    random = np.random.default_rng(1).normal(0.0, noise, image.shape) if noise else 0.0
    dark: Image = np.clip(np.rint(image * gain + random), 0, 255).astype(np.uint8)
    return dark


def test_points_of_a_shelf_lie_on_its_front_between_its_heights() -> None:
    shelf = ShelfPlane(1.0, 2.0, np.radians(-80.0))
    points = shelf_points(shelf, (0.1, 1.4), 3.0)
    out = np.array([np.cos(shelf.facing), np.sin(shelf.facing)])
    np.testing.assert_allclose((points[:, :2] - [shelf.x, shelf.y]) @ out, 0.0, atol=1e-12)
    assert points[:, 2].min() == pytest.approx(0.1)
    assert 1.2 < points[:, 2].max() <= 1.4


def test_points_about_places_lie_on_their_faces() -> None:
    pose = LevelPose(2.0, 1.5, 0.4, 1.2)
    points = pose.transform().inv().apply(points_about([pose, pose]))
    np.testing.assert_allclose(points[:, 0], 0.0, atol=1e-12)
    assert np.ptp(points[:, 1]) > 1.0


def test_a_bright_shot_is_left_alone(floor_shot: Shot) -> None:
    points = shelf_points(SHELF, (0.0, 0.5), 3.0)
    camera = floor_shot.camera
    bright = brightened(floor_shot.image, camera, floor_shot.mounting, points)
    assert brightened(bright, camera, floor_shot.mounting, points) is bright


def test_a_dark_shot_is_exposed_for_the_shelf_and_not_for_a_lamp(floor_shot: Shot) -> None:
    points = shelf_points(SHELF, (0.0, 0.5), 3.0)
    dark = darkened(floor_shot.image, 0.2)
    dark[: dark.shape[0] // 8] = 255
    found = brightened(dark, floor_shot.camera, floor_shot.mounting, points)
    pixels = floor_shot.camera.project(floor_shot.mounting.forklift_from_camera.inv().apply(points)).pixels.astype(
        int
    )
    values = found[pixels[:, 1], pixels[:, 0]].max(axis=-1)
    assert 0.8 * BRIGHT <= np.percentile(values, 98) <= 1.2 * BRIGHT


def test_gain_has_an_end_and_what_is_not_seen_needs_none(floor_shot: Shot) -> None:
    camera, mounting = floor_shot.camera, floor_shot.mounting
    black = np.ones_like(floor_shot.image)
    assert brightened(black, camera, mounting, shelf_points(SHELF, (0.0, 0.5), 3.0)).max() == MOST_GAIN
    nowhere = np.full((4, 3), np.nan)
    assert brightened(black, camera, mounting, nowhere) is black


@pytest.mark.parametrize("gain", [0.25, 0.16])
def test_pallets_are_found_in_the_dark(
    floor_localizer: Callable[..., Localizer],
    floor_shot: Shot,
    floor_pallets: tuple[Placed, ...],
    gain: float,
) -> None:
    found = floor_localizer().localize(darkened(floor_shot.image, gain, noise=0.5), 0.0, SHELF)
    assert len(found) == len(floor_pallets)
    for (model, truth), one in zip(
        sorted(floor_pallets, key=lambda placed: placed[1].x),
        sorted(found, key=lambda measured: measured.forklift_from_pallet.x),
        strict=True,
    ):
        error = one.forklift_from_pallet.as_array() - truth.as_array()
        assert one.model == model.name
        assert np.abs(error[:3]).max() < 0.02
        assert abs(wrap_angle(float(error[3]))) < np.radians(0.6)
