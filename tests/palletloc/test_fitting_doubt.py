"""What makes a fit less certain, or has it refused: level lines, missing uprights, and likelier rivals."""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from palletloc import Candidate, Fit, LevelPose, PalletModel, Refusal, fitting, load_library
from palletloc.fitting import FitStart, decide, fit_from_starts
from palletloc.geometry import FloatArray
from palletloc.measurement import HeightPrior, Reason, Stage, YawSource
from palletloc.methods import measure_refined
from palletloc.refinement.edges import SeenFace
from palletloc.refinement.face_fit import FaceEstimate, fit_face
from palletloc.refinement.level_lines import LevelYaw
from palletloc.refinement.patch import FacePatch, view_patch
from palletloc.rivals import FAR_APART, Rival
from palletloc.verification import of_use
from tests.palletloc.poses import CONFIG, FLOOR, POSE, Portrait

Change = Callable[[FaceEstimate], FaceEstimate]


@pytest.fixture
def refitted(monkeypatch: pytest.MonkeyPatch) -> Callable[[Change], None]:
    """Return a function that changes what every fit of the edges finds from now on."""

    def change(changed: Change) -> None:
        def found(*given: Any) -> FaceEstimate | Reason:
            face = fit_face(*given)
            return face if isinstance(face, Reason) else changed(face)

        monkeypatch.setattr(fitting, "fit_face", found)

    return change


Verified = Callable[[float, float], Fit | Refusal]


@pytest.fixture
def verified(refitted: Callable[[Change], None], portrait: Portrait, t11: PalletModel) -> Verified:
    """Return a function that measures a pallet whose level lines say another yaw: how far off, and its sigma."""

    def measured(turn_deg: float, sigma_deg: float) -> Fit | Refusal:
        lines = LevelYaw(float(np.radians(turn_deg)), float(np.radians(sigma_deg)), 3)
        refitted(lambda face: replace(face, level_yaw=lines))
        return measure_refined(portrait(t11, POSE), Candidate(t11, POSE, FLOOR), CONFIG)

    return measured


def grown(found: Fit | Refusal) -> FloatArray:
    """How much larger the covariance is than that of the edges."""
    assert isinstance(found, Fit)
    assert found.face is not None
    return found.covariance - found.face.covariance


@pytest.mark.parametrize(("turn_deg", "sigma_deg"), [(0.0, 0.1), (0.2, 0.1), (-0.2, 0.1), (0.9, 0.4)])
def test_lines_that_agree_change_nothing(turn_deg: float, sigma_deg: float, verified: Verified) -> None:
    np.testing.assert_allclose(grown(verified(turn_deg, sigma_deg)), 0.0, atol=1e-15)


@pytest.mark.parametrize(("turn_deg", "sigma_deg"), [(0.3, 0.1), (-0.3, 0.1), (0.7, 0.05), (-0.7, 0.2)])
def test_the_yaw_is_as_uncertain_as_lines_are_apart(turn_deg: float, sigma_deg: float, verified: Verified) -> None:
    more = grown(verified(turn_deg, sigma_deg))
    assert np.sqrt(more[3, 3]) == pytest.approx(np.radians(abs(turn_deg)), rel=1e-6)
    assert np.linalg.eigvalsh(more).min() > -1e-12


@pytest.mark.parametrize(
    ("turn_deg", "sigma_deg", "reason"),
    [
        (1.1, 0.2, Reason.YAW_DISAGREES),
        (-1.1, 0.2, Reason.YAW_DISAGREES),
        (8.0, 1.5, Reason.YAW_DISAGREES),
        (3.0, 1.0, Reason.UNCERTAIN),  # far apart, but unsure
    ],
)
def test_a_pose_is_refused_whose_lines_clearly_disagree_or_leave_it_too_uncertain(
    turn_deg: float, sigma_deg: float, reason: Reason, verified: Verified
) -> None:
    found = verified(turn_deg, sigma_deg)
    assert isinstance(found, Refusal)
    assert (found.stage, found.reason) == (Stage.VERIFICATION, reason)


def without_uprights(face: FaceEstimate, missing: int) -> FaceEstimate:
    """Return a fit that took so many uprights for those of something else, and no line of another."""
    uprights = [i for i, edge in enumerate(face.seen.edges) if not edge.edge.horizontal]
    weights = np.ones(len(face.seen.edges))
    weights[uprights[:missing]] = 0.0
    return replace(face, weights=weights, doubt=0.0)


def faint(face: FaceEstimate) -> FaceEstimate:
    """Return a fit in which level lines do not count."""
    level = np.array([edge.edge.horizontal for edge in face.seen.edges])
    return replace(face, weights=np.where(level, 0.0, 1.0), doubt=0.0)


def hidden(face: FaceEstimate) -> FaceEstimate:
    """Return a fit in which something hides three uprights."""
    lost = [edge.edge for edge in face.seen.edges if not edge.edge.horizontal][:3]
    seen = replace(
        face.seen,
        edges=tuple(edge for edge in face.seen.edges if edge.edge not in lost),
        hidden=tuple((edge.middle[0] - 0.01, edge.middle[0] + 0.01) for edge in lost),
    )
    assert {edge.middle for edge in lost} <= {edge.middle for edge in seen.hidden_lines}
    return replace(face, seen=seen, weights=np.ones(len(seen.edges)), doubt=0.0)


@pytest.fixture
def range_doubt(
    refitted: Callable[[Change], None], portrait: Portrait, t11: PalletModel
) -> Callable[..., FloatArray]:
    """Return a function that measures a pallet at any height and returns what its covariance gains by a change."""
    shot = portrait(t11, POSE)
    patch = view_patch(shot, POSE, (-0.75, 0.75, -0.1, 0.3), 0.005)
    assert isinstance(patch, FacePatch)

    def added(change: Change) -> FloatArray:
        refitted(change)
        found = fit_from_starts(
            shot, Candidate(t11, POSE), [(POSE, patch)], lambda pose: FitStart(pose, YawSource.FACE), True, CONFIG
        ).fit
        assert found is not None
        assert found.face is not None
        return found.covariance - found.face.covariance

    return added


def test_missing_uprights_leave_the_range_in_doubt(
    range_doubt: Callable[..., FloatArray], portrait: Portrait, t11: PalletModel
) -> None:
    added = [range_doubt(lambda face, missing=missing: without_uprights(face, missing)) for missing in range(5)]
    sizes = [float(np.sqrt(np.trace(covariance))) for covariance in added]
    assert sizes[0] < 0.5 * sizes[-1]
    assert (np.diff(sizes[1:]) > 0.03).all()
    _, axes = np.linalg.eigh(added[-1][:3, :3])
    ray = POSE.as_array()[:3] - portrait(t11, POSE).mounting.center
    assert abs(axes[:, -1] @ ray) > 0.97 * np.linalg.norm(ray)
    np.testing.assert_allclose(added[-1][3], 0.0, atol=1e-15)


def test_neither_level_lines_nor_a_hidden_upright_confirm_a_range(range_doubt: Callable[..., FloatArray]) -> None:
    whole = range_doubt(lambda face: without_uprights(face, 0))
    np.testing.assert_allclose(range_doubt(faint), whole, atol=1e-15)
    missing = range_doubt(lambda face: without_uprights(face, 3))
    np.testing.assert_allclose(range_doubt(hidden), missing, rtol=1e-7)


# The decision between a fit and its rivals: likelier ones that stand apart win, others widen its covariance.

PLACE = LevelPose(1.0, 2.0, 0.0, 1.5)
SURE = np.diag([0.004, 0.004, 0.002, 0.003]) ** 2
SEEN = SeenFace(np.array([0.0, 1.5, 2.0]), np.eye(4), (), (), 0.0)
FIT = Fit(
    Candidate(load_library()["t11"], PLACE, HeightPrior(0.0, 0.003)),
    PLACE,
    SURE,
    YawSource.BOTTOM,
    FaceEstimate(PLACE, SURE, SEEN, np.zeros(0), 1.0, 0.0),
)
REFUSED = Refusal(FIT.candidate, Stage.VERIFICATION, Reason.FEW_EDGES, FIT)
OTHER = replace(FIT, pose=replace(PLACE, x=1.5))
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


def decided(best: Fit | Refusal, rivals: Sequence[Rival] = ()) -> Fit | Refusal:
    """Decide, and check that nothing is written into what was given."""
    before = None if best.fit is None else best.fit.covariance.copy()
    found = decide(best, rivals, CONFIG)
    if best.fit is not None and before is not None:
        np.testing.assert_array_equal(best.fit.covariance, before)
    return found


def added(found: Fit | Refusal) -> FloatArray:
    assert found.fit is not None
    return np.asarray(found.fit.covariance - SURE)


@pytest.mark.parametrize("best", [FIT, REFUSED], ids=["fit", "refused"])
def test_without_rivals_nothing_changes(best: Fit | Refusal) -> None:
    assert decided(best) is best


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
def test_they_exclude_each_other_and_their_order_does_not_matter(others: list[tuple[float, FloatArray]]) -> None:
    rivals = [rival(*other) for other in others]
    weights = np.exp([0.0, *(other[0] for other in others)])
    expected = sum(w * np.outer(other[1], other[1]) for w, other in zip(weights[1:], others, strict=True))
    np.testing.assert_allclose(added(decided(FIT, rivals)), expected / weights.sum(), atol=1e-12)
    np.testing.assert_allclose(added(decided(FIT, rivals[::-1])), added(decided(FIT, rivals)), atol=1e-15)


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


def test_they_are_looked_at_no_further_than_to_the_first_that_wins() -> None:
    def alternatives() -> Iterator[Rival]:
        yield rival(-1.0)
        yield rival(1.0, sigmas=math.inf, instead=OTHER)
        raise AssertionError("the others have to be measured first")

    assert decide(FIT, alternatives(), CONFIG) is OTHER


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
