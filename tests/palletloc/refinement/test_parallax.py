from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from palletloc.geometry import FloatArray, LevelPose
from palletloc.measurement import HeightPrior
from palletloc.pallet import PalletModel
from palletloc.pallet_library import load_library
from palletloc.refinement.depth_edges import CREASE_SEEN, DepthPeaks, count_votes, visible_depth_edges
from palletloc.refinement.face_fit import FaceEstimate, FaceFitConfig, fit_face
from palletloc.shot import Shot

EPAL = load_library()["epal1-1200"]
EDGES = visible_depth_edges(EPAL, np.array([-0.9, 0.07, 1.8]))
CONTOURS = tuple(edge for edge in EDGES if edge.contour)
RIDGE = np.array([0.002, 0.003, 0.006, -0.004, 0.005])
SIGMA = np.full(5, 0.002)
START = np.array([0.001, -0.002, 0.0, 0.003, 0.0])
LEVEL = LevelPose(1.1, 1.9, 1.78, np.pi / 2 + 0.02)
Portrait = Callable[..., Shot]


def peaks_at(*places: FloatArray) -> DepthPeaks:
    """Peaks of equal strength around five contours: each array has one for every edge."""
    own = tuple(np.array(one) for one in zip(*places, strict=True)) if places else (np.zeros(0),) * 5
    shares = tuple(np.full(len(one), 1 / max(len(one), 1)) for one in own)
    edges = (CONTOURS * 5)[:5]
    return DepthPeaks(edges, own, shares, np.full(5, 0.03))


@given(st.floats(-2.5, 2.5))
def test_peaks_that_agree_tell_the_place_on_the_ridge(place: float) -> None:
    vote = count_votes(peaks_at(START + place * RIDGE), START, RIDGE, SIGMA, 1.0)
    assert vote.place == pytest.approx(place, abs=0.05)
    assert vote.sigma == pytest.approx(float(np.sqrt(1 / (RIDGE**2 / SIGMA**2).sum())), rel=0.1)
    assert vote.evidence > 2


@given(st.floats(-2.0, 2.0), st.integers(0, 4), st.floats(-0.02, 0.02))
def test_one_peak_that_contradicts_hardly_matters(place: float, which: int, off: float) -> None:
    places = START + place * RIDGE
    places[which] += off
    vote = count_votes(peaks_at(places), START, RIDGE, SIGMA, 1.0)
    assert abs(vote.place - place) < 4 * vote.sigma
    assert vote.evidence > 0


def test_other_peaks_beside_the_right_ones_are_left_out() -> None:
    others = np.random.default_rng(3).uniform(-0.025, 0.025, (3, 5))
    vote = count_votes(peaks_at(START + RIDGE, *others), START, RIDGE, SIGMA, 1.0)
    assert abs(vote.place - 1.0) < 3 * vote.sigma
    assert vote.sigma < 0.6


def test_peaks_that_are_nowhere_near_speak_against_the_pose_and_say_nothing() -> None:
    vote = count_votes(peaks_at(np.full(5, 0.029)), START, RIDGE, SIGMA / 4, 1.0)
    assert vote.evidence < -2
    assert vote.sigma > 3


def test_without_any_peak_nothing_is_known() -> None:
    vote = count_votes(peaks_at(), START, RIDGE, SIGMA, 1.0)
    assert vote.evidence == pytest.approx(0.0)
    assert vote.sigma > 30


def test_two_places_that_are_equally_good_leave_it_open() -> None:
    both = count_votes(peaks_at(START - 2 * RIDGE, START + 2 * RIDGE), START, RIDGE, SIGMA, 1.0)
    assert abs(both.place) < both.sigma
    assert both.sigma > 2


def test_a_wide_ridge_is_searched_farther() -> None:
    found = peaks_at(START + 7 * RIDGE)
    narrow, wide = (count_votes(found, START, RIDGE, SIGMA, width) for width in (1.0, 4.0))
    assert wide.place == pytest.approx(7.0, abs=0.2)
    assert wide.evidence > narrow.evidence


def test_a_crease_counts_less_than_a_contour() -> None:
    contours = peaks_at(START + RIDGE)
    creases = replace(contours, edges=tuple(replace(edge, contour=False) for edge in contours.edges))
    strong, weak = (count_votes(one, START, RIDGE, SIGMA, 1.0) for one in (contours, creases))
    assert 0 < CREASE_SEEN < 1
    assert strong.evidence > weak.evidence > 0


# In pictures of pallets at the camera's height.


def fitted(shot: Shot, model: PalletModel, pose: LevelPose = LEVEL) -> FaceEstimate:
    start = replace(pose, x=pose.x + 0.004, yaw=pose.yaw + np.radians(0.5))
    height = HeightPrior(pose.z, 0.003)
    camera, config = shot.camera, FaceFitConfig()
    found = fit_face(camera, shot.image, shot.mounting, start, model, height, None, float(np.radians(5.0)), config)
    assert isinstance(found, FaceEstimate)
    return found


def yaw_error(found: FaceEstimate, pose: LevelPose = LEVEL) -> float:
    return float(found.forklift_from_pallet.yaw - pose.yaw)


def yaw_sigma(found: FaceEstimate) -> float:
    return float(np.sqrt(found.covariance[3, 3]))


@pytest.mark.parametrize("name", ["epal1-1200", "epal1-800"])
def test_edges_behind_the_face_make_the_yaw_more_certain(name: str, portrait: Portrait) -> None:
    model, gains = load_library()[name], []
    for aside in (0.5, 1.1, 1.7):
        pose = replace(LEVEL, x=aside)
        shot = portrait(model, pose)
        alone, together = fitted(shot, replace(model, block_rows=()), pose), fitted(shot, model, pose)
        assert alone.behind == 0.0
        assert abs(yaw_error(together, pose)) < 3 * yaw_sigma(together)
        gains.append(yaw_sigma(together) / yaw_sigma(alone))
    assert max(gains) < 1.05
    assert np.mean(gains) < 0.8


def test_blocks_that_are_not_where_the_model_has_them_do_no_harm(portrait: Portrait) -> None:
    shot = portrait(EPAL, LEVEL)
    wrong = replace(EPAL, block_rows=((0.0, 0.06), (0.19, 0.27), (0.55, 0.61)))
    alone, misled = (fitted(shot, model) for model in (replace(EPAL, block_rows=()), wrong))
    assert misled.doubt <= alone.doubt + 0.3
    assert abs(yaw_error(misled)) < 3.5 * yaw_sigma(misled)


def test_far_above_a_pallet_nothing_changes(portrait: Portrait) -> None:
    pose = replace(LEVEL, z=0.0)
    shot, height = portrait(EPAL, pose), HeightPrior(0.0, 0.003)
    poses = [
        fit_face(shot.camera, shot.image, shot.mounting, pose, model, height, None, 0.1, FaceFitConfig())
        for model in (EPAL, replace(EPAL, block_rows=()))
    ]
    assert all(isinstance(one, FaceEstimate) for one in poses)
    first, second = (one.forklift_from_pallet.as_array() for one in poses if isinstance(one, FaceEstimate))
    np.testing.assert_allclose(first, second, atol=1e-12)
