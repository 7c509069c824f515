from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from palletloc import LevelPose, LocalizerConfig, Method, Mounting, PalletModel, Shot, methods
from palletloc.candidate import Candidate, Fit, Refusal, last_step
from palletloc.geometry import FloatArray
from palletloc.measurement import HeightPrior, Reason, Stage, YawSource
from palletloc.methods import METHODS, measure_refined
from palletloc.paper.joint_search import JointSearchConfig
from palletloc.refinement.search import Search, search
from palletloc.verification import of_use, verify
from tests.palletloc.poses import CONFIG, FLOOR, POSE, Height, Outcome, Pallets, Portrait, fit_of, found, moved

HEIGHTS = pytest.mark.parametrize("height", [FLOOR, None], ids=["level", "free"])


def measured(
    shot: Shot, model: PalletModel, start: LevelPose = POSE, height: Height = FLOOR, config: LocalizerConfig = CONFIG
) -> Outcome:
    """Measure, and check that the candidate is kept as it was given."""
    candidate = Candidate(model, start, height)
    outcome = measure_refined(shot, candidate, config)
    assert outcome.candidate is candidate
    assert candidate == Candidate(model, start, height)
    return outcome


def wrong(outcome: Outcome, truth: LevelPose = POSE) -> FloatArray:
    return fit_of(outcome).pose.minus(truth)


@HEIGHTS
@pytest.mark.parametrize(("right", "depth", "turn_deg"), [(0.02, 0.05, 3.0), (-0.04, -0.05, -4.0)])
def test_near_starts_lead_within_millimetres_as_the_covariance_says(
    model: PalletModel, height: Height, right: float, depth: float, turn_deg: float, portrait: Portrait
) -> None:
    fit = found(measured(portrait(model, POSE), model, moved(POSE, right, depth, turn_deg=turn_deg), height))
    error = wrong(fit)
    assert np.abs(error[:3]).max() < (0.010 if height else 0.025)
    assert abs(error[3]) < np.radians(0.6)
    assert error @ np.linalg.solve(fit.covariance, error) < 20.0
    np.testing.assert_allclose(fit.covariance, fit.covariance.T, rtol=1e-9, atol=1e-15)
    assert np.linalg.eigvalsh(fit.covariance).min() > 0


def test_an_uncertain_mounting_widens_the_pose_and_no_level_its_ray(portrait: Portrait, epal: PalletModel) -> None:
    shot = portrait(epal, POSE)
    known, free = (fit_of(measured(shot, epal, POSE, height)).covariance for height in (FLOOR, None))
    assert (np.diag(free) > np.diag(known)).all()
    _, axes = np.linalg.eigh(free[:3, :3])
    ray = POSE.as_array()[:3] - shot.mounting.center
    assert abs(axes[:, -1] @ ray) > 0.9 * np.linalg.norm(ray)
    loose = Mounting(shot.mounting.forklift_from_camera, (0.004, 0.004, 0.004), (0.003, 0.003, 0.003))
    usual, unsure = (fit_of(measured(each, epal)).covariance for each in (shot, replace(shot, mounting=loose)))
    assert np.linalg.eigvalsh(unsure - usual).min() > -1e-6
    assert np.sqrt(unsure[3, 3]) > 0.003
    assert np.sqrt(unsure[0, 0]) > 0.004


@pytest.mark.parametrize("side", [-1.0, 1.0])
@HEIGHTS
def test_a_pallet_one_opening_aside_is_not_taken(
    model: PalletModel, side: float, height: Height, portrait: Portrait
) -> None:
    pitch = model.openings[1].center - model.openings[0].center
    outcome = measured(portrait(model, POSE), model, moved(POSE, side * pitch), height)
    if isinstance(outcome, Fit):
        assert np.abs(wrong(outcome)[:3]).max() < 0.05
    else:
        assert outcome.stage is not Stage.START


def test_a_fit_holds_what_its_steps_found(portrait: Portrait, t11: PalletModel) -> None:
    fit = found(measured(portrait(t11, POSE), t11, moved(POSE, depth=0.04, turn_deg=2.0)))
    assert [type(step) for step in fit.steps] == [Search]
    assert fit.face is not None
    assert fit.evidence is not None
    assert verify(fit.evidence, CONFIG.verification) is None
    assert fit.pose == fit.face.forklift_from_pallet
    assert fit.prior is not None
    assert (fit.prior.height, fit.prior.yaw) == (FLOOR, None)
    assert fit.yaw_from is YawSource.BOTTOM


@pytest.mark.parametrize(("depth", "turn_deg"), [(0.08, 5.0), (-0.08, 5.0), (0.08, -5.0), (-0.08, -5.0)])
def test_near_starts_lead_to_one_pose(depth: float, turn_deg: float, portrait: Portrait, t11: PalletModel) -> None:
    shot = portrait(t11, POSE)
    straight, aside = found(measured(shot, t11)), measured(shot, t11, moved(POSE, depth=depth, turn_deg=turn_deg))
    apart = wrong(aside, straight.pose)
    assert np.abs(apart[:3]).max() < 0.002
    assert abs(apart[3]) < np.radians(0.1)


def test_far_starts_need_a_wide_search(portrait: Portrait, t11: PalletModel) -> None:
    shot = portrait(t11, POSE)
    start = moved(POSE, depth=0.35, turn_deg=15.0)
    narrow = measured(shot, t11, start)
    assert isinstance(narrow, Refusal) or np.abs(wrong(narrow)).max() < 0.02
    search = replace(CONFIG.search, turn_deg=24.0, nearer=0.9, farther=0.9)
    wide = measured(shot, t11, start, config=replace(CONFIG, search=search))
    assert isinstance(wide, Fit)
    assert np.abs(wrong(wide)[:3]).max() < 0.01
    assert abs(wrong(wide)[3]) < np.radians(0.6)


def test_at_any_height_a_pose_is_as_right_as_it_says_or_refused(rack_shot: Shot, rack_pallets: Pallets) -> None:
    sigmas = []
    for model, pose in rack_pallets:
        outcome = measured(rack_shot, model, moved(pose, 0.02, 0.03, turn_deg=1.0), HeightPrior(pose.z, 0.003))
        covariance, error = fit_of(outcome).covariance, wrong(outcome, pose)
        assert error @ np.linalg.solve(covariance, error) < 25.0
        assert isinstance(outcome, Fit) or (outcome.stage, outcome.reason) == (Stage.VERIFICATION, Reason.UNCERTAIN)
        assert isinstance(outcome, Fit) == of_use(covariance, CONFIG.verification)
        sigmas.append(float(np.sqrt(covariance[3, 3])))
    assert sigmas[1] > 1.5 * sigmas[0]  # level with the camera only little tells the yaw


def test_no_colour_gives_nearly_the_same_pose(portrait: Portrait, t11: PalletModel) -> None:
    shot = portrait(t11, POSE)
    gray = replace(shot, image=np.asarray(shot.image.mean(axis=2), dtype=np.uint8))
    colour, without = found(measured(shot, t11)), fit_of(measured(gray, t11))
    assert (np.abs(wrong(without, colour.pose)) < 2 * np.sqrt(np.diag(without.covariance))).all()


def test_a_start_around_which_nothing_can_be_seen_is_refused(portrait: Portrait, t11: PalletModel) -> None:
    outcome = measured(portrait(t11, POSE), t11, replace(POSE, x=4.5))
    assert isinstance(outcome, Refusal)
    assert (outcome.stage, outcome.reason, outcome.fit) == (Stage.SEARCH, Reason.OUT_OF_VIEW, None)


def test_a_face_cut_by_the_images_border_is_refused(cut_shot: Shot, t11: PalletModel) -> None:
    outcome = measured(cut_shot, t11)
    assert isinstance(outcome, Refusal)
    assert outcome.fit is None


@pytest.mark.parametrize("fill", ["plain", "noise"])
@HEIGHTS
def test_images_without_pallets_are_refused(fill: str, height: Height, portrait: Portrait, t11: PalletModel) -> None:
    shot = portrait(t11, POSE)
    shape = shot.image.shape
    noise = np.random.default_rng(0).integers(0, 256, shape, dtype=np.uint8)
    image = noise if fill == "noise" else np.full(shape, 90, np.uint8)
    assert isinstance(measured(replace(shot, image=image), t11, POSE, height), Refusal)


def test_another_pallet_is_not_taken_for_it(portrait: Portrait, open_below: PalletModel, epal: PalletModel) -> None:
    outcome = measured(portrait(open_below, POSE), epal)
    assert isinstance(outcome, Refusal)
    assert outcome.stage is Stage.VERIFICATION
    assert last_step(outcome, Search) is not None  # what was found on the way is kept


def misled(monkeypatch: pytest.MonkeyPatch, right: float) -> None:
    """Let the search of hypotheses end a way aside of where it does."""

    def elsewhere(*where: Any) -> Search | Reason:
        looked = search(*where)
        if isinstance(looked, Reason):
            return looked
        peaks = tuple(replace(peak, pose=moved(peak.pose, right)) for peak in looked.found.peaks)
        return replace(looked, found=replace(looked.found, peaks=peaks), finer=())

    monkeypatch.setattr(methods, "search", elsewhere)


@pytest.mark.parametrize(("height", "is_found"), [(FLOOR, True), (None, False)], ids=["level", "free"])
def test_on_a_level_a_start_is_tried_itself_where_the_search_leads_nowhere(
    monkeypatch: pytest.MonkeyPatch, portrait: Portrait, t11: PalletModel, height: Height, is_found: bool
) -> None:
    misled(monkeypatch, 0.2)
    outcome = measured(portrait(t11, POSE), t11, moved(POSE, 0.004, 0.006), height)
    assert isinstance(outcome, Fit) is is_found
    if is_found:
        assert np.abs(wrong(outcome)[:3]).max() < 0.01


def test_what_the_search_leads_to_counts_where_the_start_itself_leads_nowhere(
    monkeypatch: pytest.MonkeyPatch, portrait: Portrait, t11: PalletModel
) -> None:
    misled(monkeypatch, 0.2)
    both = measured(portrait(t11, POSE), t11, moved(POSE, 0.25))
    assert isinstance(both, Refusal)
    assert both.stage is Stage.VERIFICATION


@pytest.mark.parametrize("method", Method)
def test_every_method_leaves_its_input_as_it_was(method: Method, floor_shot: Shot, floor_pallets: Pallets) -> None:
    model, pose = floor_pallets[1]
    image, config = floor_shot.image.copy(), replace(CONFIG, joint_search=JointSearchConfig(turns=3, depths=3))
    candidate = Candidate(model, moved(pose, 0.01, 0.02, turn_deg=1.0), FLOOR, 0.5)
    first, second = (METHODS[method](floor_shot, candidate, config) for _ in range(2))
    np.testing.assert_array_equal(floor_shot.image, image)
    assert candidate == Candidate(model, moved(pose, 0.01, 0.02, turn_deg=1.0), FLOOR, 0.5)
    for outcome in (first, second):
        assert outcome.candidate == candidate or (method is Method.JOINT_SEARCH and outcome.rank != 0.5)
    if isinstance(first, Fit):
        assert isinstance(second, Fit)
        assert first.pose == second.pose
        np.testing.assert_array_equal(first.covariance, second.covariance)
    else:  # the paper's sweep has no height to hold on to, and nine hypotheses leave the place open
        assert isinstance(second, Refusal)
        assert method in {Method.PAPER, Method.JOINT_SEARCH}
        assert first.reason == second.reason
