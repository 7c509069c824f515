from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from palletloc import Fit, LevelPose, Localizer, LocalizerConfig, Method, PalletModel, ShelfPlane, Shot, Start
from palletloc.footprint import overlapping
from palletloc.geometry import level_pose
from palletloc.measurement import PalletMeasurement, Reason, Stage, YawSource
from palletloc.paper.joint_search import JointSearchConfig
from palletloc.shelf_view import ShelfPlaneError
from tests.palletloc.poses import Makes, Pallets, Portrait, slid

SHELF = ShelfPlane(1.3, 2.02, -np.pi / 2 + 0.01, (0.0,))
Rows = list[PalletMeasurement]


@pytest.fixture(scope="module")
def straight(floor_localizer: Makes, floor_shot: Shot) -> Rows:
    """Return what the shot of the floor gives."""
    return floor_localizer().localize(replace(floor_shot, time=1.5, file="a.jpg"), SHELF)


def values(found: Sequence[PalletMeasurement | None]) -> list[tuple[object, ...]]:
    """Measurements as plain values that can be compared."""
    return [
        (row.time, row.model, row.forklift_from_pallet, row.covariance.tolist(), row.score, row.yaw_from, row.file)
        for row in found
        if row is not None
    ]


def by_place(found: Sequence[PalletMeasurement]) -> list[PalletMeasurement]:
    return sorted(found, key=lambda row: row.forklift_from_pallet.x)


def same_poses(found: Sequence[PalletMeasurement], expected: Sequence[PalletMeasurement], sigmas: float) -> None:
    """Check that two shots show the same pallets, within so many of their standard deviations."""
    assert len(found) == len(expected) > 0
    for row, other in zip(by_place(found), by_place(expected), strict=True):
        assert row.model == other.model
        difference = np.abs(row.forklift_from_pallet.minus(other.forklift_from_pallet))
        assert (difference < sigmas * np.sqrt(np.diag(row.covariance + other.covariance))).all()
        assert difference[:3].max() < 0.05
        assert difference[3] < np.radians(1.0)


def test_every_pallet_is_found_once_with_its_model_where_it_is(straight: Rows, floor_pallets: Pallets) -> None:
    assert len(straight) == len(floor_pallets)
    for row, (model, pose) in zip(by_place(straight), floor_pallets, strict=True):
        assert (row.time, row.file, row.model) == (1.5, "a.jpg", model.name)
        error = row.forklift_from_pallet.minus(pose)
        assert (np.abs(error) < 4 * np.sqrt(np.diag(row.covariance))).all()
        assert np.abs(error[:3]).max() < 0.03
        assert abs(error[3]) < np.radians(1.0)
        assert 0.0 < row.score <= 1.0


def test_without_levels_pallets_are_found_where_their_uprights_confirm_the_range(
    floor_localizer: Makes, floor_shot: Shot, floor_pallets: Pallets
) -> None:
    explained = floor_localizer().explain(floor_shot, replace(SHELF, levels=()))
    (plain, pose), (rounded, _) = floor_pallets
    (found,) = explained.measurements
    error = found.forklift_from_pallet.minus(pose)
    assert found.model == plain.name
    assert error @ np.linalg.solve(found.covariance, error) < 25.0
    # of the rounded one half of the uprights are too faint
    uncertain = Reason.UNCERTAIN
    assert any(row.model == rounded.name and row.reason is uncertain for row in explained.refusals)


def test_localize_returns_what_explain_explains_whatever_came_before(
    floor_localizer: Makes, floor_shot: Shot, straight: Rows, blank_shot: Shot
) -> None:
    explained = floor_localizer().explain(replace(floor_shot, time=1.5, file="a.jpg"), SHELF)
    assert values(straight) == values(explained.measurements)
    assert len(explained.detections) == len(explained.outcomes)
    assert len(explained.measurements) + len(explained.refusals) == len(explained.outcomes)
    assert {(row.time, row.file) for row in explained.refusals} == {(1.5, "a.jpg")}
    localizer, shot = floor_localizer(), replace(floor_shot, time=1.5, file="a.jpg")
    localizer.localize(blank_shot, replace(SHELF, y=2.3))
    for _ in range(2):
        assert values(localizer.localize(shot, SHELF)) == values(straight)


def test_a_mirrored_scene_gives_the_mirrored_result(floor_localizer: Makes, floor_shot: Shot, straight: Rows) -> None:
    mirror = np.diag([1.0, -1.0, 1.0, 1.0])
    matrix = mirror @ floor_shot.mounting.forklift_from_camera.as_matrix() @ mirror
    mounting = replace(floor_shot.mounting, forklift_from_camera=RigidTransform.from_matrix(matrix))
    image = np.ascontiguousarray(floor_shot.image[:, ::-1])
    shelf = replace(SHELF, y=-SHELF.y, facing=-SHELF.facing)
    right = floor_localizer().localize(replace(floor_shot, image=image, mounting=mounting), shelf)
    signs = np.array([1.0, -1.0, 1.0, -1.0])
    mirrored = [
        replace(
            row,
            forklift_from_pallet=LevelPose(*(signs * row.forklift_from_pallet.as_array()).tolist()),
            covariance=np.outer(signs, signs) * row.covariance,
        )
        for row in right
    ]
    same_poses(mirrored, straight, 2.0)
    for row, other in zip(by_place(mirrored), by_place(straight), strict=True):
        sizes = np.sqrt(np.diag(row.covariance) / np.diag(other.covariance))
        assert ((sizes > 0.4) & (sizes < 2.5)).all()
        correlations = [c.covariance[0, 1] / np.sqrt(c.covariance[0, 0] * c.covariance[1, 1]) for c in (row, other)]
        assert correlations[0] == pytest.approx(correlations[1], abs=0.3)


@pytest.mark.parametrize("at_the_seam", [0, 1])
def test_a_camera_turned_about_its_axis_gives_the_same_result_even_at_the_seam(
    at_the_seam: int, floor_localizer: Makes, floor_shot: Shot, floor_pallets: Pallets, straight: Rows
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
def test_light_and_colour_matter_little(light: str, floor_localizer: Makes, floor_shot: Shot, straight: Rows) -> None:
    gray = np.asarray(floor_shot.image.mean(axis=2), dtype=np.uint8)
    image = gray if light == "gray" else floor_shot.image // 2
    same_poses(floor_localizer().localize(replace(floor_shot, image=image), SHELF), straight, 2.0)


@pytest.mark.parametrize("levels", [(0.0, 1.5), ()])
def test_noise_gives_no_row(levels: tuple[float, ...], floor_localizer: Makes, blank_shot: Shot) -> None:
    image = np.random.default_rng(0).integers(0, 256, blank_shot.image.shape, dtype=np.uint8)
    explained = floor_localizer().explain(replace(blank_shot, image=image), replace(SHELF, levels=levels))
    assert explained.measurements == []
    assert len(explained.refusals) == len(explained.outcomes)


def test_an_empty_floor_gives_no_row(floor_localizer: Makes, floor_shot: Shot) -> None:
    assert floor_localizer().localize(floor_shot, ShelfPlane(1.3, -2.0, np.pi / 2, (0.0,))) == []


@pytest.mark.parametrize(
    "shelf",
    [replace(SHELF, facing=np.pi / 2), replace(SHELF, y=-1.0), ShelfPlane(0.3, -0.08, -1.5)],
    ids=["facing_away", "behind", "through"],
)
def test_a_camera_not_before_a_shelf_is_an_error(shelf: ShelfPlane, floor_localizer: Makes, floor_shot: Shot) -> None:
    with pytest.raises(ShelfPlaneError, match="shelf: the camera is"):
        floor_localizer().localize(floor_shot, shelf)


def test_a_localizer_needs_a_pallet_and_images_of_its_camera(floor_localizer: Makes, floor_shot: Shot) -> None:
    with pytest.raises(ValueError, match="at least one pallet model"):
        floor_localizer(models=())
    with pytest.raises(ValueError, match="images of 1920 x 960 pixels"):
        floor_localizer().localize(replace(floor_shot, image=floor_shot.image[:, :-2]), SHELF)


def test_no_two_rows_of_a_shot_overlap(floor_localizer: Makes, floor_shot: Shot, t11: PalletModel) -> None:
    models = (*floor_localizer().models.values(), replace(t11, name="t11-too", width=1.12))
    found = floor_localizer(models=models).explain(floor_shot, SHELF)
    kept = [outcome for outcome in found.outcomes if isinstance(outcome, Fit)]
    assert len(kept) == 2
    for i, fit in enumerate(kept):
        for other in kept[:i]:
            assert not overlapping(fit.pose, fit.candidate.model, other.pose, other.candidate.model)


# The same measurements from given starts instead of detections.

COARSE = replace(LocalizerConfig(), joint_search=JointSearchConfig(turns=9, depths=9))


@pytest.mark.parametrize("method", Method)
def test_all_methods_give_results_of_one_form(
    method: Method, floor_localizer: Makes, floor_shot: Shot, floor_pallets: Pallets
) -> None:
    starts = [Start(model.name, pose) for model, pose in floor_pallets]
    explained = floor_localizer(method, config=COARSE).explain_from(
        replace(floor_shot, time=3.0, file="c.jpg"), starts, (0.0,)
    )
    assert [outcome.candidate.model.name for outcome in explained.outcomes] == [start.model for start in starts]
    assert len(explained.measurements) + len(explained.refusals) == len(starts)
    assert explained.measurements
    for row in explained.measurements:
        assert (row.time, row.file) == (3.0, "c.jpg")
        assert row.covariance.shape == (4, 4)
        np.testing.assert_allclose(row.covariance, row.covariance.T, rtol=1e-9, atol=1e-15)
        assert np.linalg.eigvalsh(row.covariance).min() > 0
        assert 0.0 <= row.score <= 1.0
        assert isinstance(row.yaw_from, YawSource)
        truth = next(pose for model, pose in floor_pallets if model.name == row.model)
        assert np.abs(row.forklift_from_pallet.minus(truth)[:3]).max() < 0.1


@pytest.mark.parametrize("above", [0.1442, 0.1440001, 0.05])
def test_a_start_right_before_the_camera_is_refused(
    above: float, floor_localizer: Makes, floor_shot: Shot, t11: PalletModel
) -> None:
    x, y, z = floor_shot.mounting.center.tolist()
    start = Start(t11.name, LevelPose(x, y + 0.4, z - above, np.pi / 2))
    explained = floor_localizer().explain_from(floor_shot, [start])
    assert explained.measurements == []
    assert len(explained.refusals) == 1


def test_starts_are_answered_in_order(floor_localizer: Makes, floor_shot: Shot, floor_pallets: Pallets) -> None:
    (wood, near), (plastic, far) = floor_pallets
    lost = LevelPose(np.nan, 2.0, 0.0, np.pi / 2)
    starts = [
        Start(plastic.name, far),
        Start("no-such-pallet", near),
        Start(wood.name, lost),
        Start(wood.name, near),
        Start(wood.name, near),
    ]
    found = floor_localizer().localize_from(floor_shot, starts, (0.0,))
    assert [None if row is None else row.model for row in found] == [plastic.name, None, None, wood.name, wood.name]
    first, second = found[3:]
    assert first is not None
    assert second is not None
    assert first.forklift_from_pallet == second.forklift_from_pallet
    np.testing.assert_array_equal(first.covariance, second.covariance)
    explained = floor_localizer().explain_from(floor_shot, starts, (0.0,))
    assert [(row.model, row.stage, row.reason) for row in explained.refusals] == [
        ("no-such-pallet", Stage.START, Reason.UNKNOWN_MODEL),
        (wood.name, Stage.START, Reason.NOT_FINITE),
    ]


def test_starts_apart_lead_to_one_pallet(floor_localizer: Makes, floor_shot: Shot, floor_pallets: Pallets) -> None:
    for model, pose in floor_pallets:
        starts = [
            Start(model.name, LevelPose(pose.x + dx, pose.y + dy, pose.z, pose.yaw + turn))
            for dx, dy, turn in ((0.0, 0.0, 0.0), (0.04, 0.03, 0.03), (-0.03, -0.04, -0.05), (0.0, 0.06, 0.04))
        ]
        found = floor_localizer().localize_from(floor_shot, starts, (0.0,))
        assert None not in found
        poses = np.array([row.forklift_from_pallet.as_array() for row in found if row is not None])
        sigma = np.sqrt(np.max([np.diag(row.covariance) for row in found if row is not None], axis=0))
        assert (np.ptp(poses, axis=0) < 2 * sigma).all()


def test_another_place_of_the_forklift_frame_moves_everything_with_it(
    floor_localizer: Makes, floor_shot: Shot, floor_pallets: Pallets
) -> None:
    moved = LevelPose(0.7, -1.1, 0.0, 0.6)  # new frame from old
    mounting = replace(
        floor_shot.mounting, forklift_from_camera=moved.transform() * floor_shot.mounting.forklift_from_camera
    )
    starts = [Start(model.name, pose) for model, pose in floor_pallets]
    there = [Start(s.model, level_pose(moved.transform() * s.forklift_from_pallet.transform())) for s in starts]
    before = floor_localizer().localize_from(floor_shot, starts, (0.0,))
    after = floor_localizer().localize_from(replace(floor_shot, mounting=mounting), there, (0.0,))
    turn = np.eye(4)
    turn[:2, :2] = moved.matrix()[:2, :2]
    for row, other in zip(after, before, strict=True):
        assert row is not None
        assert other is not None
        expected = level_pose(moved.transform() * other.forklift_from_pallet.transform())
        assert np.abs(row.forklift_from_pallet.minus(expected)).max() < 1e-4
        np.testing.assert_allclose(row.covariance, turn @ other.covariance @ turn.T, rtol=0.02, atol=1e-8)


@pytest.mark.parametrize("index", [0, 1])
@pytest.mark.parametrize("along_ray", [-0.25, 0.45])
def test_a_start_far_off_along_the_viewing_ray_leads_to_the_pallet(
    along_ray: float, index: int, floor_localizer: Makes, floor_shot: Shot, floor_pallets: Pallets
) -> None:
    model, pose = floor_pallets[index]
    away = float(np.linalg.norm(pose.as_array()[:3] - floor_shot.mounting.center))
    start = replace(slid(floor_shot, pose, 1 + along_ray / away), z=pose.z, yaw=pose.yaw + np.radians(2.0))
    (found,) = floor_localizer().localize_from(floor_shot, [Start(model.name, start)], (0.0,))
    assert found is not None
    error = np.abs(found.forklift_from_pallet.as_array() - pose.as_array())
    assert error[:3].max() < 0.03
    assert error[3] < np.radians(1.0)


def test_one_localizer_takes_shots_of_any_camera_in_any_order(
    portrait: Portrait, floor_shot: Shot, floor_pallets: Pallets, t11: PalletModel
) -> None:
    pose = LevelPose(0.9, 2.0, 0.0, np.pi / 2 + 0.02)
    given = [(floor_shot, Start("t11", floor_pallets[1][1])), (portrait(t11, pose), Start("t11", pose))]
    localizer = Localizer([t11])
    for shot, start in (*given, *given[::-1]):
        (row,), (alone,) = (each.localize_from(shot, [start], (0.0,)) for each in (localizer, Localizer([t11])))
        assert row is not None
        assert alone is not None
        assert row.forklift_from_pallet == alone.forklift_from_pallet
        np.testing.assert_array_equal(row.covariance, alone.covariance)
