from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from palletloc.exclusivity import challenge, exclude_overlaps
from palletloc.refined import measure_refined

from palletloc.candidate import Candidate, ShotView
from palletloc.config import LocalizerConfig
from palletloc.geometry import LevelPose
from palletloc.localizer import Localizer, Start
from palletloc.measurement import HeightPrior, Reason, Stage
from palletloc.pallet import PalletModel
from palletloc.verification import (
    SCORE,
    USUAL_CONTRAST,
    USUAL_COVERAGE,
    USUAL_DOUBT,
    USUAL_SCORE,
    Signs,
    Verification,
)

CONFIG = LocalizerConfig()
POSE = LevelPose(0.9, 2.0, 0.0, np.pi / 2 + 0.02)
Portrait = Callable[..., ShotView]


def candidate(model: PalletModel, x: float, score: float) -> Candidate:
    pose = LevelPose(x, 2.0, 0.0, np.pi / 2)
    return Candidate(model, pose, None, score, pose=pose, covariance=np.eye(4))


def test_of_two_pallets_in_one_place_the_better_stays(epal: PalletModel, t11: PalletModel) -> None:
    weak, strong, aside = candidate(epal, 0.0, 0.5), candidate(t11, 0.3, 0.8), candidate(epal, 1.6, 0.4)
    refused = candidate(epal, 0.0, 0.99)
    refused.refuse(Stage.VERIFICATION, Reason.FEW_EDGES)
    exclude_overlaps([weak, refused, strong, aside])
    assert weak.refusal == (Stage.VERIFICATION, Reason.OVERLAP)
    assert (strong.refusal, aside.refusal) == (None, None)
    assert refused.refusal == (Stage.VERIFICATION, Reason.FEW_EDGES)


def test_what_was_excluded_excludes_nothing(epal: PalletModel) -> None:
    chain = [candidate(epal, 0.8 * i, 0.9 - 0.1 * i) for i in range(3)]
    exclude_overlaps(chain)
    assert [one.refusal is None for one in chain] == [True, False, True]


def test_the_wrong_model_does_not_keep_the_place_of_the_right_one(epal: PalletModel, t11: PalletModel) -> None:
    wrong, right = candidate(t11, 0.1, 0.9), candidate(epal, 0.0, 0.8)
    wrong.refuse(Stage.VERIFICATION, Reason.OVERLAP)
    exclude_overlaps([wrong, right])
    assert right.refusal is None


def seen_as(shot: ShotView, model: PalletModel, other: PalletModel) -> LevelPose:
    """Return where another model would look as wide as one at `POSE`."""
    center = shot.mounting.center
    place = center + other.width / model.width * (np.array([POSE.x, POSE.y, POSE.z]) - center)
    x, y, z = place.tolist()
    return LevelPose(x, y, z, POSE.yaw)


@pytest.mark.parametrize("names", [("epal", "t11"), ("t11", "epal")], ids="-as-".join)
def test_at_any_height_a_model_gives_way_to_the_one_that_stands_there(
    names: tuple[str, str], portrait: Portrait, request: pytest.FixtureRequest
) -> None:
    model, other = (request.getfixturevalue(name) for name in names)
    shot = portrait(model, POSE)
    found = Localizer(shot.projector.camera, shot.mounting, [model, other])
    starts = [Start(other.name, seen_as(shot, model, other)), Start(model.name, POSE)]
    wrong, right = found.explain_from(shot.image, 0.0, starts).candidates
    assert wrong.refusal is not None
    assert right.refusal is None
    assert right.pose is not None
    assert np.abs(right.pose.as_array() - POSE.as_array())[:3].max() < 0.03


def test_a_model_that_looks_alike_is_no_contradiction(portrait: Portrait, t11: PalletModel) -> None:
    shot, alike = portrait(t11, POSE), replace(t11, name="alike", width=t11.width + 0.002)
    alone, beside = (
        Localizer(shot.projector.camera, shot.mounting, models).localize_from(shot.image, 0.0, [Start("t11", POSE)])[
            0
        ]
        for models in ([t11], [t11, alike])
    )
    assert alone is not None
    assert beside is not None
    assert beside.forklift_from_pallet == alone.forklift_from_pallet
    assert (np.diag(beside.covariance) >= np.diag(alone.covariance)).all()


@pytest.mark.parametrize(("aside", "stays"), [(0.0, True), (0.45, False)])
def test_what_is_uncertain_keeps_others_away_but_not_a_better_fit_of_its_own_pallet(
    aside: float, stays: bool, portrait: Portrait, t11: PalletModel
) -> None:
    shot = portrait(t11, POSE)
    known = Candidate(t11, POSE, HeightPrior(0.0, 0.003))
    measure_refined(shot, known, CONFIG)
    assert known.face is not None
    there = replace(POSE, x=POSE.x + aside)
    uncertain = replace(known, pose=there, face=replace(known.face, forklift_from_pallet=there))
    uncertain.refuse(Stage.VERIFICATION, Reason.UNCERTAIN)
    exclude_overlaps([uncertain, known])
    assert (known.refusal is None) is stays
    assert uncertain.refusal == (Stage.VERIFICATION, Reason.UNCERTAIN)


def test_where_the_level_is_known_no_other_model_is_tried(portrait: Portrait, t11: PalletModel) -> None:
    def never(*_: object) -> None:
        raise AssertionError("no other model has to be measured")

    shot, known = portrait(t11, POSE), Candidate(t11, POSE, HeightPrior(0.0, 0.003))
    measure_refined(shot, known, CONFIG)
    assert known.refusal is None
    challenge(shot, known, [replace(t11, width=1.2)], never, CONFIG)
    assert known.refusal is None


def shown(model: PalletModel, x: float, evidence: float) -> Candidate:
    """A candidate whose signs are those of most places, but for a score that gives it so much evidence."""
    found = candidate(model, x, 0.5)
    signs = Signs(USUAL_CONTRAST, USUAL_COVERAGE, USUAL_SCORE + evidence / SCORE, USUAL_DOUBT - 0.5)
    found.verification = Verification(signs, None)
    assert found.weight == pytest.approx(evidence)
    return found


def test_two_pallets_side_by_side_outweigh_one_that_stands_in_both(epal: PalletModel) -> None:
    left, between, right = shown(epal, 0.0, 1.2), shown(epal, 0.65, 1.8), shown(epal, 1.3, 1.0)
    exclude_overlaps([between, left, right])
    assert [one.refusal is None for one in (left, between, right)] == [True, False, True]
    left, between, right = shown(epal, 0.0, 0.8), shown(epal, 0.65, 1.9), shown(epal, 1.3, 1.0)
    exclude_overlaps([between, left, right])
    assert [one.refusal is None for one in (left, between, right)] == [False, True, False]


def test_two_mere_scores_do_not_outweigh_a_higher_one(epal: PalletModel) -> None:
    left, between, right = candidate(epal, 0.0, 0.6), candidate(epal, 0.65, 0.7), candidate(epal, 1.3, 0.6)
    exclude_overlaps([left, between, right])
    assert [one.refusal is None for one in (left, between, right)] == [False, True, False]


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.lists(st.tuples(st.floats(0.0, 6.0), st.floats(0.1, 2.5)), max_size=9))
def test_what_stays_weighs_the_most(epal: PalletModel, places: list[tuple[float, float]]) -> None:
    found = [shown(epal, x, evidence) for x, evidence in places]
    exclude_overlaps(found)
    apart = 0.9 * epal.width

    def free(chosen: Sequence[tuple[float, float]]) -> bool:
        return all(abs(one[0] - other[0]) >= apart for one, other in combinations(chosen, 2))

    kept = [place for place, one in zip(places, found, strict=True) if one.refusal is None]
    assert free(kept)
    subsets = (some for count in range(len(places) + 1) for some in combinations(places, count) if free(some))
    assert sum(weight for _, weight in kept) == pytest.approx(
        max(sum(weight for _, weight in some) for some in subsets)
    )
