from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from palletloc.baselines import measure_as_in_paper, measure_jointly
from palletloc.candidate import Candidate, Fit, Refusal
from palletloc.config import LocalizerConfig
from palletloc.geometry import LevelPose
from palletloc.measurement import HeightPrior, Reason, Stage, YawSource
from palletloc.pallet import PalletModel
from palletloc.paper.horizontal_view import BoundaryMethod
from palletloc.paper.joint_search import JointSearchConfig
from palletloc.shot import Shot

POSE = LevelPose(0.9, 2.0, 0.0, np.pi / 2 + 0.02)
FLOOR = HeightPrior(0.0, 0.003)
CONFIG = replace(LocalizerConfig(), joint_search=JointSearchConfig(turns=9, depths=9))
Portrait = Callable[..., Shot]
Placed = tuple[PalletModel, LevelPose]
Measure = Callable[[Shot, Candidate, LocalizerConfig], None]
BOTH = pytest.mark.parametrize("measure", [measure_as_in_paper, measure_jointly], ids=["paper", "joint_search"])


def measured(
    measure: Measure,
    shot: Shot,
    model: PalletModel,
    start: LevelPose = POSE,
    config: LocalizerConfig = CONFIG,
) -> Candidate:
    candidate = Candidate(model, start, FLOOR)
    measure(shot, candidate, config)
    return candidate


@BOTH
@pytest.mark.parametrize("name", ["epal", "t11"])
def test_a_pallet_is_measured_as_coarsely_as_the_method_can(
    measure: Measure, name: str, portrait: Portrait, request: pytest.FixtureRequest
) -> None:
    model: PalletModel = request.getfixturevalue(name)
    found = measured(measure, portrait(model, POSE), model, replace(POSE, yaw=POSE.yaw + np.radians(2.0)))
    assert found.refusal is None
    assert found.pose is not None
    assert np.hypot(found.pose.x - POSE.x, found.pose.y - POSE.y) < 0.08
    assert abs(found.pose.z) < 0.08
    assert abs(found.pose.yaw - POSE.yaw) < np.radians(3.0)
    assert 0.0 < found.score <= 1.0


@BOTH
def test_a_covariance_is_symmetric_positive_definite_and_longest_along_the_viewing_ray(
    measure: Measure, portrait: Portrait, t11: PalletModel
) -> None:
    shot = portrait(t11, POSE)
    covariance = measured(measure, shot, t11).covariance
    assert covariance is not None
    np.testing.assert_allclose(covariance, covariance.T)
    assert np.linalg.eigvalsh(covariance).min() > 0
    ray = np.array([POSE.x, POSE.y, POSE.z]) - shot.mounting.center
    _, axes = np.linalg.eigh(covariance[:3, :3])
    assert abs(axes[:, -1] @ ray) > 0.9 * np.linalg.norm(ray)


@BOTH
def test_nothing_is_measured_in_a_plain_image(measure: Measure, portrait: Portrait, t11: PalletModel) -> None:
    shot = portrait(t11, POSE)
    found = measured(measure, replace(shot, image=np.full_like(shot.image, 90)), t11)
    assert found.refusal is not None
    assert found.pose is None


@BOTH
def test_a_face_seen_from_behind_is_refused(measure: Measure, portrait: Portrait, t11: PalletModel) -> None:
    found = measured(measure, portrait(t11, POSE), t11, replace(POSE, yaw=-np.pi / 2))
    assert found.refusal is not None
    assert found.refusal[1] is Reason.BEHIND_FACE


@BOTH
def test_a_place_out_of_range_is_refused(measure: Measure, portrait: Portrait, t11: PalletModel) -> None:
    found = measured(measure, portrait(t11, POSE), t11, replace(POSE, y=40.0))
    assert found.refusal is not None
    assert found.pose is None


def test_the_paper_has_no_answer_for_a_pallet_level_with_the_camera(
    rack_shot: Shot, rack_pallets: tuple[Placed, ...]
) -> None:
    model, level = rack_pallets[1]
    found = measured(measure_as_in_paper, rack_shot, model, level)
    assert found.refusal == (Stage.YAW, Reason.NO_LINE)
    assert found.pose is None


def test_the_papers_yaw_is_houghs_angle(portrait: Portrait, t11: PalletModel) -> None:
    found = measured(measure_as_in_paper, portrait(t11, POSE), t11, replace(POSE, yaw=POSE.yaw + 0.03))
    assert found.pose is not None
    assert len(found.horizontal) == 2
    assert found.yaw_from is YawSource.BOTTOM
    steps = np.degrees(found.pose.yaw - POSE.yaw - 0.03) / CONFIG.yaw.hough_step_deg
    assert steps == pytest.approx(round(steps), abs=1e-6)
    assert found.yaw is None
    assert found.face is None


def test_the_papers_sweep_has_no_height_prior(portrait: Portrait, t11: PalletModel) -> None:
    shot = portrait(t11, POSE)
    poses = []
    for height in (FLOOR, None):
        candidate = Candidate(t11, POSE, height)
        measure_as_in_paper(shot, candidate, CONFIG)
        poses.append(candidate.pose)
    assert poses[0] == poses[1] is not None


def test_the_papers_second_way_finds_the_boundary_of_two_regions(portrait: Portrait, t11: PalletModel) -> None:
    config = replace(CONFIG, yaw=replace(CONFIG.yaw, boundary=BoundaryMethod.TWO_REGION))
    start = replace(POSE, yaw=POSE.yaw + np.radians(3.0))
    found = measured(measure_as_in_paper, portrait(t11, POSE), t11, start, config)
    assert found.pose is not None
    assert abs(found.pose.yaw - POSE.yaw) < np.radians(1.5)


def test_the_joint_search_is_kept_and_the_yaw_is_the_faces(portrait: Portrait, t11: PalletModel) -> None:
    found = measured(measure_jointly, portrait(t11, POSE), t11)
    assert found.joint is not None
    assert found.joint.score.shape == (9, 9)
    assert found.pose == found.joint.forklift_from_pallet
    assert found.yaw_from is YawSource.FACE
