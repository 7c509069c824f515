from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from palletloc.candidate import Fit
from palletloc.footprint import overlapping
from palletloc.geometry import Image, LevelPose
from palletloc.localizer import Localizer
from palletloc.measurement import PalletMeasurement, Reason
from palletloc.pallet import PalletModel
from palletloc.shelf import ShelfPlane
from palletloc.shelf_view import ShelfPlaneError
from palletloc.shot import Shot

SHELF = ShelfPlane(1.3, 2.02, -np.pi / 2 + 0.01, (0.0,))
Placed = tuple[PalletModel, LevelPose]
Makes = Callable[..., Localizer]


@pytest.fixture(scope="module")
def straight(floor_localizer: Makes, floor_shot: Shot) -> list[PalletMeasurement]:
    """Return what the shot of the floor gives."""
    return floor_localizer().localize(replace(floor_shot, time=1.5, file="a.jpg"), SHELF)


def values(found: Sequence[PalletMeasurement | None]) -> list[tuple[object, ...]]:
    """Measurements as plain values that can be compared."""
    return [
        (one.time, one.model, one.forklift_from_pallet, one.covariance.tolist(), one.score, one.yaw_from, one.file)
        for one in found
        if one is not None
    ]


def by_place(found: Sequence[PalletMeasurement]) -> list[PalletMeasurement]:
    return sorted(found, key=lambda one: one.forklift_from_pallet.x)


def same_poses(found: Sequence[PalletMeasurement], expected: Sequence[PalletMeasurement], sigmas: float) -> None:
    """Check that two shots show the same pallets, within so many of their standard deviations."""
    assert len(found) == len(expected) > 0
    for one, other in zip(by_place(found), by_place(expected), strict=True):
        assert one.model == other.model
        difference = np.abs(one.forklift_from_pallet.minus(other.forklift_from_pallet))
        assert (difference < sigmas * np.sqrt(np.diag(one.covariance + other.covariance))).all()
        assert difference[:3].max() < 0.05
        assert difference[3] < np.radians(1.0)


def test_every_pallet_is_found_once_with_its_model_where_it_is(
    straight: list[PalletMeasurement], floor_pallets: tuple[Placed, ...]
) -> None:
    assert len(straight) == len(floor_pallets)
    for one, (model, pose) in zip(by_place(straight), floor_pallets, strict=True):
        assert (one.time, one.file, one.model) == (1.5, "a.jpg", model.name)
        error = one.forklift_from_pallet.minus(pose)
        assert (np.abs(error) < 4 * np.sqrt(np.diag(one.covariance))).all()
        assert np.abs(error[:3]).max() < 0.03
        assert abs(error[3]) < np.radians(1.0)
        assert 0.0 < one.score <= 1.0


def test_without_levels_pallets_are_found_where_their_uprights_confirm_the_range(
    floor_localizer: Makes, floor_shot: Shot, floor_pallets: tuple[Placed, ...]
) -> None:
    explained = floor_localizer().explain(floor_shot, replace(SHELF, levels=()))
    (plain, pose), (rounded, _) = floor_pallets
    (found,) = explained.measurements
    error = found.forklift_from_pallet.minus(pose)
    assert found.model == plain.name
    assert error @ np.linalg.solve(found.covariance, error) < 25.0
    # of the rounded one half of the uprights are too faint
    uncertain = Reason.UNCERTAIN
    assert any(one.model == rounded.name and one.reason is uncertain for one in explained.refusals)


def test_localize_returns_what_explain_explains(
    floor_localizer: Makes, floor_shot: Shot, straight: list[PalletMeasurement]
) -> None:
    explained = floor_localizer().explain(replace(floor_shot, time=1.5, file="a.jpg"), SHELF)
    assert values(straight) == values(explained.measurements)
    assert len(explained.detections) == len(explained.outcomes)
    assert len(explained.measurements) + len(explained.refusals) == len(explained.outcomes)
    assert {(one.time, one.file) for one in explained.refusals} == {(1.5, "a.jpg")}


def test_the_same_shot_gives_the_same_result_whatever_came_before(
    floor_localizer: Makes, floor_shot: Shot, blank_shot: Shot, straight: list[PalletMeasurement]
) -> None:
    localizer, shot = floor_localizer(), replace(floor_shot, time=1.5, file="a.jpg")
    localizer.localize(blank_shot, replace(SHELF, y=2.3))
    for _ in range(2):
        assert values(localizer.localize(shot, SHELF)) == values(straight)


def test_the_mirrored_scene_gives_the_mirrored_result(
    floor_localizer: Makes, floor_shot: Shot, straight: list[PalletMeasurement]
) -> None:
    mirror = np.diag([1.0, -1.0, 1.0, 1.0])
    matrix = mirror @ floor_shot.mounting.forklift_from_camera.as_matrix() @ mirror
    mounting = replace(floor_shot.mounting, forklift_from_camera=RigidTransform.from_matrix(matrix))
    image = np.ascontiguousarray(floor_shot.image[:, ::-1])
    shelf = replace(SHELF, y=-SHELF.y, facing=-SHELF.facing)
    right = floor_localizer().localize(replace(floor_shot, image=image, mounting=mounting), shelf)
    signs = np.array([1.0, -1.0, 1.0, -1.0])
    mirrored = [
        replace(
            one,
            forklift_from_pallet=LevelPose(*(signs * one.forklift_from_pallet.as_array()).tolist()),
            covariance=np.outer(signs, signs) * one.covariance,
        )
        for one in right
    ]
    same_poses(mirrored, straight, 2.0)
    for one, other in zip(by_place(mirrored), by_place(straight), strict=True):
        sizes = np.sqrt(np.diag(one.covariance) / np.diag(other.covariance))
        assert ((sizes > 0.4) & (sizes < 2.5)).all()
        correlations = [c.covariance[0, 1] / np.sqrt(c.covariance[0, 0] * c.covariance[1, 1]) for c in (one, other)]
        assert correlations[0] == pytest.approx(correlations[1], abs=0.3)


@pytest.mark.parametrize("at_the_seam", [0, 1])
def test_a_camera_turned_about_its_axis_gives_the_same_result_even_at_the_seam(
    at_the_seam: int,
    floor_localizer: Makes,
    floor_shot: Shot,
    floor_pallets: tuple[Placed, ...],
    straight: list[PalletMeasurement],
) -> None:
    camera, pose = floor_shot.camera, floor_pallets[at_the_seam][1]
    seen = camera.project(floor_shot.mounting.to_camera.apply([pose.x, pose.y, pose.z]))
    columns = camera.width - round(float(seen.pixels[0]))
    turn = LevelPose(0.0, 0.0, 0.0, 2 * np.pi * columns / camera.width).transform()
    mounting = replace(floor_shot.mounting, forklift_from_camera=floor_shot.mounting.forklift_from_camera * turn)
    image = np.roll(floor_shot.image, columns, axis=1)
    turned = floor_localizer().localize(replace(floor_shot, image=image, mounting=mounting), SHELF)
    same_poses(turned, straight, 1.0)


@pytest.mark.parametrize("light", ["half", "gray"])
def test_half_the_light_or_no_colour_gives_nearly_the_same_poses(
    light: str, floor_localizer: Makes, floor_shot: Shot, straight: list[PalletMeasurement]
) -> None:
    gray = np.asarray(floor_shot.image.mean(axis=2), dtype=np.uint8)
    image = gray if light == "gray" else floor_shot.image // 2
    same_poses(floor_localizer().localize(replace(floor_shot, image=image), SHELF), straight, 2.0)


@pytest.mark.parametrize(
    ("fill", "levels"),
    [("gray", (0.0,)), ("black", (0.0,)), ("white", (0.0,)), ("noise", (0.0, 1.5)), ("noise", ())],
)
def test_an_image_without_pallets_gives_no_row(
    fill: str, levels: tuple[float, ...], floor_localizer: Makes, blank_shot: Shot
) -> None:
    shape = blank_shot.image.shape
    image: Image = {
        "gray": blank_shot.image,
        "black": np.zeros(shape, np.uint8),
        "white": np.full(shape, 255, np.uint8),
        "noise": np.random.default_rng(0).integers(0, 256, shape, dtype=np.uint8),
    }[fill]
    explained = floor_localizer().explain(replace(blank_shot, image=image), replace(SHELF, levels=levels))
    assert explained.measurements == []
    assert len(explained.refusals) == len(explained.outcomes)


def test_an_empty_floor_gives_no_row(floor_localizer: Makes, floor_shot: Shot) -> None:
    across = ShelfPlane(1.3, -2.0, np.pi / 2, (0.0,))
    assert floor_localizer().localize(floor_shot, across) == []


@pytest.mark.parametrize(
    "shelf",
    [replace(SHELF, facing=np.pi / 2), replace(SHELF, y=-1.0), ShelfPlane(0.3, -0.08, -1.5)],
    ids=["facing_away", "behind", "through"],
)
def test_a_shelf_that_the_camera_is_not_before_is_an_error(
    shelf: ShelfPlane, floor_localizer: Makes, floor_shot: Shot
) -> None:
    with pytest.raises(ShelfPlaneError, match="shelf: the camera is"):
        floor_localizer().localize(floor_shot, shelf)


def test_a_localizer_needs_a_pallet_and_images_of_its_camera(floor_localizer: Makes, floor_shot: Shot) -> None:
    with pytest.raises(ValueError, match="at least one pallet model"):
        floor_localizer(models=())
    with pytest.raises(ValueError, match="images of 1920 x 960 pixels"):
        floor_localizer().localize(replace(floor_shot, image=floor_shot.image[:, :-2]), SHELF)


def test_no_two_rows_of_a_shot_overlap(floor_localizer: Makes, floor_shot: Shot, t11: PalletModel) -> None:
    alike = replace(t11, name="t11-too", width=1.12)
    models = (*floor_localizer().models.values(), alike)
    found = floor_localizer(models=models).explain(floor_shot, SHELF)
    kept = [outcome for outcome in found.outcomes if isinstance(outcome, Fit)]
    assert len(kept) == 2
    for i, fit in enumerate(kept):
        for other in kept[:i]:
            assert not overlapping(fit.pose, fit.candidate.model, other.pose, other.candidate.model)
