"""Other explanations of the image in a fit's place: when there is one, and how likely it is against the fit."""

import math
from dataclasses import replace

import numpy as np
import pytest

from palletloc import Candidate, Fit, LevelPose, LocalizerConfig, PalletModel, Refusal, Shot
from palletloc.fitting import FitStart, decide, fit_from_starts
from palletloc.measurement import HeightPrior, Reason, Stage, YawSource
from palletloc.methods import measure_refined
from palletloc.refinement.face_fit import FaceEstimate, FacePrior, fit_face
from palletloc.refinement.patch import FacePatch, view_patch
from palletloc.rivals import Rival, any_height, one_opening_aside, other_starts, own_start, wide_start
from palletloc.verification import Evidence
from tests.palletloc.poses import CONFIG, FLOOR, POSE, Height, Outcome, Portrait, found, moved

CERTAIN, DOUBTFUL = Evidence(4.0, 1.0, 0.8, 0.1), Evidence(2.2, 0.6, 0.5, 3.0)


def measured(shot: Shot, model: PalletModel, start: LevelPose = POSE, height: Height = FLOOR) -> Outcome:
    return measure_refined(shot, Candidate(model, start, height), CONFIG)


def given_up(fit: Fit, reason: Reason = Reason.UNCERTAIN) -> Refusal:
    return Refusal(fit.candidate, Stage.VERIFICATION, reason, fit)


def never(*_: object) -> Outcome:
    raise AssertionError("nothing has to be measured")


# Other starts of the search, and the candidate's own.


def test_every_other_attempt_that_measured_something_is_a_rival(portrait: Portrait, t11: PalletModel) -> None:
    best = found(measured(portrait(t11, POSE), t11))
    less = replace(best, pose=moved(best.pose, 0.05), evidence=DOUBTFUL)
    unseen = Refusal(best.candidate, Stage.POSITION, Reason.FEW_EDGES)
    first, second = other_starts(best, [less, best, unseen, given_up(less)])
    assert (first.nats, first.wins) == (less.likelihood - best.likelihood, False)
    assert first.nats < 0
    np.testing.assert_allclose(first.apart, less.pose.minus(best.pose))
    np.testing.assert_array_equal(second.apart, first.apart)


def test_on_a_level_the_own_start_is_tried_where_the_search_led_nowhere(portrait: Portrait, t11: PalletModel) -> None:
    best = found(measured(portrait(t11, POSE), t11))
    raised = replace(given_up(best), candidate=replace(best.candidate, start=replace(POSE, z=0.2)))
    tried: list[LevelPose] = []

    def measure(pose: LevelPose) -> Fit:
        tried.append(pose)
        return best

    (rival,) = own_start(raised, measure)
    assert tried == [POSE]
    assert rival.wins
    assert rival.instead is best
    assert list(own_start(raised, lambda _: given_up(best))) == []
    free = replace(given_up(best), candidate=replace(best.candidate, height=None))
    assert list(own_start(best, never)) == list(own_start(free, never)) == []


def test_a_start_is_searched_widely_if_nothing_near_is_beyond_doubt(portrait: Portrait, t11: PalletModel) -> None:
    shot = portrait(t11, POSE)
    best = found(measured(shot, t11))
    assert best.face is not None
    unseen = Refusal(best.candidate, Stage.START, Reason.BEHIND_FACE)
    for settled in (replace(best, evidence=CERTAIN), replace(best, face=None), unseen):
        assert list(wide_start(shot, settled, never, CONFIG)) == []
    widths: list[float] = []

    def measure(_: Shot, candidate: Candidate, config: LocalizerConfig) -> Fit:
        assert candidate is best.candidate
        widths.extend([config.search.nearer, config.position.farther, config.search.turn_deg])
        return best

    (instead,) = wide_start(shot, given_up(best), measure, CONFIG)
    assert instead.instead is best
    assert widths == [CONFIG.prior.start_nearer, CONFIG.prior.start_farther, CONFIG.prior.start_turn_deg]
    # against a fit of doubt, the one that leaves less of it wins
    for doubt, wins in ((best.face.doubt + 1.0, True), (best.face.doubt - 0.1, False)):
        doubtful = replace(best, evidence=DOUBTFUL, face=replace(best.face, doubt=doubt))
        (rival,) = wide_start(shot, doubtful, measure, CONFIG)
        assert rival.wins is wins


# One opening aside.


def believed(shot: Shot, model: PalletModel, right: float, hidden: float) -> Fit:
    """Return a fit that was measured aside and believed, as if something stood before its missing end."""
    fit = found(measured(shot, model))
    there = moved(fit.pose, right)
    evidence = Evidence(3.0, 0.8, 0.5, 1.0, hidden, hidden)
    return replace(fit, candidate=replace(fit.candidate, start=there), pose=there, evidence=evidence)


@pytest.mark.parametrize("side", [-1, 1])
@pytest.mark.parametrize("model", ["epal", "t11"], indirect=True)
def test_a_pallet_taken_one_opening_aside_is_taken_back(portrait: Portrait, model: PalletModel, side: int) -> None:
    shot = portrait(model, POSE)
    alias = believed(shot, model, side * (model.openings[1].center - model.openings[0].center), 0.3)
    back = decide(alias, one_opening_aside(shot, alias, measure_refined, CONFIG), CONFIG)
    assert isinstance(back, Fit)
    assert np.hypot(*back.pose.minus(POSE)[:2]) < 0.01
    assert back.candidate is alias.candidate


def test_the_right_one_stays_and_none_beyond_doubt_is_asked_again(portrait: Portrait, epal: PalletModel) -> None:
    shot = portrait(epal, POSE)
    fit = found(measured(shot, epal))
    assert fit.evidence is not None
    doubtful = replace(fit, evidence=replace(fit.evidence, hidden=0.1))
    kept = decide(doubtful, one_opening_aside(shot, doubtful, measure_refined, CONFIG), CONFIG)
    assert isinstance(kept, Fit)
    assert kept.pose is fit.pose
    np.testing.assert_array_equal(kept.covariance, fit.covariance)
    certain = replace(found(measured(shot, epal)), evidence=CERTAIN)
    assert certain.rank >= CONFIG.verification.certain
    for settled in (certain, given_up(certain), replace(certain, face=None)):
        assert list(one_opening_aside(shot, settled, never, CONFIG)) == []
    hidden = believed(shot, epal, 0.0, 0.1)
    assert len(list(one_opening_aside(shot, hidden, measure_refined, CONFIG))) == 2


def test_a_rival_that_fails_its_checks_still_refuses(portrait: Portrait, epal: PalletModel) -> None:
    shot = portrait(epal, POSE)
    alias = believed(shot, epal, float(epal.openings[1].center - epal.openings[0].center), 0.3)

    def measure_badly(shot: Shot, candidate: Candidate, config: LocalizerConfig) -> Outcome:
        rival = measure_refined(shot, candidate, config)
        return given_up(rival) if isinstance(rival, Fit) else rival

    refused = decide(alias, one_opening_aside(shot, alias, measure_badly, CONFIG), CONFIG)
    assert isinstance(refused, Refusal)
    assert (refused.stage, refused.reason, refused.fit) == (Stage.VERIFICATION, Reason.OVERLAP, alias)


# The same face at any height.


def lifted(shot: Shot, pose: LevelPose, height: float) -> LevelPose:
    """Return a pose on another height that appears at the same place in the image."""
    center = shot.mounting.center
    factor = (height - center[2]) / (pose.z - center[2])
    x, y = center[:2] + factor * (np.array([pose.x, pose.y]) - center[:2])
    return LevelPose(float(x), float(y), height, pose.yaw)


def on_level(shot: Shot, model: PalletModel, level: float) -> Fit:
    """Return a pallet fitted on a level, whether it stands there or not."""
    prior = FacePrior(HeightPrior(level, 0.003), None, float(np.radians(5.0)))
    face = fit_face(shot, lifted(shot, POSE, level), model, prior, CONFIG.face_fit)
    assert isinstance(face, FaceEstimate)
    pose = face.forklift_from_pallet
    return Fit(Candidate(model, POSE, prior.height), pose, face.covariance, YawSource.FACE, face, prior)


def test_a_right_level_is_not_contradicted(model: PalletModel, portrait: Portrait) -> None:
    shot = portrait(model, POSE)
    for rival in any_height(shot, on_level(shot, model, POSE.z), CONFIG):
        assert not rival.wins
        assert rival.sigmas < 3.0
        assert rival.nats < math.log(0.05 / 0.95)


@pytest.mark.parametrize("off", [-0.06, -0.05, 0.05, 0.06])
def test_a_level_wrong_by_centimetres_is_contradicted(model: PalletModel, off: float, portrait: Portrait) -> None:
    shot = portrait(model, POSE)
    (rival,) = any_height(shot, on_level(shot, model, POSE.z + off), CONFIG)
    assert rival.wins
    assert (rival.reason, rival.instead) == (Reason.OFF_LEVEL, None)
    assert rival.apart[2] * -np.sign(off) > 0.01  # towards where it stands


def test_nothing_is_said_without_a_level_or_edges_or_doubt(portrait: Portrait, t11: PalletModel) -> None:
    shot = portrait(t11, POSE)
    wrong = on_level(shot, t11, 0.06)
    assert wrong.face is not None
    free = replace(wrong, candidate=replace(wrong.candidate, height=None))
    for best in (free, replace(wrong, face=None), replace(wrong, face=replace(wrong.face, doubt=0.9))):
        assert list(any_height(shot, best, CONFIG)) == []


@pytest.mark.parametrize(
    ("sigmas", "odds", "wins"), [(9.0, 4.6, True), (9.0, -0.4, False), (0.1, 4.6, False), (0.0, -99.0, False)]
)
def test_only_what_stands_apart_and_is_likelier_wins(sigmas: float, odds: float, wins: bool) -> None:
    assert Rival(odds, np.zeros(4), sigmas, Reason.OFF_LEVEL).wins is wins


@pytest.mark.parametrize("off", [-0.06, 0.06])
def test_a_contradicted_level_is_the_reason(off: float, portrait: Portrait, epal: PalletModel) -> None:
    shot = portrait(epal, POSE)
    start = lifted(shot, POSE, off)
    patch = view_patch(shot, start, (-0.75, 0.75, -0.1, 0.3), 0.005)
    assert isinstance(patch, FacePatch)
    candidate = Candidate(epal, start, HeightPrior(off, 0.003))
    refused = fit_from_starts(
        shot, candidate, [(start, patch)], lambda pose: FitStart(pose, YawSource.FACE), False, CONFIG
    )
    assert isinstance(refused, Refusal)
    assert refused.reason in (Reason.OFF_LEVEL, Reason.FEW_EDGES)
