from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from palletloc.cameras import CameraModel
from palletloc.candidate import Candidate, ShotView
from palletloc.config import LocalizerConfig, Method
from palletloc.geometry import FloatArray, Image, LevelPose, level_pose, wrap_angle
from palletloc.joint_search import JointSearchConfig
from palletloc.localizer import Localizer, Start, exclude_overlaps, measurement_of
from palletloc.measurement import PalletMeasurement, Reason, Stage, YawSource
from palletloc.mounting import Mounting
from palletloc.pallet import PalletModel
from palletloc.shelf import ShelfPlane
from palletloc.shelf_view import ShelfPlaneError
from palletloc.verification import overlapping

SHELF = ShelfPlane(1.3, 2.02, -np.pi / 2 + 0.01, (0.0,))
CONFIG = replace(LocalizerConfig(), joint_search=JointSearchConfig(turns=9, depths=9))
Placed = tuple[PalletModel, LevelPose]
Makes = Callable[..., Localizer]


@pytest.fixture
def localizer(floor_shot: ShotView, floor_pallets: tuple[Placed, ...]) -> Makes:
    """Return a function that makes a localizer for the camera of the shot of the floor."""

    def make(
        method: Method = Method.HORIZONTAL_PLANE,
        mounting: Mounting = floor_shot.mounting,
        models: Sequence[PalletModel] = tuple(model for model, _ in floor_pallets),
    ) -> Localizer:
        return Localizer(floor_shot.projector.camera, mounting, models, method, CONFIG)

    return make


def values(found: Sequence[PalletMeasurement | None]) -> list[tuple[object, ...]]:
    """Measurements as plain values that can be compared."""
    return [
        (one.time, one.model, one.forklift_from_pallet, one.covariance.tolist(), one.score, one.yaw_from, one.file)
        for one in found
        if one is not None
    ]


def by_place(found: Sequence[PalletMeasurement]) -> list[PalletMeasurement]:
    return sorted(found, key=lambda one: one.forklift_from_pallet.x)


def apart(one: LevelPose, other: LevelPose) -> FloatArray:
    difference = one.as_array() - other.as_array()
    difference[3] = wrap_angle(difference[3])
    return difference


def same_poses(found: Sequence[PalletMeasurement], expected: Sequence[PalletMeasurement], sigmas: float) -> None:
    """Check that two shots show the same pallets, within so many of their standard deviations."""
    assert len(found) == len(expected) > 0
    for one, other in zip(by_place(found), by_place(expected), strict=True):
        assert one.model == other.model
        difference = np.abs(apart(one.forklift_from_pallet, other.forklift_from_pallet))
        assert (difference < sigmas * np.sqrt(np.diag(one.covariance + other.covariance))).all()
        assert difference[:3].max() < 0.05
        assert difference[3] < np.radians(1.0)


def test_every_pallet_is_found_once_with_its_model_where_it_is(
    localizer: Makes, floor_shot: ShotView, floor_pallets: tuple[Placed, ...]
) -> None:
    found = localizer().localize(floor_shot.image, 1.5, SHELF, "a.jpg")
    assert len(found) == len(floor_pallets)
    for one, (model, pose) in zip(by_place(found), floor_pallets, strict=True):
        assert (one.time, one.file, one.model) == (1.5, "a.jpg", model.name)
        error = apart(one.forklift_from_pallet, pose)
        assert (np.abs(error) < 4 * np.sqrt(np.diag(one.covariance))).all()
        assert np.abs(error[:3]).max() < 0.03
        assert abs(error[3]) < np.radians(1.0)
        assert 0.0 < one.score <= 1.0


def test_without_levels_the_same_pallets_are_found(
    localizer: Makes, floor_shot: ShotView, floor_pallets: tuple[Placed, ...]
) -> None:
    found = localizer().localize(floor_shot.image, 0.0, replace(SHELF, levels=()))
    assert len(found) == len(floor_pallets)
    for one, (model, pose) in zip(by_place(found), floor_pallets, strict=True):
        error = apart(one.forklift_from_pallet, pose)
        assert one.model == model.name
        assert error @ np.linalg.solve(one.covariance, error) < 25.0


def test_localize_returns_what_explain_explains(localizer: Makes, floor_shot: ShotView) -> None:
    explained = localizer().explain(floor_shot.image, 2.0, SHELF, "b.jpg")
    assert values(localizer().localize(floor_shot.image, 2.0, SHELF, "b.jpg")) == values(explained.measurements)
    assert len(explained.detections) == len(explained.candidates)
    assert len(explained.measurements) + len(explained.refusals) == len(explained.candidates)
    assert {(one.time, one.file) for one in explained.refusals} == {(2.0, "b.jpg")}


def test_the_same_shot_gives_the_same_result_whatever_came_before(
    localizer: Makes, floor_shot: ShotView, blank_shot: ShotView
) -> None:
    one = localizer()
    first = one.localize(floor_shot.image, 0.0, SHELF)
    one.localize(blank_shot.image, 0.0, replace(SHELF, y=2.3))
    assert values(one.localize(floor_shot.image, 0.0, SHELF)) == values(first)


def test_the_mirrored_scene_gives_the_mirrored_result(localizer: Makes, floor_shot: ShotView) -> None:
    mirror = np.diag([1.0, -1.0, 1.0, 1.0])
    matrix = mirror @ floor_shot.mounting.forklift_from_camera.as_matrix() @ mirror
    mounting = replace(floor_shot.mounting, forklift_from_camera=RigidTransform.from_matrix(matrix))
    image = np.ascontiguousarray(floor_shot.image[:, ::-1])
    shelf = replace(SHELF, y=-SHELF.y, facing=-SHELF.facing)
    right = localizer(mounting=mounting).localize(image, 0.0, shelf)
    left = localizer().localize(floor_shot.image, 0.0, SHELF)
    signs = np.array([1.0, -1.0, 1.0, -1.0])
    mirrored = [
        replace(
            one,
            forklift_from_pallet=LevelPose(*(signs * one.forklift_from_pallet.as_array()).tolist()),
            covariance=np.outer(signs, signs) * one.covariance,
        )
        for one in right
    ]
    same_poses(mirrored, left, 2.0)
    for one, other in zip(by_place(mirrored), by_place(left), strict=True):
        sizes = np.sqrt(np.diag(one.covariance) / np.diag(other.covariance))
        assert ((sizes > 0.5) & (sizes < 2.0)).all()
        correlations = [c.covariance[0, 1] / np.sqrt(c.covariance[0, 0] * c.covariance[1, 1]) for c in (one, other)]
        assert correlations[0] == pytest.approx(correlations[1], abs=0.3)


@pytest.mark.parametrize("columns", [480, 960 - 140])
def test_a_camera_turned_about_its_axis_gives_the_same_result_even_at_the_seam(
    columns: int, localizer: Makes, floor_shot: ShotView
) -> None:
    camera = floor_shot.projector.camera
    turn = LevelPose(0.0, 0.0, 0.0, 2 * np.pi * columns / camera.width).transform()
    mounting = replace(
        floor_shot.mounting, forklift_from_camera=floor_shot.mounting.forklift_from_camera * turn
    )
    image = np.roll(floor_shot.image, columns, axis=1)
    turned = localizer(mounting=mounting).localize(image, 0.0, SHELF)
    same_poses(turned, localizer().localize(floor_shot.image, 0.0, SHELF), 1.0)


def test_another_place_of_the_forklift_frame_moves_everything_with_it(
    localizer: Makes, floor_shot: ShotView
) -> None:
    moved = LevelPose(0.7, -1.1, 0.0, 0.6)  # new frame from old
    mounting = replace(
        floor_shot.mounting, forklift_from_camera=moved.transform() * floor_shot.mounting.forklift_from_camera
    )
    starts = [Start(one.model, one.forklift_from_pallet) for one in localizer().localize(floor_shot.image, 0.0, SHELF)]
    there = [Start(s.model, level_pose(moved.transform() * s.forklift_from_pallet.transform())) for s in starts]
    before = localizer().localize_from(floor_shot.image, 0.0, starts, (0.0,))
    after = localizer(mounting=mounting).localize_from(floor_shot.image, 0.0, there, (0.0,))
    turn = np.eye(4)
    turn[:2, :2] = moved.matrix()[:2, :2]
    for one, other in zip(after, before, strict=True):
        assert one is not None
        assert other is not None
        expected = level_pose(moved.transform() * other.forklift_from_pallet.transform())
        assert np.abs(apart(one.forklift_from_pallet, expected)).max() < 1e-4
        np.testing.assert_allclose(one.covariance, turn @ other.covariance @ turn.T, rtol=0.02, atol=1e-8)


def test_half_the_light_gives_nearly_the_same_poses(localizer: Makes, floor_shot: ShotView) -> None:
    bright, dark = (localizer().localize(image, 0.0, SHELF) for image in (floor_shot.image, floor_shot.image // 2))
    same_poses(dark, bright, 2.0)


def test_gray_gives_nearly_the_same_poses_as_colour(localizer: Makes, floor_shot: ShotView) -> None:
    gray = np.asarray(floor_shot.image.mean(axis=2), dtype=np.uint8)
    same_poses(localizer().localize(gray, 0.0, SHELF), localizer().localize(floor_shot.image, 0.0, SHELF), 2.0)


@pytest.mark.parametrize("fill", ["gray", "black", "white", "noise"])
@pytest.mark.parametrize("levels", [(0.0,), ()], ids=["level", "free"])
def test_an_image_without_pallets_gives_no_row(
    fill: str, levels: tuple[float, ...], localizer: Makes, blank_shot: ShotView
) -> None:
    shape = blank_shot.image.shape
    image: Image = {
        "gray": blank_shot.image,
        "black": np.zeros(shape, np.uint8),
        "white": np.full(shape, 255, np.uint8),
        "noise": np.random.default_rng(0).integers(0, 256, shape, dtype=np.uint8),
    }[fill]
    explained = localizer().explain(image, 0.0, replace(SHELF, levels=levels))
    assert explained.measurements == []
    assert len(explained.refusals) == len(explained.candidates)


def test_an_empty_floor_gives_no_row(localizer: Makes, floor_shot: ShotView) -> None:
    across = ShelfPlane(1.3, -2.0, np.pi / 2, (0.0,))
    assert localizer().localize(floor_shot.image, 0.0, across) == []


@pytest.mark.parametrize("method", Method)
def test_all_methods_give_results_of_one_form(
    method: Method, localizer: Makes, floor_shot: ShotView, floor_pallets: tuple[Placed, ...]
) -> None:
    starts = [Start(model.name, pose) for model, pose in floor_pallets]
    explained = localizer(method).explain_from(floor_shot.image, 3.0, starts, (0.0,), "c.jpg")
    assert [candidate.model.name for candidate in explained.candidates] == [start.model for start in starts]
    assert len(explained.measurements) + len(explained.refusals) == len(starts)
    assert explained.measurements
    for one in explained.measurements:
        assert (one.time, one.file) == (3.0, "c.jpg")
        assert one.covariance.shape == (4, 4)
        np.testing.assert_allclose(one.covariance, one.covariance.T, rtol=1e-9, atol=1e-15)
        assert np.linalg.eigvalsh(one.covariance).min() > 0
        assert 0.0 <= one.score <= 1.0
        assert isinstance(one.yaw_from, YawSource)
        truth = next(pose for model, pose in floor_pallets if model.name == one.model)
        assert np.abs(apart(one.forklift_from_pallet, truth)[:3]).max() < 0.1


@pytest.mark.parametrize("method", Method)
@pytest.mark.parametrize(
    ("broken", "reason"),
    [
        ({"x": np.nan}, Reason.NOT_FINITE),
        ({"yaw": np.inf}, Reason.NOT_FINITE),
        ({"z": np.nan}, Reason.NOT_FINITE),
        ({"x": 0.3, "y": -2.0}, Reason.BEHIND_FACE),
        ({"yaw": -np.pi / 2}, Reason.BEHIND_FACE),
        ({"y": 60.0}, Reason.OUT_OF_RANGE),
        ({"x": -1e200}, Reason.OUT_OF_RANGE),
    ],
    ids=str,
)
def test_a_start_that_cannot_be_used_is_refused(
    method: Method,
    broken: dict[str, float],
    reason: Reason,
    localizer: Makes,
    floor_shot: ShotView,
    floor_pallets: tuple[Placed, ...],
) -> None:
    model, pose = floor_pallets[0]
    explained = localizer(method).explain_from(floor_shot.image, 0.0, [Start(model.name, replace(pose, **broken))])
    assert [one.reason for one in explained.refusals] == [reason]
    assert explained.measurements == []


def test_given_starts_are_answered_one_by_one_in_order(
    localizer: Makes, floor_shot: ShotView, floor_pallets: tuple[Placed, ...]
) -> None:
    (wood, near), (plastic, far) = floor_pallets
    lost = LevelPose(np.nan, 2.0, 0.0, np.pi / 2)
    starts = [
        Start(plastic.name, far),
        Start("no-such-pallet", near),
        Start(wood.name, lost),
        Start(wood.name, near),
        Start(wood.name, near),
    ]
    found = localizer().localize_from(floor_shot.image, 0.0, starts, (0.0,))
    assert [None if one is None else one.model for one in found] == [plastic.name, None, None, wood.name, wood.name]
    assert values(found[3:4]) == values(found[4:5])
    explained = localizer().explain_from(floor_shot.image, 0.0, starts, (0.0,))
    assert [(one.model, one.stage, one.reason) for one in explained.refusals] == [
        ("no-such-pallet", Stage.START, Reason.UNKNOWN_MODEL),
        (wood.name, Stage.START, Reason.NOT_FINITE),
    ]


def test_starts_apart_lead_to_the_same_pallet(
    localizer: Makes, floor_shot: ShotView, floor_pallets: tuple[Placed, ...]
) -> None:
    for model, pose in floor_pallets:
        starts = [
            Start(model.name, LevelPose(pose.x + dx, pose.y + dy, pose.z, pose.yaw + turn))
            for dx, dy, turn in ((0.0, 0.0, 0.0), (0.04, 0.03, 0.03), (-0.03, -0.04, -0.05), (0.0, 0.06, 0.04))
        ]
        found = localizer().localize_from(floor_shot.image, 0.0, starts, (0.0,))
        assert None not in found
        poses = np.array([one.forklift_from_pallet.as_array() for one in found if one is not None])
        sigma = np.sqrt(np.max([np.diag(one.covariance) for one in found if one is not None], axis=0))
        assert (np.ptp(poses, axis=0) < 2 * sigma).all()


@pytest.mark.parametrize(
    "shelf",
    [replace(SHELF, facing=np.pi / 2), replace(SHELF, y=-1.0), ShelfPlane(0.3, -0.08, -1.5)],
    ids=["facing_away", "behind", "through"],
)
def test_a_shelf_that_the_camera_is_not_before_is_an_error(
    shelf: ShelfPlane, localizer: Makes, floor_shot: ShotView
) -> None:
    with pytest.raises(ShelfPlaneError, match="shelf: the camera is"):
        localizer().localize(floor_shot.image, 0.0, shelf)


def test_a_localizer_needs_a_pallet_and_images_of_its_camera(localizer: Makes, floor_shot: ShotView) -> None:
    with pytest.raises(ValueError, match="at least one pallet model"):
        localizer(models=())
    with pytest.raises(ValueError, match="images of 1920 x 960 pixels"):
        localizer().localize(floor_shot.image[:, :-2], 0.0, SHELF)


def candidate(model: PalletModel, x: float, score: float) -> Candidate:
    pose = LevelPose(x, 2.0, 0.0, np.pi / 2)
    return Candidate(model, pose, None, score, pose=pose, covariance=np.eye(4))


def test_of_two_pallets_in_one_place_the_better_stays(epal: PalletModel, t11: PalletModel) -> None:
    weak, strong, aside = candidate(epal, 0.0, 0.5), candidate(t11, 0.3, 0.8), candidate(epal, 1.6, 0.4)
    refused = candidate(epal, 0.0, 0.99)
    refused.refuse(Stage.VERIFICATION, Reason.FEW_EDGES)
    exclude_overlaps([weak, refused, strong, aside])
    assert weak.refusal == (Stage.VERIFICATION, Reason.OVERLAP)
    assert (strong.refusal, aside.refusal) == (None, None)
    assert refused.refusal == (Stage.VERIFICATION, Reason.FEW_EDGES)


def test_what_was_excluded_excludes_nothing(epal: PalletModel) -> None:
    chain = [candidate(epal, 0.8 * i, 0.9 - 0.1 * i) for i in range(3)]
    exclude_overlaps(chain)
    assert [one.refusal is None for one in chain] == [True, False, True]


def test_no_two_rows_of_a_shot_overlap(localizer: Makes, floor_shot: ShotView, t11: PalletModel) -> None:
    alike = replace(t11, name="t11-too", width=1.12)
    models = (*localizer().models.values(), alike)
    found = localizer(models=models).explain(floor_shot.image, 0.0, SHELF)
    kept = [one for one in found.candidates if measurement_of(one, 0.0, "") is not None]
    assert len(kept) == 2
    for i, one in enumerate(kept):
        for other in kept[:i]:
            assert one.pose is not None
            assert other.pose is not None
            assert not overlapping(one.pose, one.model, other.pose, other.model)


def test_a_given_up_candidate_measures_nothing(epal: PalletModel) -> None:
    one = candidate(epal, 0.0, 0.5)
    assert measurement_of(one, 1.0, "d.jpg") is not None
    one.refuse(Stage.YAW, Reason.NO_LINE)
    assert measurement_of(one, 1.0, "d.jpg") is None
    assert measurement_of(Candidate(epal, LevelPose(0.0, 0.0, 0.0, 0.0), None), 1.0, "") is None
