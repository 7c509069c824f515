"""Of candidates that stand in each other, those stay that together are the likeliest."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from palletloc.candidate import Candidate, Fit, Refusal
from palletloc.config import LocalizerConfig
from palletloc.geometry import LevelPose
from palletloc.measurement import HeightPrior, Reason, Stage, YawSource
from palletloc.methods import measure_refined
from palletloc.overlap import exclude_overlaps
from palletloc.pallet import PalletModel
from palletloc.shot import Shot
from palletloc.verification import SCORE, USUAL_CONTRAST, USUAL_COVERAGE, USUAL_DOUBT, USUAL_SCORE, Evidence

CONFIG = LocalizerConfig()
Outcome = Fit | Refusal


def placed(model: PalletModel, x: float, score: float) -> Fit:
    pose = LevelPose(x, 2.0, 0.0, np.pi / 2)
    return Fit(Candidate(model, pose, None, score), pose, np.eye(4), YawSource.FACE)


def given_up(fit: Fit, reason: Reason) -> Refusal:
    return Refusal(fit.candidate, Stage.VERIFICATION, reason, fit)


def excluded(*outcomes: Outcome) -> list[Outcome]:
    """Return what stays, after a check that everything else is as it was."""
    found = exclude_overlaps(outcomes, CONFIG.verification)
    for before, after in zip(outcomes, found, strict=True):
        if after is not before:
            assert isinstance(before, Fit)
            assert isinstance(after, Refusal)
            assert (after.candidate, after.stage, after.reason) == (
                before.candidate,
                Stage.VERIFICATION,
                Reason.OVERLAP,
            )
            assert after.fit is before
    return found


def stays(*outcomes: Outcome) -> list[bool]:
    return [isinstance(outcome, Fit) for outcome in excluded(*outcomes)]


def test_of_two_pallets_in_one_place_the_better_stays(epal: PalletModel, t11: PalletModel) -> None:
    weak, strong, aside = placed(epal, 0.0, 0.5), placed(t11, 0.3, 0.8), placed(epal, 1.6, 0.4)
    refused = given_up(placed(epal, 0.0, 0.99), Reason.FEW_EDGES)
    assert stays(weak, refused, strong, aside) == [False, False, True, True]
    assert excluded(weak, refused, strong, aside)[1] is refused


def test_what_was_excluded_excludes_nothing(epal: PalletModel) -> None:
    assert stays(*(placed(epal, 0.8 * i, 0.9 - 0.1 * i) for i in range(3))) == [True, False, True]


def test_the_wrong_model_does_not_keep_the_place_of_the_right_one(epal: PalletModel, t11: PalletModel) -> None:
    wrong = given_up(placed(t11, 0.1, 0.9), Reason.OVERLAP)
    assert stays(wrong, placed(epal, 0.0, 0.8)) == [False, True]


def test_nothing_excludes_nothing(epal: PalletModel) -> None:
    start = LevelPose(0.0, 2.0, 0.0, 1.5)
    unseen = Refusal(Candidate(epal, start), Stage.SEARCH, Reason.NO_PEAK)
    assert excluded() == []
    assert excluded(unseen) == [unseen]
    assert stays(unseen, placed(epal, 0.0, 0.1)) == [False, True]


@pytest.mark.parametrize(("aside", "expected"), [(0.0, True), (0.45, False)])
def test_what_is_uncertain_keeps_others_away_but_not_a_better_fit_of_its_own_pallet(
    aside: float, expected: bool, portrait: Callable[..., Shot], t11: PalletModel
) -> None:
    pose = LevelPose(0.9, 2.0, 0.0, np.pi / 2 + 0.02)
    known = measure_refined(portrait(t11, pose), Candidate(t11, pose, HeightPrior(0.0, 0.003)), CONFIG)
    assert isinstance(known, Fit)
    assert known.face is not None
    there = replace(pose, x=pose.x + aside)
    uncertain = replace(known, pose=there, face=replace(known.face, forklift_from_pallet=there))
    assert stays(given_up(uncertain, Reason.UNCERTAIN), known) == [False, expected]


def shown(model: PalletModel, x: float, evidence: float) -> Fit:
    """A fit whose signs are those of most places, but for a score that gives it so much evidence."""
    signs = Evidence(USUAL_CONTRAST, USUAL_COVERAGE, USUAL_SCORE + evidence / SCORE, USUAL_DOUBT - 0.5)
    assert signs.visible == pytest.approx(evidence)
    return replace(placed(model, x, 0.5), evidence=signs)


def test_two_pallets_side_by_side_outweigh_one_that_stands_in_both(epal: PalletModel) -> None:
    left, between, right = shown(epal, 0.0, 1.2), shown(epal, 0.65, 1.8), shown(epal, 1.3, 1.0)
    assert stays(between, left, right) == [False, True, True]
    left, between, right = shown(epal, 0.0, 0.8), shown(epal, 0.65, 1.9), shown(epal, 1.3, 1.0)
    assert stays(between, left, right) == [True, False, False]


def test_two_mere_scores_do_not_outweigh_a_higher_one(epal: PalletModel) -> None:
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
