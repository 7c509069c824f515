from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations

import cv2
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from palletloc import Candidate, Fit, LevelPose, LocalizerConfig, PalletModel, Refusal, Shot, verification
from palletloc.contrast import opening_contrasts
from palletloc.geometry import FloatArray
from palletloc.measurement import Reason, Stage, YawSource
from palletloc.methods import measure_refined
from palletloc.overlap import exclude_overlaps
from palletloc.refinement.face_fit import FaceEstimate, FaceFitConfig, FacePrior, YawPrior, fit_face
from palletloc.refinement.hypotheses import score_pose
from palletloc.refinement.patch import FacePatch, view_patch
from palletloc.verification import Evidence, VerificationConfig, of_use, verify
from tests.palletloc.poses import FLOOR, POSE, Outcome, Portrait

CONFIG = VerificationConfig()


def fitted(shot: Shot, model: PalletModel) -> FaceEstimate | Reason:
    return fit_face(shot, POSE, model, FacePrior(FLOOR, YawPrior(0.002, 0.0), 0.1), FaceFitConfig())


def surroundings(shot: Shot) -> FacePatch:
    seen = view_patch(shot, POSE, (-0.7, 0.7, -0.1, 0.25), 0.005)
    assert isinstance(seen, FacePatch)
    return seen


def boarded_up(shot: Shot, model: PalletModel) -> Shot:
    """The shot with a board over each opening and a little more, in the colour of the middle block."""

    def pixels(points: list[tuple[float, float]]) -> FloatArray:
        in_pallet = [[0.0, -right, up] for right, up in points]
        in_camera = shot.mounting.to_camera.apply(POSE.transform().apply(in_pallet))
        return shot.camera.project(in_camera).pixels

    image, high = shot.image.copy(), model.height / 2
    column, row = np.rint(pixels([(0.0, high)])[0]).astype(int)
    for hole in model.openings:
        left, right, low, top = hole.left - 0.015, hole.right + 0.015, hole.bottom - 0.015, hole.top + 0.015
        corners = [(left, low), (right, low), (right, top), (left, top)]
        cv2.fillPoly(image, [np.rint(pixels(corners)).astype(np.int32)], image[row, column].tolist())
    return replace(shot, image=image)


def test_a_pallet_passes_in_its_place(model: PalletModel, portrait: Portrait) -> None:
    shot = portrait(model, POSE)
    face, patch = fitted(shot, model), surroundings(shot)
    assert isinstance(face, FaceEstimate)
    contrast = float(opening_contrasts(patch, model, POSE).min())
    score = score_pose(patch, model, face.forklift_from_pallet)
    found = Evidence(contrast, face.coverage, score, face.doubt)
    assert verify(found, CONFIG) is None
    assert CONFIG.min_rank <= found.probability <= 1.0


def test_a_face_without_openings_is_no_pallet(model: PalletModel, portrait: Portrait) -> None:
    shot = portrait(model, POSE)
    board = boarded_up(shot, model)
    contrast = float(opening_contrasts(surroundings(board), model, POSE).min())
    assert contrast < 1.5
    score = score_pose(surroundings(board), model, POSE)
    assert score < score_pose(surroundings(shot), model, POSE)
    face = fitted(board, model)
    if isinstance(face, FaceEstimate):
        assert verify(Evidence(contrast, face.coverage, score, face.doubt), CONFIG) is not None


signs = st.builds(Evidence, st.floats(0.0, 40.0), st.floats(0.0, 1.0), st.floats(-0.5, 1.5), st.floats(0.0, 12.0))


@given(signs, st.floats(0.05, 0.95))
def test_what_is_less_likely_a_pallet_than_is_asked_for_is_refused(seen: Evidence, least: float) -> None:
    assert 0.0 <= seen.probability <= 1.0
    assert (verify(seen, replace(CONFIG, min_rank=least)) is None) is (seen.probability >= least)


@given(signs, st.floats(0.01, 1.0))
def test_more_of_a_good_sign_never_makes_a_pallet_less_likely(seen: Evidence, more: float) -> None:
    for better in (
        replace(seen, contrast=seen.contrast + more),
        replace(seen, coverage=min(seen.coverage + more, 1.0)),
        replace(seen, score=seen.score + more),
        replace(seen, doubt=max(seen.doubt - more, 0.0)),
    ):
        assert better.probability >= seen.probability - 1e-12


@given(signs, st.floats(0.05, 1.0), st.floats(0.0, 1.0))
def test_what_seems_hidden_speaks_against_a_pallet_and_what_stands_before_it_explains_a_part(
    plain: Evidence, hidden: float, share: float
) -> None:
    covered, explained, wholly = (
        replace(plain, hidden=hidden, explained=part * hidden) for part in (0.0, share, 1.0)
    )
    assert covered.total < plain.total
    assert covered.probability <= plain.probability
    assert covered.total <= explained.total <= plain.total
    assert wholly.total > covered.total
    assert explained.visible == pytest.approx(covered.visible)


def test_every_sign_counts_and_a_face_of_few_pixels_must_show_more() -> None:
    plain = Evidence(2.0, 0.5, 0.5, 2.0)
    for sign in ({"contrast": 3.0}, {"coverage": 0.7}, {"score": 0.6}, {"doubt": 1.0}):
        assert replace(plain, **sign).probability > plain.probability + 0.01
    seen = Evidence(3.0, 0.75, 0.6, 2.0)
    assert verify(seen, CONFIG) is None
    assert verify(replace(seen, width_px=25.0), CONFIG) is not None


@given(signs, st.floats(0.0, 500.0))
def test_few_pixels_never_make_a_pallet_more_likely(large: Evidence, width: float) -> None:
    small = replace(large, width_px=width)
    assert small.probability <= large.probability
    assert (small.probability > 0.5) <= (large.probability > 0.5)


@pytest.mark.parametrize(
    ("sign", "reason"),
    [
        ((0.5, 0.9, 0.5, 1.0), Reason.LOW_CONTRAST),
        ((6.0, 0.1, 0.1, 6.0), Reason.FEW_EDGES),
        ((1.0, 0.0, 0.0, 8.0), Reason.FEW_EDGES),
    ],
)
def test_the_reason_is_what_speaks_most_against_it(sign: tuple[float, float, float, float], reason: Reason) -> None:
    assert verify(Evidence(*sign), CONFIG) is reason


@given(st.floats(0.001, 0.2), st.floats(0.0005, 0.1), st.floats(0.001, 0.5), st.floats(-3.1, 3.1))
def test_a_pose_is_of_use_if_its_longest_axis_on_the_floor_and_its_yaw_are_sure(
    along: float, yaw: float, up: float, direction: float
) -> None:
    cos, sin = np.cos(direction), np.sin(direction)
    turn = np.eye(4)
    turn[:2, :2] = [[cos, -sin], [sin, cos]]
    covariance = turn @ np.diag([along**2, (0.1 * along) ** 2, up**2, yaw**2]) @ turn.T
    limits = (CONFIG.max_sigma, np.radians(CONFIG.max_yaw_sigma_deg))
    if min(abs(along / limits[0] - 1), abs(yaw / limits[1] - 1)) > 1e-6:
        assert bool(of_use(covariance, CONFIG)) is bool(along <= limits[0] and yaw <= limits[1])


# Of candidates that stand in each other, those stay that together are the likeliest.


def placed(model: PalletModel, x: float, score: float) -> Fit:
    pose = LevelPose(x, 2.0, 0.0, np.pi / 2)
    return Fit(Candidate(model, pose, None, score), pose, np.eye(4), YawSource.FACE)


def given_up(fit: Fit, reason: Reason) -> Refusal:
    return Refusal(fit.candidate, Stage.VERIFICATION, reason, fit)


def excluded(*outcomes: Outcome) -> list[Outcome]:
    """Return what stays, after a check that everything else is as it was."""
    found = exclude_overlaps(outcomes, CONFIG)
    for before, after in zip(outcomes, found, strict=True):
        if after is not before:
            assert isinstance(before, Fit)
            assert isinstance(after, Refusal)
            assert (after.candidate, after.fit) == (before.candidate, before)
            assert (after.stage, after.reason) == (Stage.VERIFICATION, Reason.OVERLAP)
    return found


def stays(*outcomes: Outcome) -> list[bool]:
    return [isinstance(outcome, Fit) for outcome in excluded(*outcomes)]


def test_the_better_of_two_stays_and_what_was_refused_excludes_nothing(epal: PalletModel, t11: PalletModel) -> None:
    weak, strong, aside = placed(epal, 0.0, 0.5), placed(t11, 0.3, 0.8), placed(epal, 1.6, 0.4)
    refused = given_up(placed(epal, 0.0, 0.99), Reason.FEW_EDGES)
    assert stays(weak, refused, strong, aside) == [False, False, True, True]
    assert excluded(weak, refused, strong, aside)[1] is refused
    wrong = given_up(placed(t11, 0.1, 0.9), Reason.OVERLAP)
    assert stays(wrong, placed(epal, 0.0, 0.8)) == [False, True]
    assert stays(*(placed(epal, 0.8 * i, 0.9 - 0.1 * i) for i in range(3))) == [True, False, True]
    unseen = Refusal(Candidate(epal, LevelPose(0.0, 2.0, 0.0, 1.5)), Stage.SEARCH, Reason.NO_PEAK)
    assert excluded() == []
    assert excluded(unseen) == [unseen]
    assert stays(unseen, placed(epal, 0.0, 0.1)) == [False, True]


@pytest.mark.parametrize("reason", [Reason.UNCERTAIN, Reason.OFF_LEVEL])
def test_a_coarse_pose_that_was_given_up_keeps_worse_ones_away(reason: Reason, epal: PalletModel) -> None:
    refused = given_up(placed(epal, 0.0, 0.6), reason)
    assert stays(refused, placed(epal, 0.45, 0.4)) == [False, False]
    assert stays(refused, placed(epal, 0.45, 0.8)) == [False, True]
    assert stays(refused, placed(epal, 1.3, 0.4)) == [False, True]


@pytest.mark.parametrize(("aside", "expected"), [(0.0, True), (0.45, False)])
def test_what_is_uncertain_keeps_others_away_but_not_a_better_fit_of_its_own_pallet(
    aside: float, expected: bool, portrait: Portrait, t11: PalletModel
) -> None:
    known = measure_refined(portrait(t11, POSE), Candidate(t11, POSE, FLOOR), LocalizerConfig())
    assert isinstance(known, Fit)
    assert known.face is not None
    there = replace(POSE, x=POSE.x + aside)
    uncertain = replace(known, pose=there, face=replace(known.face, forklift_from_pallet=there))
    assert stays(given_up(uncertain, Reason.UNCERTAIN), known) == [False, expected]


def shown(model: PalletModel, x: float, evidence: float) -> Fit:
    """A fit whose signs are those of most places, but for a score that gives it so much evidence."""
    signs = Evidence(
        verification.USUAL_CONTRAST,
        verification.USUAL_COVERAGE,
        verification.USUAL_SCORE + evidence / verification.SCORE,
        verification.USUAL_DOUBT - 0.5,
    )
    assert signs.visible == pytest.approx(evidence)
    return replace(placed(model, x, 0.5), evidence=signs)


def test_two_pallets_outweigh_one_that_stands_in_both_but_two_mere_scores_no_higher_one(epal: PalletModel) -> None:
    left, between, right = shown(epal, 0.0, 1.2), shown(epal, 0.65, 1.8), shown(epal, 1.3, 1.0)
    assert stays(between, left, right) == [False, True, True]
    left, between, right = shown(epal, 0.0, 0.8), shown(epal, 0.65, 1.9), shown(epal, 1.3, 1.0)
    assert stays(between, left, right) == [True, False, False]
    left, between, right = placed(epal, 0.0, 0.6), placed(epal, 0.65, 0.7), placed(epal, 1.3, 0.6)
    assert stays(left, between, right) == [False, True, False]


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.lists(st.tuples(st.floats(0.0, 6.0), st.floats(0.1, 2.5)), max_size=9))
def test_what_stays_weighs_the_most(epal: PalletModel, places: list[tuple[float, float]]) -> None:
    found = stays(*(shown(epal, x, evidence) for x, evidence in places))
    apart = 0.9 * epal.width

    def free(chosen: Sequence[tuple[float, float]]) -> bool:
        return all(abs(here[0] - there[0]) >= apart for here, there in combinations(chosen, 2))

    kept = [place for place, is_kept in zip(places, found, strict=True) if is_kept]
    assert free(kept)
    subsets = (some for count in range(len(places) + 1) for some in combinations(places, count) if free(some))
    assert sum(weight for _, weight in kept) == pytest.approx(
        max(sum(weight for _, weight in some) for some in subsets)
    )
