from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from palletloc.geometry import FloatArray, LevelPose, wrap_angle
from palletloc.measurement import Reason
from palletloc.pallet import Opening, PalletModel
from palletloc.refinement.hypotheses import (
    HypothesisGrid,
    HypothesisScores,
    SearchConfig,
    score_hypotheses,
    score_pose,
)
from palletloc.refinement.patch import FacePatch, view_patch
from palletloc.refinement.samples import face_samples
from palletloc.shot import Shot

POSE = LevelPose(0.9, 2.0, 0.0, np.pi / 2 + 0.02)
CONFIG = SearchConfig()
EVERY = SearchConfig(kept=10_000, peaks=12, min_score=-1e3, min_share=-1e3, apart=1e-9, apart_deg=1e-9)
EXTENT = (-0.95, 0.95, -0.25, 0.45)
Portrait = Callable[..., Shot]


def patch_at(shot: Shot, base: LevelPose, resolution: float = 0.005) -> FacePatch:
    found = view_patch(shot, base, EXTENT, resolution)
    assert not isinstance(found, Reason)
    return found


def moved(
    pose: LevelPose, right: float = 0.0, depth: float = 0.0, up: float = 0.0, turn_deg: float = 0.0
) -> LevelPose:
    cos, sin = np.cos(pose.yaw), np.sin(pose.yaw)
    x, y = pose.x + cos * depth + sin * right, pose.y + sin * depth - cos * right
    return LevelPose(float(x), float(y), pose.z + up, float(pose.yaw + np.radians(turn_deg)))


def grid_of(
    turns_deg: FloatArray, ranges: FloatArray, places: FloatArray, rises: FloatArray | None = None
) -> HypothesisGrid:
    heights = np.zeros(1) if rises is None else rises
    return HypothesisGrid(np.radians(turns_deg), ranges, places, heights, rises is not None)


LOW = Opening(center=0.0, width=0.3, bottom=0.05, height=0.03)
SINGLE = grid_of(np.zeros(1), np.ones(1), np.zeros(1))
WIDE = grid_of(np.linspace(-20, 20, 21), np.linspace(0.85, 1.15, 31), np.linspace(-0.06, 0.06, 13))


def nearest(found: HypothesisScores, truth: LevelPose) -> tuple[float, float]:
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
def test_the_true_pose_has_a_better_score_than_any_other(
    model: PalletModel, motion: dict[str, float], portrait: Portrait
) -> None:
    patch = patch_at(portrait(model, POSE), POSE)
    assert score_pose(patch, model, POSE) > score_pose(patch, model, moved(POSE, **motion)) + 0.05


def test_scores_are_at_most_1_and_a_pallet_is_far_from_nothing(model: PalletModel, portrait: Portrait) -> None:
    shot = portrait(model, POSE)
    assert 0.4 < score_pose(patch_at(shot, POSE), model, POSE) <= 1.0
    plain = replace(shot, image=np.full_like(shot.image, 90))
    assert abs(score_pose(patch_at(plain, POSE), model, POSE)) < 1e-6


@pytest.mark.parametrize("off", [{"right": 0.05}, {"depth": 0.1}, {"up": 0.03, "depth": -0.1}], ids=str)
def test_a_pose_scores_about_the_same_on_any_plane_nearby(
    off: dict[str, float], portrait: Portrait, t11: PalletModel
) -> None:
    shot = portrait(t11, POSE)
    here = score_pose(patch_at(shot, POSE), t11, POSE)
    there = score_pose(patch_at(shot, moved(POSE, **off)), t11, POSE)
    assert there == pytest.approx(here, abs=0.12)


@pytest.mark.parametrize("right", [0.0, 0.0025, -0.0125])
def test_a_single_hypothesis_is_scored_as_its_pose_is(right: float, portrait: Portrait, t11: PalletModel) -> None:
    shot = portrait(t11, POSE)
    base = moved(POSE, right=right)
    patch = patch_at(shot, base)
    found = score_hypotheses(patch, t11, SINGLE, EVERY)
    (peak,) = found.peaks[:1]
    np.testing.assert_allclose(peak.pose.as_array(), base.as_array(), atol=1e-9)
    # a point half-way between two pixels may be read from either
    assert peak.score == pytest.approx(score_pose(patch, t11, base), abs=3e-3)


@pytest.mark.parametrize(("depth", "turn_deg"), [(0.0, 0.0), (0.2, 10.0), (-0.2, -10.0), (0.2, -10.0)])
def test_a_wide_grid_has_a_peak_at_the_truth(
    model: PalletModel, depth: float, turn_deg: float, portrait: Portrait
) -> None:
    shot = portrait(model, POSE)
    x, y = shot.mounting.center[:2] + (1 + depth / 2.2) * (np.array([POSE.x, POSE.y]) - shot.mounting.center[:2])
    base = LevelPose(float(x), float(y), POSE.z, POSE.yaw + float(np.radians(turn_deg)))
    found = score_hypotheses(patch_at(shot, base), model, WIDE, CONFIG)
    metres, degrees = nearest(found, POSE)
    assert metres < 0.08
    assert degrees < 4.0


def test_peaks_stand_apart_the_best_first(portrait: Portrait, t11: PalletModel) -> None:
    patch = patch_at(portrait(t11, POSE), moved(POSE, depth=0.05, turn_deg=4.0))
    config = replace(CONFIG, peaks=8, min_share=0.1)
    found = score_hypotheses(patch, t11, WIDE, config)
    assert 2 <= len(found.peaks) <= 8
    scores = [peak.score for peak in found.peaks]
    assert scores == sorted(scores, reverse=True)
    assert max(scores) <= 1.0
    for number, one in enumerate(found.peaks):
        for other in found.peaks[:number]:
            apart = np.abs(one.pose.as_array() - other.pose.as_array())
            # polishing may bring them nearer by a part of the grid's step
            assert np.linalg.norm(apart[:3]) > 0.5 * CONFIG.apart or np.degrees(apart[3]) > 0.4 * CONFIG.apart_deg


def test_what_agrees_too_little_is_no_peak(portrait: Portrait, t11: PalletModel) -> None:
    shot = portrait(t11, POSE)
    patch = patch_at(shot, POSE)
    assert score_hypotheses(patch, t11, WIDE, replace(CONFIG, min_score=1.01)).peaks == ()
    plain = patch_at(replace(shot, image=np.full_like(shot.image, 90)), POSE)
    assert score_hypotheses(plain, t11, WIDE, CONFIG).peaks == ()
    kept = score_hypotheses(patch, t11, WIDE, replace(CONFIG, min_share=0.999)).peaks
    assert len(kept) == 1
    assert len(score_hypotheses(patch, t11, WIDE, replace(CONFIG, peaks=2, min_share=0.1)).peaks) <= 2


def test_the_table_shows_where_the_truth_is(portrait: Portrait, epal: PalletModel) -> None:
    shot = portrait(epal, POSE)
    x, y = shot.mounting.center[:2] + 1.1 * (np.array([POSE.x, POSE.y]) - shot.mounting.center[:2])
    base = LevelPose(float(x), float(y), POSE.z, POSE.yaw + float(np.radians(6.0)))
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
def test_a_pallet_is_found_on_the_viewing_ray_of_a_start_at_another_height(
    part: float, portrait: Portrait, epal: PalletModel
) -> None:
    shot = portrait(epal, POSE)
    x, y, z = shot.mounting.center + part * (POSE.as_array()[:3] - shot.mounting.center)
    base = LevelPose(float(x), float(y), float(z), POSE.yaw)
    grid = replace(grid_of(np.zeros(1), np.linspace(0.85, 1.15, 31), np.zeros(1)), sliding=True)
    patch = patch_at(shot, base)
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
