"""The decision between a fit and its rivals: likelier ones that stand apart win, others widen its covariance."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from palletloc.candidate import Candidate, Fit, Refusal
from palletloc.config import LocalizerConfig
from palletloc.fitting import decide
from palletloc.geometry import FloatArray, LevelPose
from palletloc.measurement import HeightPrior, Reason, Stage, YawSource
from palletloc.pallet_library import load_library
from palletloc.refinement.edges import SeenFace
from palletloc.refinement.face_fit import FaceEstimate
from palletloc.rivals import FAR_APART, Rival
from palletloc.verification import of_use

CONFIG = LocalizerConfig()
POSE = LevelPose(1.0, 2.0, 0.0, 1.5)
SURE = np.diag([0.004, 0.004, 0.002, 0.003]) ** 2
SEEN = SeenFace(np.array([0.0, 1.5, 2.0]), np.eye(4), (), (), 0.0)
FIT = Fit(
    Candidate(load_library()["t11"], POSE, HeightPrior(0.0, 0.003)),
    POSE,
    SURE,
    YawSource.BOTTOM,
    FaceEstimate(POSE, SURE, SEEN, np.zeros(0), 1.0, 0.0),
)
REFUSED = Refusal(FIT.candidate, Stage.VERIFICATION, Reason.FEW_EDGES, FIT)
OTHER = replace(FIT, pose=replace(POSE, x=1.5))
ASIDE = np.array([0.02, -0.01, 0.004, 0.003])
aside = st.lists(st.floats(-0.015, 0.015), min_size=4, max_size=4).map(np.array)
nats = st.floats(-30.0, 30.0)


def rival(
    nats: float = 0.0,
    apart: FloatArray = ASIDE,
    sigmas: float = 0.0,
    instead: Fit | None = None,
    reason: Reason = Reason.OVERLAP,
) -> Rival:
    return Rival(nats, apart, sigmas, reason, instead)


def decided(best: Fit | Refusal, *groups: list[Rival]) -> Fit | Refusal:
    """Decide, and check that nothing is written into what was given."""
    before = None if best.fit is None else best.fit.covariance.copy()
    found = decide(best, groups, CONFIG)
    if best.fit is not None and before is not None:
        np.testing.assert_array_equal(best.fit.covariance, before)
    return found


def added(found: Fit | Refusal) -> FloatArray:
    assert found.fit is not None
    return np.asarray(found.fit.covariance - SURE)


@pytest.mark.parametrize("best", [FIT, REFUSED], ids=["fit", "refused"])
def test_without_rivals_nothing_changes(best: Fit | Refusal) -> None:
    assert decided(best) is best
    assert decided(best, [], []) is best


@given(aside)
def test_an_unlikely_rival_changes_nothing(apart: FloatArray) -> None:
    found = decided(FIT, [rival(-60.0, apart, 99.0, OTHER)])
    assert isinstance(found, Fit)
    assert found.pose == FIT.pose
    np.testing.assert_allclose(added(found), 0.0, atol=1e-20)


@given(aside)
def test_an_equally_likely_rival_widens_by_half_its_squared_distance(apart: FloatArray) -> None:
    # the second moment about the fit: with both at p = 1/2, a quarter for the spread about their mean
    # and a quarter for the mean's distance from the fit, which stays where it is
    found = decided(FIT, [rival(0.0, apart)])
    spread, shift = np.outer(apart, apart) / 4, apart / 2
    np.testing.assert_allclose(added(found), spread + np.outer(shift, shift), atol=1e-12)


@given(aside, nats)
def test_it_widens_by_its_posterior_probability(apart: FloatArray, odds: float) -> None:
    probability = 1 / (1 + math.exp(-odds))
    np.testing.assert_allclose(
        added(decided(FIT, [rival(odds, apart)])), probability * np.outer(apart, apart), atol=1e-12
    )


@given(st.lists(st.tuples(nats, aside), min_size=1, max_size=4))
def test_those_of_a_group_exclude_each_other_and_the_order_does_not_matter(
    others: list[tuple[float, FloatArray]],
) -> None:
    rivals = [rival(*other) for other in others]
    weights = np.exp([0.0, *(other[0] for other in others)])
    expected = sum(w * np.outer(other[1], other[1]) for w, other in zip(weights[1:], others, strict=True))
    np.testing.assert_allclose(added(decided(FIT, rivals)), expected / weights.sum(), atol=1e-12)
    np.testing.assert_allclose(added(decided(FIT, rivals[::-1])), added(decided(FIT, rivals)), atol=1e-15)


def test_groups_widen_one_after_the_other() -> None:
    np.testing.assert_allclose(added(decided(FIT, [rival()], [rival()])), np.outer(ASIDE, ASIDE), atol=1e-15)


@given(st.floats(0.001, 50.0), st.floats(0.0, 9.0))
def test_a_likelier_one_wins_where_it_stands_apart(odds: float, sigmas: float) -> None:
    found = decided(FIT, [rival(odds, ASIDE, sigmas, reason=Reason.OFF_LEVEL)])
    if sigmas > FAR_APART:
        assert isinstance(found, Refusal)
        assert (found.stage, found.reason, found.fit) == (Stage.VERIFICATION, Reason.OFF_LEVEL, FIT)
        assert (found.candidate, found.steps) == (FIT.candidate, FIT.steps)
        assert decided(FIT, [rival(odds, ASIDE, sigmas, OTHER)]) is OTHER
    else:
        assert isinstance(found, Fit)
        assert added(found)[0, 0] > 0


@pytest.mark.parametrize("odds", [-5.0, 0.0])
def test_none_wins_that_is_not_likelier_however_far_it_stands_apart(odds: float) -> None:
    found = decided(FIT, [rival(odds, 0.1 * ASIDE, math.inf, OTHER)])
    assert isinstance(found, Fit)
    assert found.pose == FIT.pose


def test_what_was_refused_gives_way_to_a_fit_alone() -> None:
    for odds in (-math.inf, 0.0, math.inf):
        assert decided(REFUSED, [rival(odds, instead=OTHER)]) is OTHER
    for sigmas in (0.0, math.inf):
        found = decided(REFUSED, [rival(9.0, sigmas=sigmas, reason=Reason.OFF_LEVEL)])
        assert isinstance(found, Refusal)
        assert found.reason is REFUSED.reason  # only less certain
    unseen = replace(REFUSED, fit=None)
    assert decided(unseen, [rival()]) is unseen


def test_a_group_is_looked_at_no_further_than_to_the_first_that_wins() -> None:
    def alternatives() -> Iterator[Rival]:
        yield rival(-1.0)
        yield rival(1.0, sigmas=math.inf, instead=OTHER)
        raise AssertionError("the others have to be measured first")

    assert decide(FIT, [alternatives()], CONFIG) is OTHER


@given(st.floats(0.0, 0.4))
def test_a_fit_that_is_not_of_use_any_more_is_refused(along: float) -> None:
    found = decided(FIT, [rival(0.0, np.array([along, 0.0, 0.0, 0.0]))])
    useful = of_use(SURE + np.diag([along**2 / 2, 0.0, 0.0, 0.0]), CONFIG.verification)
    assert isinstance(found, Fit) is useful
    if isinstance(found, Refusal):
        assert (found.stage, found.reason) == (Stage.VERIFICATION, Reason.UNCERTAIN)


def test_a_method_without_edges_is_not_asked_for_certainty() -> None:
    coarse = replace(FIT, face=None, covariance=np.eye(4))
    assert decided(coarse) is coarse
