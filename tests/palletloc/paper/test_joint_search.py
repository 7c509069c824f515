from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from palletloc.geometry import LevelPose
from palletloc.measurement import Reason
from palletloc.pallet import PalletModel
from palletloc.paper.joint_search import JointSearch, JointSearchConfig, search_jointly
from palletloc.shot import Shot

POSE = LevelPose(0.9, 2.0, 0.0, np.pi / 2 + 0.02)
CONFIG = JointSearchConfig(turns=7, depths=7)
Portrait = Callable[..., Shot]


def searched(shot: Shot, model: PalletModel, start: LevelPose = POSE) -> JointSearch | Reason:
    return search_jointly(shot, start, model, CONFIG)


@pytest.mark.parametrize("turn_deg", [-4.0, 0.0, 4.0])
@pytest.mark.parametrize("factor", [0.98, 1.02])
def test_yaw_and_distance_are_found_within_the_steps_of_the_search(
    turn_deg: float, factor: float, portrait: Portrait, t11: PalletModel
) -> None:
    shot = portrait(t11, POSE)
    x, y, z = shot.mounting.center + factor * (np.array([POSE.x, POSE.y, POSE.z]) - shot.mounting.center)
    found = searched(shot, t11, LevelPose(x, y, z, POSE.yaw + np.radians(turn_deg)))
    assert isinstance(found, JointSearch)
    pose = found.forklift_from_pallet
    assert np.hypot(pose.x - POSE.x, pose.y - POSE.y) < 0.08
    assert abs(pose.z) < 0.06
    assert abs(pose.yaw - POSE.yaw) < np.radians(3.0)  # yaw and distance trade off


def test_the_best_score_is_that_of_the_pose(portrait: Portrait, t11: PalletModel) -> None:
    start = replace(POSE, yaw=POSE.yaw + np.radians(4.0))
    found = searched(portrait(t11, POSE), t11, start)
    assert isinstance(found, JointSearch)
    assert found.score.shape == (len(found.turns), len(found.depths)) == (7, 7)
    assert found.best == found.score.max()
    turn = found.turns[np.unravel_index(found.score.argmax(), found.score.shape)[0]]
    assert turn < 0
    assert found.forklift_from_pallet.yaw == pytest.approx(start.yaw + turn)
    np.testing.assert_allclose(np.degrees(found.turns), np.linspace(-6.0, 6.0, 7))


def test_nothing_is_found_in_a_plain_image(portrait: Portrait, t11: PalletModel) -> None:
    shot = portrait(t11, POSE)
    assert searched(replace(shot, image=np.full_like(shot.image, 90)), t11) is Reason.NO_PEAK


@pytest.mark.parametrize("start", [replace(POSE, yaw=-np.pi / 2), LevelPose(0.3, 0.1, 0.0, np.pi / 2)])
def test_from_behind_or_at_the_face_there_is_nothing_to_search(
    start: LevelPose, portrait: Portrait, t11: PalletModel
) -> None:
    assert searched(portrait(t11, POSE), t11, start) is Reason.BEHIND_FACE
