from dataclasses import replace

import numpy as np
import pytest

from palletloc import LevelPose, PalletModel, Shot
from palletloc.measurement import Reason
from palletloc.paper.joint_search import JointSearch, JointSearchConfig, search_jointly
from palletloc.paper.position import PositionConfig, Sweep, sweep
from tests.palletloc.poses import FLOOR, POSE, Height, Portrait, blanked, moved, slid

CONFIG = PositionConfig()


def swept(
    shot: Shot, model: PalletModel, start: LevelPose = POSE, prior: Height = FLOOR, yaw_known: bool = True
) -> Sweep | Reason:
    return sweep(shot, start, model, prior, yaw_known, CONFIG)


def off(pose: LevelPose, truth: LevelPose = POSE) -> tuple[float, float]:
    """How far a pose is off along the face and in depth, in metres."""
    dx, dy = pose.x - truth.x, pose.y - truth.y
    cos, sin = np.cos(truth.yaw), np.sin(truth.yaw)
    return float(sin * dx - cos * dy), float(cos * dx + sin * dy)


@pytest.mark.parametrize("factor", [0.97, 1.0, 1.03])
@pytest.mark.parametrize("prior", [FLOOR, None], ids=["level", "free"])
def test_the_best_peak_is_the_pallet_from_all_along_its_ray(
    model: PalletModel, factor: float, prior: Height, portrait: Portrait
) -> None:
    shot = portrait(model, POSE)
    found = swept(shot, model, slid(shot, POSE, factor), prior)
    assert isinstance(found, Sweep)
    right, depth = min((off(peak) for peak in found.peaks), key=lambda away: float(np.hypot(*away)))
    assert abs(right) < 0.02
    assert abs(depth) < 0.03
    if prior is FLOOR:
        assert np.abs(off(found.peaks[0])).max() < 0.03
        assert all(peak.z == FLOOR.z for peak in found.peaks)


@pytest.mark.parametrize("factor", [0.95, 1.05])
@pytest.mark.parametrize("x", [-1.0, 2.3])
def test_far_aside_faces_are_followed_on_rays(factor: float, x: float, portrait: Portrait, t11: PalletModel) -> None:
    pose = replace(POSE, x=x)
    shot = portrait(t11, pose)
    found = swept(shot, t11, slid(shot, pose, factor))
    assert isinstance(found, Sweep)
    assert np.abs(off(found.peaks[0], pose)).max() < 0.03


@pytest.mark.parametrize("yaw_error_deg", [-3.0, 3.0])
def test_an_unknown_yaw_is_searched(yaw_error_deg: float, portrait: Portrait, epal: PalletModel) -> None:
    start = replace(POSE, yaw=POSE.yaw + np.radians(yaw_error_deg))
    found = swept(portrait(epal, POSE), epal, start, yaw_known=False)
    assert isinstance(found, Sweep)
    assert abs(found.peaks[0].yaw - POSE.yaw) < np.radians(2.0)
    assert np.abs(off(found.peaks[0])).max() < 0.04
    kept = swept(portrait(epal, POSE), epal, start)
    assert isinstance(kept, Sweep)
    assert all(peak.yaw == pytest.approx(start.yaw) for peak in kept.peaks)


def test_the_curve_of_scores_belongs_to_the_depths(portrait: Portrait, t11: PalletModel) -> None:
    found = swept(portrait(t11, POSE), t11)
    assert isinstance(found, Sweep)
    assert found.depth.shape == found.score.shape
    assert (np.diff(found.depth) > 0).all()
    assert found.depth[0] == pytest.approx(-CONFIG.nearer)
    assert found.depth[-1] >= CONFIG.farther
    assert found.best == pytest.approx(found.score.max())
    assert found.depth[found.score.argmax()] == pytest.approx(off(found.peaks[0])[1], abs=1e-6)
    assert found.best > np.median(found.score) + 0.1


def test_peaks_stand_apart(portrait: Portrait, epal: PalletModel) -> None:
    found = swept(portrait(epal, POSE), epal, prior=None, yaw_known=False)
    assert isinstance(found, Sweep)
    assert 1 <= len(found.peaks) <= CONFIG.peaks
    for i, peak in enumerate(found.peaks):
        for other in found.peaks[:i]:
            apart = np.abs(peak.as_array() - other.as_array())
            assert np.linalg.norm(apart[:3]) > 0.01 or apart[3] > np.radians(1.0)


def test_a_free_height_is_found(portrait: Portrait, t11: PalletModel) -> None:
    found = swept(portrait(t11, POSE), t11, replace(POSE, z=0.03), None)
    assert isinstance(found, Sweep)
    assert min(abs(peak.z) for peak in found.peaks) < 0.03


def test_nothing_is_found_in_a_plain_image_from_behind_or_outside(portrait: Portrait, t11: PalletModel) -> None:
    assert swept(blanked(portrait(t11, POSE)), t11) is Reason.NO_PEAK
    shot = portrait(t11, POSE)
    assert swept(shot, t11, replace(POSE, yaw=-np.pi / 2)) is Reason.BEHIND_FACE
    assert swept(shot, t11, replace(POSE, x=5.0)) is Reason.OUT_OF_VIEW


# Yaw and distance together.

JOINT = JointSearchConfig(turns=7, depths=7)


def searched(shot: Shot, model: PalletModel, start: LevelPose = POSE) -> JointSearch | Reason:
    return search_jointly(shot, start, model, JOINT)


@pytest.mark.parametrize("turn_deg", [-4.0, 0.0, 4.0])
@pytest.mark.parametrize("factor", [0.98, 1.02])
def test_yaw_and_distance_are_found_within_the_steps_of_the_search(
    turn_deg: float, factor: float, portrait: Portrait, t11: PalletModel
) -> None:
    shot = portrait(t11, POSE)
    found = searched(shot, t11, moved(slid(shot, POSE, factor), turn_deg=turn_deg))
    assert isinstance(found, JointSearch)
    pose = found.forklift_from_pallet
    assert np.hypot(pose.x - POSE.x, pose.y - POSE.y) < 0.08
    assert abs(pose.z) < 0.06
    assert abs(pose.yaw - POSE.yaw) < np.radians(3.0)  # yaw and distance trade off


def test_the_best_score_is_that_of_the_pose_and_a_plain_image_has_none(portrait: Portrait, t11: PalletModel) -> None:
    start = replace(POSE, yaw=POSE.yaw + np.radians(4.0))
    found = searched(portrait(t11, POSE), t11, start)
    assert isinstance(found, JointSearch)
    assert found.score.shape == (len(found.turns), len(found.depths)) == (7, 7)
    assert found.best == found.score.max()
    turn = found.turns[np.unravel_index(found.score.argmax(), found.score.shape)[0]]
    assert turn < 0
    assert found.forklift_from_pallet.yaw == pytest.approx(start.yaw + turn)
    np.testing.assert_allclose(np.degrees(found.turns), np.linspace(-6.0, 6.0, 7))
    assert searched(blanked(portrait(t11, POSE)), t11) is Reason.NO_PEAK


@pytest.mark.parametrize("start", [replace(POSE, yaw=-np.pi / 2), LevelPose(0.3, 0.1, 0.0, np.pi / 2)])
def test_behind_or_at_the_face_nothing_is_searched(start: LevelPose, portrait: Portrait, t11: PalletModel) -> None:
    assert searched(portrait(t11, POSE), t11, start) is Reason.BEHIND_FACE
