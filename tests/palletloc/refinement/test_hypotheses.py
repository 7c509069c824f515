from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import RigidTransform, Rotation

from palletloc import LevelPose, Mounting, Opening, PalletModel, Shot
from palletloc.cameras import CameraModel, Equirectangular, Pinhole
from palletloc.geometry import FloatArray, Image, wrap_angle
from palletloc.measurement import Reason
from palletloc.plane import PALLET_FROM_VERTICAL
from palletloc.refinement import hypotheses
from palletloc.refinement.hypotheses import HypothesisGrid, SearchConfig, score_hypotheses, score_pose
from palletloc.refinement.patch import FacePatch, view_patch
from palletloc.refinement.samples import face_samples
from palletloc.shot import MIN_DISTANCE
from tests.palletloc.poses import POSE, Paints, Portrait, blanked, moved, slid

CONFIG = SearchConfig()
EVERY = SearchConfig(kept=10_000, peaks=12, min_score=-1e3, min_share=-1e3, apart=1e-9, apart_deg=1e-9)
EXTENT = (-0.95, 0.95, -0.25, 0.45)


def patch_at(shot: Shot, base: LevelPose, resolution: float = 0.005) -> FacePatch:
    found = view_patch(shot, base, EXTENT, resolution)
    assert not isinstance(found, Reason)
    return found


def grid_of(
    turns_deg: FloatArray, ranges: FloatArray, places: FloatArray, rises: FloatArray | None = None
) -> HypothesisGrid:
    heights = np.zeros(1) if rises is None else rises
    return HypothesisGrid(np.radians(turns_deg), ranges, places, heights, rises is not None)


LOW = Opening(center=0.0, width=0.3, bottom=0.05, height=0.03)
SINGLE = grid_of(np.zeros(1), np.ones(1), np.zeros(1))
WIDE = grid_of(np.linspace(-20, 20, 21), np.linspace(0.85, 1.15, 31), np.linspace(-0.06, 0.06, 13))


def nearest(found: hypotheses.HypothesisScores, truth: LevelPose) -> tuple[float, float]:
    """How far the nearest peak is from the truth, in metres and degrees."""
    away = []
    for peak in found.peaks:
        apart = peak.pose.as_array() - truth.as_array()
        away.append((float(np.linalg.norm(apart[:3])), abs(float(np.degrees(wrap_angle(apart[3]))))))
    return min(away)


@pytest.mark.parametrize(
    "motion",
    [
        {"right": 0.04},
        {"right": -0.04},
        {"up": 0.03},
        {"up": -0.03},
        {"depth": 0.12},
        {"depth": -0.12},
        {"turn_deg": 8.0},
        {"turn_deg": -8.0},
        {"right": 0.53},
        {"right": -0.53},
        {"right": 0.3, "depth": 0.1},
    ],
    ids=str,
)
def test_the_true_pose_scores_best(model: PalletModel, motion: dict[str, float], portrait: Portrait) -> None:
    patch = patch_at(portrait(model, POSE), POSE)
    assert score_pose(patch, model, POSE) > score_pose(patch, model, moved(POSE, **motion)) + 0.05


def test_scores_are_at_most_1_and_a_pallet_is_far_from_nothing(model: PalletModel, portrait: Portrait) -> None:
    shot = portrait(model, POSE)
    assert 0.4 < score_pose(patch_at(shot, POSE), model, POSE) <= 1.0
    assert abs(score_pose(patch_at(blanked(shot), POSE), model, POSE)) < 1e-6


@pytest.mark.parametrize("off", [{"right": 0.05}, {"depth": 0.1}, {"up": 0.03, "depth": -0.1}], ids=str)
def test_a_pose_scores_alike_on_any_plane_nearby(off: dict[str, float], portrait: Portrait, t11: PalletModel) -> None:
    shot = portrait(t11, POSE)
    here = score_pose(patch_at(shot, POSE), t11, POSE)
    assert score_pose(patch_at(shot, moved(POSE, **off)), t11, POSE) == pytest.approx(here, abs=0.12)


@pytest.mark.parametrize("right", [0.0, 0.0025, -0.0125])
def test_a_single_hypothesis_is_scored_as_its_pose_is(right: float, portrait: Portrait, t11: PalletModel) -> None:
    shot = portrait(t11, POSE)
    base = moved(POSE, right=right)
    patch = patch_at(shot, base)
    (peak,) = score_hypotheses(patch, t11, SINGLE, EVERY).peaks[:1]
    np.testing.assert_allclose(peak.pose.as_array(), base.as_array(), atol=1e-9)
    # a point half-way between two pixels may be read from either
    assert peak.score == pytest.approx(score_pose(patch, t11, base), abs=3e-3)


@pytest.mark.parametrize(("depth", "turn_deg"), [(0.0, 0.0), (0.2, 10.0), (-0.2, -10.0), (0.2, -10.0)])
def test_wide_grids_peak_at_the_truth(model: PalletModel, depth: float, turn_deg: float, portrait: Portrait) -> None:
    shot = portrait(model, POSE)
    base = replace(moved(slid(shot, POSE, 1 + depth / 2.2), turn_deg=turn_deg), z=POSE.z)
    metres, degrees = nearest(score_hypotheses(patch_at(shot, base), model, WIDE, CONFIG), POSE)
    assert metres < 0.08
    assert degrees < 4.0


def test_peaks_stand_apart_the_best_first(portrait: Portrait, t11: PalletModel) -> None:
    patch = patch_at(portrait(t11, POSE), moved(POSE, depth=0.05, turn_deg=4.0))
    found = score_hypotheses(patch, t11, WIDE, replace(CONFIG, peaks=8, min_share=0.1))
    assert 2 <= len(found.peaks) <= 8
    scores = [peak.score for peak in found.peaks]
    assert scores == sorted(scores, reverse=True)
    assert max(scores) <= 1.0
    for number, peak in enumerate(found.peaks):
        for other in found.peaks[:number]:
            apart = np.abs(peak.pose.as_array() - other.pose.as_array())
            # polishing may bring them nearer by a part of the grid's step
            assert np.linalg.norm(apart[:3]) > 0.5 * CONFIG.apart or np.degrees(apart[3]) > 0.4 * CONFIG.apart_deg


def test_what_agrees_too_little_is_no_peak(portrait: Portrait, t11: PalletModel) -> None:
    shot = portrait(t11, POSE)
    patch = patch_at(shot, POSE)
    assert score_hypotheses(patch, t11, WIDE, replace(CONFIG, min_score=1.01)).peaks == ()
    assert score_hypotheses(patch_at(blanked(shot), POSE), t11, WIDE, CONFIG).peaks == ()
    kept = score_hypotheses(patch, t11, WIDE, replace(CONFIG, min_share=0.999)).peaks
    assert len(kept) == 1
    assert len(score_hypotheses(patch, t11, WIDE, replace(CONFIG, peaks=2, min_share=0.1)).peaks) <= 2


def test_the_table_shows_where_the_truth_is(portrait: Portrait, epal: PalletModel) -> None:
    shot = portrait(epal, POSE)
    base = replace(moved(slid(shot, POSE, 1.1), turn_deg=6.0), z=POSE.z)
    found = score_hypotheses(patch_at(shot, base), epal, WIDE, CONFIG)
    assert found.score.shape == (len(WIDE.turns), len(WIDE.ranges))
    assert found.grid is WIDE
    turn, distance = np.unravel_index(int(found.score.argmax()), found.score.shape)
    assert np.degrees(WIDE.turns[turn]) == pytest.approx(-6.0, abs=3.0)
    assert WIDE.ranges[distance] == pytest.approx(1 / 1.1, abs=0.03)


@pytest.mark.parametrize("sliding", [False, True], ids=["on_its_level", "sliding"])
def test_hypotheses_lie_on_the_viewing_ray_of_the_start(sliding: bool, portrait: Portrait, t11: PalletModel) -> None:
    shot = portrait(t11, POSE)
    grid = replace(grid_of(np.zeros(1), np.array([0.8, 0.9, 1.0, 1.1]), np.zeros(1)), sliding=sliding)
    found = score_hypotheses(patch_at(shot, POSE), t11, grid, EVERY)
    center = shot.mounting.center
    ray = POSE.as_array()[:3] - center
    assert found.peaks
    for peak in found.peaks:
        reached = peak.pose.as_array()[:3] - center
        part = float(np.hypot(*reached[:2]) / np.hypot(*ray[:2]))
        assert 0.7 < part < 1.2
        np.testing.assert_allclose(reached[:2], part * ray[:2], atol=1e-9)
        height = part * ray[2] if sliding else ray[2]
        assert reached[2] == pytest.approx(height, abs=1e-9)
        assert peak.pose.yaw == pytest.approx(POSE.yaw)


@pytest.mark.parametrize("rise", [-0.05, 0.05])
def test_where_no_level_is_known_the_height_is_found_too(rise: float, portrait: Portrait, epal: PalletModel) -> None:
    shot = portrait(epal, POSE)
    grid = grid_of(np.zeros(1), np.array([0.95, 1.0, 1.05]), np.zeros(1), np.linspace(-0.1, 0.1, 17))
    found = score_hypotheses(patch_at(shot, moved(POSE, up=rise)), epal, grid, CONFIG)
    best = found.peaks[0].pose
    # what is lower on the image's ray may as well be nearer: only the place across the ray is certain
    ray = POSE.as_array()[:3] - shot.mounting.center
    apart = best.as_array()[:3] - POSE.as_array()[:3]
    across = apart - (apart @ ray) / (ray @ ray) * ray
    assert np.linalg.norm(across) < 0.02


@pytest.mark.parametrize("part", [0.93, 1.08])
def test_from_another_height_a_pallet_is_found_on_its_ray(part: float, portrait: Portrait, epal: PalletModel) -> None:
    shot = portrait(epal, POSE)
    grid = replace(grid_of(np.zeros(1), np.linspace(0.85, 1.15, 31), np.zeros(1)), sliding=True)
    patch = patch_at(shot, slid(shot, POSE, part))
    best = score_hypotheses(patch, epal, grid, CONFIG).peaks[0]
    assert np.linalg.norm(best.pose.as_array()[:3] - POSE.as_array()[:3]) < 0.08
    assert best.score > 0.9 * score_pose(patch, epal, POSE)


def test_a_face_whose_openings_leave_no_room_inside_its_blocks_is_scored_too(portrait: Portrait) -> None:
    model = PalletModel("low", 1.1, 0.144, 1.0, (LOW,))
    assert len(face_samples(model).block) == 0
    patch = patch_at(portrait(model, POSE), POSE)
    grid = grid_of(np.linspace(-4, 4, 5), np.linspace(0.95, 1.05, 9), np.linspace(-0.04, 0.04, 5))
    best = score_hypotheses(patch, model, grid, CONFIG).peaks[0]
    assert np.hypot(best.pose.x - POSE.x, best.pose.y - POSE.y) < 0.02
    assert score_pose(patch, model, POSE) > 0.5


# Views that hypotheses are scored on.

CAMERA = Pinhole(480, 320, 300.0, 300.0, 239.5, 159.5)
MOUNTED = RigidTransform.from_components([0.3, -0.1, 1.2], Rotation.from_euler("ZYX", [1.2, 0.25, 0.02]))
BASE = LevelPose(0.9, 2.2, 0.3, 1.4)
SHOWN = (-0.8, 0.8, -0.15, 0.45)
RESOLUTION = 0.006


def camera_from_plane(base: LevelPose = BASE) -> FloatArray:
    return np.asarray((MOUNTED.inv() * base.transform() * PALLET_FROM_VERTICAL).as_matrix())


def patch_of(image: Image, camera: CameraModel = CAMERA, base: LevelPose = BASE) -> FacePatch:
    found = view_patch(Shot(image, camera, Mounting(MOUNTED)), base, SHOWN, RESOLUTION)
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


def test_a_patch_knows_its_plane_and_on_it_every_point_appears_where_it_is() -> None:
    points = np.random.default_rng(0).uniform(-0.5, 0.5, (50, 2))
    np.testing.assert_allclose(BLANK.appearing(BASE, points), points, atol=1e-12)
    np.testing.assert_allclose(BLANK.view.camera_from_plane.as_matrix(), camera_from_plane(), atol=1e-12)
    forklift_from_plane = BASE.transform() * PALLET_FROM_VERTICAL
    np.testing.assert_allclose(forklift_from_plane.apply(BLANK.plane_from_camera), MOUNTED.translation, atol=1e-12)
    assert BLANK.base == BASE


@given(poses, st.integers(-3, 3))
@settings(max_examples=20)
def test_whole_turns_change_nothing(pose: LevelPose, turns: int) -> None:
    points = np.array([[-0.5, 0.0], [0.4, 0.14]])
    turned = replace(pose, yaw=pose.yaw + 2 * np.pi * turns)
    np.testing.assert_allclose(BLANK.appearing(turned, points), BLANK.appearing(pose, points), atol=1e-9)


def waves(slope: float) -> Callable[[FloatArray], FloatArray]:
    """Stripes along lines that rise by a slope."""

    def paint(points: FloatArray) -> FloatArray:
        across = (points[..., 1] - slope * points[..., 0]) / np.hypot(1.0, slope)
        return np.asarray(120 + 60 * np.sin(2 * np.pi * across / 0.08))

    return paint


@pytest.mark.parametrize("slope", [-0.35, -0.2, 0.0, 0.12, 0.4])
def test_lines_have_most_energy_along_their_own_slope(slope: float, paint_plane: Paints) -> None:
    patch = patch_of(paint_plane(CAMERA, camera_from_plane(), SHOWN, waves(slope)))
    tried = np.linspace(-0.6, 0.6, 7)
    inside = patch.view.valid.copy()
    inside[:20], inside[-20:], inside[:, :20], inside[:, -20:] = False, False, False, False
    energy = [float(patch.along_level(float(rise))[inside].mean()) for rise in tried]
    assert tried[int(np.argmax(energy))] == pytest.approx(slope, abs=0.11)
    assert max(energy) > 0.3
    assert (np.diff(energy[: int(np.argmax(energy)) + 1]) > 0).all()
    assert (np.diff(energy[int(np.argmax(energy)) :]) < 0).all()


def test_upright_lines_have_upright_energy_and_level_ones_have_none(paint_plane: Paints) -> None:
    def upright(points: FloatArray) -> FloatArray:
        return np.asarray(120 + 60 * np.sin(2 * np.pi * points[..., 0] / 0.08))

    means = []
    for paint in (upright, waves(0.0)):
        patch = patch_of(paint_plane(CAMERA, camera_from_plane(), SHOWN, paint))
        middle = np.s_[25:-25, 25:-25]
        fields = (patch.upright, patch.along_level(0.0), patch.any_direction)
        means.append([float(field[middle].mean()) for field in fields])
    (upright_up, upright_level, upright_any), (level_up, level_level, level_any) = means
    assert upright_up > 5 * upright_level
    assert level_level > 5 * level_up
    assert min(upright_any, level_any) > 0.2


def test_energy_lies_between_0_and_1_and_neither_light_nor_colour_matters_to_it(paint_plane: Paints) -> None:
    noise = np.random.default_rng(0).integers(0, 256, (CAMERA.height, CAMERA.width, 3), dtype=np.uint8)
    for image, most in ((noise, 1.0), (np.full_like(noise, 90), 1e-6)):
        patch = patch_of(image)
        for field in (patch.along_level(0.1), patch.upright, patch.any_direction):
            assert field.shape == patch.view.image.shape[:2]
            assert field.min() >= -1e-6
            assert field.max() <= most + 1e-6
    image = paint_plane(CAMERA, camera_from_plane(), SHOWN, waves(0.1))
    bright, dark = (patch_of(picture).along_level(0.1) for picture in (image, image // 3))
    assert np.corrcoef(bright.ravel(), dark.ravel())[0, 1] > 0.95
    assert dark.mean() > 0.7 * bright.mean()
    gray, colour = (patch_of(picture).any_direction for picture in (image, np.repeat(image[..., None], 3, axis=2)))
    assert np.abs(gray - colour).mean() < 0.05


def test_a_plane_behind_or_beside_or_beyond_the_image_is_not_seen() -> None:
    shot = Shot(np.zeros((CAMERA.height, CAMERA.width), np.uint8), CAMERA, Mounting(MOUNTED))
    center = np.asarray(MOUNTED.translation)
    into = np.array([np.cos(BASE.yaw), np.sin(BASE.yaw)])
    for distance in (-1.0, 0.0, 0.9 * MIN_DISTANCE):
        x, y = (center[:2] + distance * into).tolist()
        assert view_patch(shot, replace(BASE, x=x, y=y), SHOWN, RESOLUTION) is Reason.BEHIND_FACE
    image = np.zeros((CAMERA.height, CAMERA.width), np.uint8)
    aside = replace(BASE, x=BASE.x + 6.0)
    assert view_patch(Shot(image, CAMERA, Mounting(MOUNTED)), aside, SHOWN, RESOLUTION) is Reason.OUT_OF_VIEW
    sphere = Equirectangular(480, 240)
    whole = np.zeros((240, 480), np.uint8)
    assert isinstance(view_patch(Shot(whole, sphere, Mounting(MOUNTED)), aside, SHOWN, RESOLUTION), FacePatch)
