"""Shots, candidates and what is measured are values; views of a shot, and its exposure."""

import math
from dataclasses import FrozenInstanceError, fields, is_dataclass, replace
from enum import StrEnum

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from palletloc import Candidate, Explanation, Fit, LevelPose, Mounting, PalletModel, Refusal, ShelfPlane, Shot
from palletloc.cameras import CameraModel, DualFisheye, Equirectangular, FisheyeLens, KannalaBrandt, Pinhole
from palletloc.candidate import last_step, steps_of
from palletloc.measurement import Reason, RefusedCandidate, Stage, YawSource
from palletloc.plane import PALLET_FROM_HORIZONTAL, PALLET_FROM_VERTICAL, PlaneGrid
from palletloc.projection import Projector
from palletloc.shot import BRIGHT, MIN_DISTANCE, MOST_GAIN, out_of_sight, points_about, shelf_points
from palletloc.verification import Evidence
from tests.palletloc.poses import Makes, Mounted, Pallets, Portrait

SHELF = ShelfPlane(1.3, 2.02, -np.pi / 2 + 0.01, (0.0,))
POSE = LevelPose(0.9, 2.0, 0.3, np.pi / 2 + 0.02)
EXTENT, RESOLUTION = (-0.6, 0.6, -0.1, 0.25), 0.01
LENS = KannalaBrandt(320, 320, 90.0, 90.0, 159.5, 159.5, 0.01, max_angle=np.radians(97.0))
CAMERAS: dict[str, CameraModel] = {
    "equirectangular": Equirectangular(640, 320),
    "pinhole": Pinhole(320, 240, 210.0, 200.0, 159.5, 119.5, -0.03, 0.004),
    "fisheye": LENS,
    "dual_fisheye": DualFisheye(
        FisheyeLens(replace(LENS, width=640), RigidTransform.from_translation([0.01, 0.0, 0.0])),
        FisheyeLens(replace(LENS, width=640, cx=479.5), LevelPose(-0.01, 0.0, 0.0, np.pi).transform()),
    ),
}


@pytest.fixture(params=CAMERAS)
def shot(request: pytest.FixtureRequest, mounted: Mounted) -> Shot:
    """Return a shot of noise through each kind of camera."""
    camera = CAMERAS[request.param]
    image = np.random.default_rng(0).integers(0, 256, (camera.height, camera.width, 3), dtype=np.uint8)
    return Shot(image, camera, Mounting(mounted(0.3, -0.1, 1.2, 78.0, 15.0, -1.0)), 2.5, "a.png")


def test_a_shot_knows_where_the_camera_is_and_projects_from_its_mounting(shot: Shot) -> None:
    forklift_from_face = POSE.transform() * PALLET_FROM_VERTICAL
    camera = shot.camera_in(POSE)
    np.testing.assert_allclose(forklift_from_face.apply(camera), shot.mounting.center, atol=1e-12)
    matrix = (shot.mounting.to_camera * forklift_from_face).as_matrix()
    np.testing.assert_allclose(shot.camera_from_face(POSE), matrix, atol=1e-12)
    assert shot.camera_in(replace(POSE, yaw=POSE.yaw + np.pi))[2] == pytest.approx(-camera[2])
    points = np.random.default_rng(1).uniform([-1.0, -3.0, 0.0], [3.0, 3.0, 2.0], (2, 30, 3))
    found, expected = shot.project(points), shot.camera.project(shot.mounting.to_camera.apply(points.reshape(-1, 3)))
    np.testing.assert_array_equal(found.valid, expected.valid.reshape(2, 30))
    np.testing.assert_allclose(found.pixels[found.valid], expected.pixels[expected.valid], atol=1e-9)


def test_views_are_what_a_projector_shows_of_the_planes_through_a_pose(shot: Shot) -> None:
    grid = PlaneGrid.spanning(*EXTENT, RESOLUTION)
    views = (shot.vertical_view, PALLET_FROM_VERTICAL), (shot.horizontal_view, PALLET_FROM_HORIZONTAL)
    for view, pallet_from_plane in views:
        camera_from_plane = shot.mounting.to_camera * POSE.transform() * pallet_from_plane
        found = view(POSE, EXTENT, RESOLUTION)
        expected = Projector(shot.camera).view(shot.image, camera_from_plane, grid)
        assert found.grid == grid
        np.testing.assert_allclose(found.camera_from_plane.as_matrix(), camera_from_plane.as_matrix(), atol=1e-12)
        np.testing.assert_array_equal(found.valid, expected.valid)
        assert found.valid.any()
        # rounding of the plane's place may move a pixel by a gray level
        assert np.abs(found.image.astype(int) - expected.image).max() <= 2


@pytest.mark.parametrize("name", ["equirectangular", "pinhole", "fisheye"])
def test_a_point_of_the_face_is_in_the_view_where_it_is_on_the_face(name: str, mounted: Mounted) -> None:
    camera = CAMERAS[name]
    shot = Shot(
        np.zeros((camera.height, camera.width), np.uint8), camera, Mounting(mounted(0.3, -0.1, 1.2, 78.0, 15.0))
    )
    point = np.array([0.2, 0.1])
    column, row = np.rint(shot.project(POSE.transform().apply([0.0, -point[0], point[1]])).pixels).astype(int)
    shot.image[row - 1 : row + 2, column - 1 : column + 2] = 255
    view = shot.vertical_view(POSE, EXTENT, 0.004)
    rows, columns = np.nonzero(view.image > 128)
    found = view.grid.points(np.array([columns.mean(), rows.mean()]))
    np.testing.assert_allclose(found, point, atol=0.015)


def test_openings_are_darker_than_blocks_where_the_model_has_them(portrait: Portrait, epal: PalletModel) -> None:
    pose = replace(POSE, z=0.0)
    view = portrait(epal, pose).vertical_view(pose, (-0.66, 0.66, -0.06, 0.21), 0.004)
    up = epal.openings[0].bottom + epal.openings[0].height / 2
    places = [(left + right) / 2 for left, right in epal.blocks] + [opening.center for opening in epal.openings]
    pixels = np.rint(view.grid.pixels(np.array([[place, up] for place in places]))).astype(int)
    brightness = [view.image[row, column].mean() for column, row in pixels]
    assert max(brightness[len(epal.blocks) :]) < min(brightness[: len(epal.blocks)])


@pytest.mark.parametrize(
    ("camera", "reason"),
    [
        ((0.0, 1.0, 2.0), None),
        ((0.0, 9.0, 2.0), None),  # above: only the way on the floor counts
        ((0.0, 1.0, 0.99 * MIN_DISTANCE), Reason.BEHIND_FACE),
        ((2.0, 1.0, -1.0), Reason.BEHIND_FACE),
        ((3.0, 1.0, 4.1), Reason.OUT_OF_RANGE),
        ((0.0, 1.0, -5.1), Reason.OUT_OF_RANGE),
    ],
)
def test_faces_are_out_of_sight_behind_or_far_away(camera: tuple[float, float, float], reason: Reason | None) -> None:
    assert out_of_sight(np.array(camera), 5.0) is reason


def darkened(shot: Shot, gain: float, noise: float = 0.0) -> Shot:
    random = np.random.default_rng(1).normal(0.0, noise, shot.image.shape) if noise else 0.0
    return replace(shot, image=np.clip(np.rint(shot.image * gain + random), 0, 255).astype(np.uint8))


def test_points_of_a_shelf_and_about_places_lie_on_their_fronts() -> None:
    shelf = ShelfPlane(1.0, 2.0, np.radians(-80.0))
    points = shelf_points(shelf, (0.1, 1.4), 3.0)
    out = np.array([np.cos(shelf.facing), np.sin(shelf.facing)])
    np.testing.assert_allclose((points[:, :2] - [shelf.x, shelf.y]) @ out, 0.0, atol=1e-12)
    assert points[:, 2].min() == pytest.approx(0.1)
    assert 1.2 < points[:, 2].max() <= 1.4
    pose = LevelPose(2.0, 1.5, 0.4, 1.2)
    points = pose.transform().inv().apply(points_about([pose, pose]))
    np.testing.assert_allclose(points[:, 0], 0.0, atol=1e-12)
    assert np.ptp(points[:, 1]) > 1.0


def test_bright_shots_stay_gain_has_an_end_and_what_is_not_seen_needs_none(floor_shot: Shot) -> None:
    points = shelf_points(SHELF, (0.0, 0.5), 3.0)
    bright = floor_shot.exposed_for(points)
    assert bright.exposed_for(points) is bright
    black = replace(floor_shot, image=np.ones_like(floor_shot.image))
    assert black.exposed_for(shelf_points(SHELF, (0.0, 0.5), 3.0)).image.max() == MOST_GAIN
    assert black.exposed_for(np.full((4, 3), np.nan)) is black


def test_a_dark_shot_is_exposed_for_the_shelf_and_not_for_a_lamp(floor_shot: Shot) -> None:
    points = shelf_points(SHELF, (0.0, 0.5), 3.0)
    dark = replace(darkened(floor_shot, 0.2), time=1.5, file="dark.png")
    dark.image[: dark.image.shape[0] // 8] = 255
    before = dark.image.copy()
    found = dark.exposed_for(points)
    pixels = found.project(points).pixels.astype(int)
    values = found.image[pixels[:, 1], pixels[:, 0]].max(axis=-1)
    assert 0.8 * BRIGHT <= np.percentile(values, 98) <= 1.2 * BRIGHT
    assert (found.camera, found.mounting, found.time, found.file) == (dark.camera, dark.mounting, 1.5, "dark.png")
    np.testing.assert_array_equal(dark.image, before)


@pytest.mark.parametrize("gain", [0.25, 0.16])
def test_pallets_are_found_in_the_dark(
    floor_localizer: Makes, floor_shot: Shot, floor_pallets: Pallets, gain: float
) -> None:
    found = floor_localizer().localize(darkened(floor_shot, gain, noise=0.5), SHELF)
    assert len(found) == len(floor_pallets)
    for (model, truth), row in zip(
        sorted(floor_pallets, key=lambda placed: placed[1].x),
        sorted(found, key=lambda measured: measured.forklift_from_pallet.x),
        strict=True,
    ):
        error = np.abs(row.forklift_from_pallet.minus(truth))
        assert row.model == model.name
        assert error[:3].max() < 0.02
        assert error[3] < np.radians(0.6)


# Candidates, fits and refusals.

START, FITTED = LevelPose(1.0, 2.0, 0.0, 1.5), LevelPose(1.02, 2.03, 0.01, 1.52)
EVIDENCE = Evidence(4.0, 0.5, 0.4, 2.0)


@pytest.fixture
def fit(epal: PalletModel) -> Fit:
    return Fit(
        Candidate(epal, START, None, 0.7), FITTED, np.eye(4), YawSource.TOP, steps=("a view", 1, "another view")
    )


@pytest.fixture
def taken() -> Shot:
    mounting = Mounting(LevelPose(0.3, 0.0, 0.0, 0.0).transform())
    return Shot(np.zeros((32, 64), np.uint8), Equirectangular(64, 32), mounting, 2.5, "a.png")


def test_nothing_can_be_written_into_a_shot_or_into_what_is_found_in_it(fit: Fit, taken: Shot) -> None:
    refusal = Refusal(fit.candidate, Stage.VERIFICATION, Reason.FEW_EDGES, fit)
    for value in (taken, fit.candidate, fit, refusal, EVIDENCE, Explanation(taken, (), (), (fit, refusal))):
        assert is_dataclass(value)
        for field in fields(value):
            with pytest.raises(FrozenInstanceError):
                setattr(value, field.name, None)
        assert not hasattr(value, "__dict__")  # nothing can be added, either


def test_a_rank_is_its_score_until_the_checks_and_fits_and_refusals_give_it_alike(fit: Fit) -> None:
    assert fit.rank == fit.candidate.score == 0.7
    checked = replace(fit, evidence=EVIDENCE)
    assert checked.rank == EVIDENCE.probability != 0.7
    before, after = (Refusal(fit.candidate, Stage.POSITION, Reason.NO_PEAK, each) for each in (None, checked))
    assert (before.rank, after.rank) == (0.7, EVIDENCE.probability)
    unseen = Refusal(fit.candidate, Stage.SEARCH, Reason.NO_PEAK)
    for outcome in (fit, replace(fit, evidence=EVIDENCE), unseen):
        assert outcome.likelihood == -math.inf
    assert fit.fit is fit
    assert Refusal(fit.candidate, Stage.VERIFICATION, Reason.OVERLAP, fit).fit is fit
    assert Refusal(fit.candidate, Stage.YAW, Reason.NO_LINE).fit is None


def test_steps_are_found_by_their_kind_and_rows_are_fits_and_refusals_in_their_order(fit: Fit, taken: Shot) -> None:
    for outcome in (fit, Refusal(fit.candidate, Stage.YAW, Reason.NO_LINE, None, fit.steps)):
        assert steps_of(outcome, str) == ["a view", "another view"]
        assert last_step(outcome, str) == "another view"
        assert last_step(outcome, int) == 1
        assert last_step(outcome, float) is None
        assert steps_of(outcome, float) == []
    refusal = Refusal(fit.candidate, Stage.YAW, Reason.NO_LINE, fit)
    explained = Explanation(taken, (), (), (refusal, fit, refusal))
    (row,) = explained.measurements
    assert (row.time, row.model, row.file) == (2.5, "epal", "a.png")
    assert (row.forklift_from_pallet, row.score, row.yaw_from) == (FITTED, 0.7, YawSource.TOP)
    assert row.covariance is fit.covariance
    assert explained.refusals == [RefusedCandidate(2.5, "epal", Stage.YAW, Reason.NO_LINE, "a.png")] * 2


def test_the_sources_of_yaw_are_those_that_files_may_name() -> None:
    assert {str(source) for source in YawSource} == {"bottom", "top", "opening_top", "opening_bottom", "face"}


@pytest.mark.parametrize("codes", [Stage, Reason, YawSource])
def test_codes_are_words_that_a_file_can_hold(codes: type[StrEnum]) -> None:
    for code in codes:
        assert str(code) == code.name.lower()
        assert codes(str(code)) is code
