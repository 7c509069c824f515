"""The methods to compare with: the chain on planes, and the paper's as they are written."""

from dataclasses import replace

import numpy as np
import pytest

from palletloc import Candidate, Fit, LevelPose, LocalizerConfig, PalletModel, Refusal, Shot
from palletloc.baselines import (
    _checked,
    _second_moment,
    measure_as_in_paper,
    measure_jointly,
    measure_on_planes,
    nearest_line,
)
from palletloc.candidate import last_step, steps_of
from palletloc.measurement import HeightPrior, Reason, Stage, YawSource
from palletloc.paper.boundary import BoundaryLine
from palletloc.paper.horizontal_view import BoundaryMethod, HorizontalView, horizontal_source
from palletloc.paper.joint_search import JointSearch, JointSearchConfig
from palletloc.paper.position import Sweep
from palletloc.paper.yaw import YawEstimate
from palletloc.rivals import Measure
from tests.palletloc.poses import FLOOR, POSE, Height, Outcome, Pallets, Portrait, blanked, fit_of, found

CONFIG = replace(LocalizerConfig(), joint_search=JointSearchConfig(turns=9, depths=9))
COARSE = pytest.mark.parametrize("measure", [measure_as_in_paper, measure_jointly], ids=["paper", "joint_search"])
ALL = pytest.mark.parametrize(
    "measure", [measure_on_planes, measure_as_in_paper, measure_jointly], ids=["planes", "paper", "joint_search"]
)


def measured(
    measure: Measure,
    shot: Shot,
    model: PalletModel,
    start: LevelPose = POSE,
    height: Height = FLOOR,
    config: LocalizerConfig = CONFIG,
) -> Outcome:
    return measure(shot, Candidate(model, start, height), config)


# All of them.


@ALL
def test_nothing_is_measured_in_a_plain_image(measure: Measure, portrait: Portrait, t11: PalletModel) -> None:
    outcome = measured(measure, blanked(portrait(t11, POSE)), t11)
    assert isinstance(outcome, Refusal)
    assert outcome.fit is None


# On planes: yaw, position, yaw again, edges.


@pytest.mark.parametrize("height", [FLOOR, None], ids=["level", "free"])
def test_poses_are_as_right_as_they_say(model: PalletModel, height: Height, portrait: Portrait) -> None:
    start = LevelPose(POSE.x + 0.03, POSE.y + 0.02, 0.0, POSE.yaw - 0.03)
    fit = found(measured(measure_on_planes, portrait(model, POSE), model, start, height))
    error = fit.pose.minus(POSE)
    assert error @ np.linalg.solve(fit.covariance, error) < 25.0
    assert (np.abs(error) < 4 * np.sqrt(np.diag(fit.covariance))).all()
    assert np.abs(error[:2]).max() < 0.03


def test_every_step_leaves_its_result(portrait: Portrait, t11: PalletModel) -> None:
    start = replace(POSE, yaw=POSE.yaw + 0.03)
    fit = found(measured(measure_on_planes, portrait(t11, POSE), t11, start))
    assert steps_of(fit, BoundaryLine)
    assert len(steps_of(fit, HorizontalView)) >= 2
    assert len(steps_of(fit, Sweep)) == 1
    assert fit.face is not None
    assert fit.evidence is not None
    assert fit.prior is not None
    assert fit.prior.yaw is not None
    assert fit.pose == fit.face.forklift_from_pallet
    (estimate,) = steps_of(fit, YawEstimate)
    assert fit.yaw_from is estimate.source
    assert fit.prior.yaw.sigma == estimate.sigma


@pytest.mark.parametrize("max_doubt", [CONFIG.face_fit.max_doubt, -1e6], ids=["certain", "never_certain"])
def test_the_last_view_gave_the_yaw(max_doubt: float, floor_shot: Shot, floor_pallets: Pallets) -> None:
    config = replace(CONFIG, face_fit=replace(CONFIG.face_fit, max_doubt=max_doubt))
    for model, pose in floor_pallets:
        start = replace(pose, x=pose.x + 0.05)
        outcome = measured(measure_on_planes, floor_shot, model, start, None, config)
        estimate, last = last_step(outcome, YawEstimate), last_step(outcome, HorizontalView)
        assert estimate is not None
        assert last is not None
        placed = floor_shot.mounting.forklift_from_camera * last.view.camera_from_plane
        heading = placed.rotation.apply([0.0, 1.0, 0.0])
        used = [vote for vote in estimate.votes if vote.used]
        turn = np.average([vote.turn for vote in used], weights=[vote.sigma**-2 for vote in used])
        assert estimate.yaw == pytest.approx(float(np.arctan2(heading[1], heading[0])) + turn, abs=1e-9)


@pytest.mark.parametrize("turn_deg", [-4.0, -2.0, 2.0, 4.0])
@pytest.mark.parametrize("slide", [-0.05, 0.05])
def test_near_starts_lead_to_one_pose(turn_deg: float, slide: float, portrait: Portrait, t11: PalletModel) -> None:
    shot = portrait(t11, POSE)
    x, y = np.array([POSE.x, POSE.y]) + slide * np.array([np.cos(POSE.yaw), np.sin(POSE.yaw)])
    start = LevelPose(float(x), float(y), 0.0, POSE.yaw + np.radians(turn_deg))
    there, here = (fit_of(measured(measure_on_planes, shot, t11, pose)).pose for pose in (start, POSE))
    apart = there.minus(here)
    assert np.abs(apart[:3]).max() < 0.003
    assert abs(apart[3]) < np.radians(0.15)


def test_the_height_chooses_where_the_yaw_comes_from(rack_shot: Shot, rack_pallets: Pallets) -> None:
    expected = [YawSource.BOTTOM, YawSource.FACE, YawSource.TOP]
    sigmas = []
    for (model, pose), source in zip(rack_pallets, expected, strict=True):
        assert horizontal_source(model, rack_shot.camera_in(pose), CONFIG.yaw) is source
        outcome = measured(measure_on_planes, rack_shot, model, pose, HeightPrior(pose.z, 0.003))
        assert isinstance(outcome, Fit) or (source, outcome.reason) == (YawSource.FACE, Reason.UNCERTAIN)
        fit = outcome.fit
        assert fit is not None
        assert (fit.yaw_from is YawSource.FACE) is (source is YawSource.FACE)
        assert (last_step(fit, YawEstimate) is None) is (source is YawSource.FACE)
        assert source is not YawSource.TOP or fit.yaw_from is not YawSource.BOTTOM
        sigmas.append(float(np.sqrt(fit.covariance[3, 3])))
    assert sigmas[1] > 1.5 * sigmas[0]  # near the camera's height the yaw is weak


def test_a_face_cut_by_the_images_border_is_refused(cut_shot: Shot, t11: PalletModel) -> None:
    corners = POSE.transform().apply([[0.0, side * t11.width / 2, 0.0] for side in (-1, 1)])
    assert cut_shot.project(corners).valid.sum() == 1
    outcome = measured(measure_on_planes, cut_shot, t11)
    assert isinstance(outcome, Refusal)
    assert outcome.reason is Reason.OUT_OF_VIEW


def test_the_nearest_of_the_long_lines_is_taken() -> None:
    long, near, short = BoundaryLine(0.01, 0.05, 200), BoundaryLine(0.02, -0.01, 150), BoundaryLine(0.03, 0.0, 60)
    assert nearest_line([long, near, short]) is near
    assert nearest_line([near, long]) is near
    assert nearest_line([replace(long, up=0.0), replace(near, up=0.05)]) == replace(long, up=0.0)
    assert nearest_line([long, short]) is long
    assert nearest_line([short]) is short
    assert nearest_line([]) is None


# As in the paper.


@COARSE
@pytest.mark.parametrize("model", ["epal", "t11"], indirect=True)
def test_it_measures_as_coarsely_as_the_method_can(measure: Measure, model: PalletModel, portrait: Portrait) -> None:
    shot = portrait(model, POSE)
    fit = found(measured(measure, shot, model, replace(POSE, yaw=POSE.yaw + np.radians(2.0))))
    assert np.hypot(fit.pose.x - POSE.x, fit.pose.y - POSE.y) < 0.08
    assert abs(fit.pose.z) < 0.08
    assert abs(fit.pose.yaw - POSE.yaw) < np.radians(3.0)
    assert 0.0 < fit.rank <= 1.0
    assert (fit.face, fit.prior, fit.evidence) == (None, None, None)
    np.testing.assert_allclose(fit.covariance, fit.covariance.T)
    assert np.linalg.eigvalsh(fit.covariance).min() > 0
    ray = POSE.as_array()[:3] - shot.mounting.center
    _, axes = np.linalg.eigh(fit.covariance[:3, :3])
    assert abs(axes[:, -1] @ ray) > 0.9 * np.linalg.norm(ray)


def test_the_paper_has_no_answer_for_a_pallet_level_with_the_camera(rack_shot: Shot, rack_pallets: Pallets) -> None:
    model, level = rack_pallets[1]
    outcome = measured(measure_as_in_paper, rack_shot, model, level)
    assert isinstance(outcome, Refusal)
    assert (outcome.stage, outcome.reason, outcome.fit) == (Stage.YAW, Reason.NO_LINE, None)


def test_the_papers_yaw_is_houghs_or_two_regions_and_its_height_free(portrait: Portrait, t11: PalletModel) -> None:
    fit = found(measured(measure_as_in_paper, portrait(t11, POSE), t11, replace(POSE, yaw=POSE.yaw + 0.03)))
    assert len(steps_of(fit, HorizontalView)) == 2
    assert len(steps_of(fit, BoundaryLine)) == 1
    assert last_step(fit, YawEstimate) is None
    assert fit.yaw_from is YawSource.BOTTOM
    steps = np.degrees(fit.pose.yaw - POSE.yaw - 0.03) / CONFIG.yaw.hough_step_deg
    assert steps == pytest.approx(round(steps), abs=1e-6)
    shot = portrait(t11, POSE)
    known, free = (found(measured(measure_as_in_paper, shot, t11, POSE, height)) for height in (FLOOR, None))
    assert known.pose == free.pose
    config = replace(CONFIG, yaw=replace(CONFIG.yaw, boundary=BoundaryMethod.TWO_REGION))
    start = replace(POSE, yaw=POSE.yaw + np.radians(3.0))
    fit = found(measured(measure_as_in_paper, portrait(t11, POSE), t11, start, config=config))
    assert abs(fit.pose.yaw - POSE.yaw) < np.radians(1.5)


def test_the_joint_search_is_kept_and_the_yaw_is_the_faces(portrait: Portrait, t11: PalletModel) -> None:
    fit = found(measured(measure_jointly, portrait(t11, POSE), t11))
    joint = last_step(fit, JointSearch)
    assert joint is not None
    assert joint.score.shape == (9, 9)
    assert (fit.pose, fit.rank) == (joint.forklift_from_pallet, joint.best)
    assert fit.yaw_from is YawSource.FACE


# What they are sure of.


@COARSE
def test_a_pose_that_stands_on_no_known_level_is_refused(
    measure: Measure, portrait: Portrait, t11: PalletModel
) -> None:
    wrong = HeightPrior(POSE.z + 0.5, 0.0025)
    fit = found(measured(measure, portrait(t11, POSE), t11))
    outcome = _checked(portrait(t11, POSE), replace(fit, candidate=replace(fit.candidate, height=wrong)), CONFIG)
    assert isinstance(outcome, Refusal)
    assert (outcome.stage, outcome.reason) == (Stage.VERIFICATION, Reason.OFF_LEVEL)


def test_where_nothing_looks_like_a_pallet_or_the_place_is_unsure_the_pose_is_refused(
    portrait: Portrait, t11: PalletModel
) -> None:
    shot = portrait(t11, POSE)
    fit = found(measured(measure_as_in_paper, shot, t11))
    wide = replace(fit, covariance=fit.covariance + np.diag([0.1**2, 0.0, 0.0, 0.0]))
    for refused, image, reason in ((fit, blanked(shot), Reason.LOW_CONTRAST), (wide, shot, Reason.UNCERTAIN)):
        outcome = _checked(image, refused, CONFIG)
        assert isinstance(outcome, Refusal)
        assert (outcome.reason, outcome.fit) == (reason, refused)


def test_hypotheses_that_agree_as_well_count_by_their_distance_and_others_hardly() -> None:
    best, other = np.zeros(4), np.array([0.2, 0.0, -0.1, 0.05])
    np.testing.assert_allclose(_second_moment([best], [0.6]), np.zeros((4, 4)))
    np.testing.assert_allclose(_second_moment([best, other], [0.6, 0.6]), np.outer(other, other) / 2)
    less = [_second_moment([best, other], [0.6, 0.6 * share])[0, 0] for share in (1.0, 0.95, 0.9, 0.5)]
    assert less == sorted(less, reverse=True)
    assert less[-1] < 1e-4 * less[0]
    turned = np.array([0.0, 0.0, 0.0, 2 * np.pi])
    np.testing.assert_allclose(_second_moment([best, turned], [0.6, 0.6]), np.zeros((4, 4)), atol=1e-15)


@COARSE
def test_a_coarse_pose_is_as_right_as_it_says(measure: Measure, portrait: Portrait, t11: PalletModel) -> None:
    fit = found(measured(measure, portrait(t11, POSE), t11))
    error = fit.pose.minus(POSE)
    assert error @ np.linalg.solve(fit.covariance, error) < 16.0
