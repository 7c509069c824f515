from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import RigidTransform

from palletloc.candidate import ShotView
from palletloc.face_fit import FaceEstimate, FaceFitConfig, YawPrior, fit_face
from palletloc.geometry import LevelPose, level_pose
from palletloc.measurement import HeightPrior, Reason
from palletloc.pallet import Opening, PalletModel
from palletloc.verification import Verification, VerificationConfig, overlapping, verify

POSE = LevelPose(0.9, 2.0, 0.0, np.pi / 2 + 0.02)
CONFIG = VerificationConfig()
WIDE = PalletModel("wide", 1.2, 0.144, 0.8, (Opening(0.0, 0.02, 0.4, 0.1),))
NARROW = PalletModel("narrow", 0.8, 0.144, 1.2, (Opening(0.0, 0.02, 0.4, 0.1),))
Portrait = Callable[..., ShotView]

metres, angles = st.floats(-20.0, 20.0), st.floats(-3.1, 3.1)
places = st.builds(LevelPose, metres, metres, st.floats(0.0, 5.0), angles)


def fitted(shot: ShotView, model: PalletModel) -> FaceEstimate:
    found = fit_face(
        shot.projector,
        shot.image,
        shot.mounting,
        POSE,
        model,
        HeightPrior(0.0, 0.003),
        YawPrior(0.002, 0.0),
        0.1,
        FaceFitConfig(),
    )
    assert isinstance(found, FaceEstimate)
    return found


def beside(pose: LevelPose, into: float, left: float, up: float = 0.0, turn: float = 0.0) -> LevelPose:
    """A pose given in the frame of another."""
    return level_pose(pose.transform() * LevelPose(into, left, up, turn).transform())


@pytest.mark.parametrize("name", ["epal", "t11", "open_below"])
def test_a_pallet_passes_in_its_place(name: str, portrait: Portrait, request: pytest.FixtureRequest) -> None:
    model: PalletModel = request.getfixturevalue(name)
    found = verify(fitted(portrait(model, POSE), model), model, CONFIG)
    assert found.reason is None
    assert 0.0 <= found.score <= 1.0
    assert 0.0 <= found.coverage <= 1.0
    assert CONFIG.min_rank <= found.rank <= 1.0


@pytest.mark.parametrize(
    ("threshold", "reason"),
    [
        ("min_coverage", Reason.FEW_EDGES),
        ("min_contrast", Reason.LOW_CONTRAST),
        ("min_rank", Reason.LOW_CONTRAST),
    ],
)
def test_what_shows_less_than_is_asked_for_is_refused(
    threshold: str, reason: Reason, portrait: Portrait, t11: PalletModel
) -> None:
    estimate = fitted(portrait(t11, POSE), t11)
    strict = VerificationConfig(**{threshold: 1e6})
    refused, passed = verify(estimate, t11, strict), verify(estimate, t11, CONFIG)
    assert refused.reason is reason
    assert replace(refused, reason=None) == passed


def test_a_face_without_openings_is_no_pallet(portrait: Portrait, t11: PalletModel) -> None:
    estimate = fitted(portrait(t11, POSE), t11)
    view = estimate.seen.view
    board = view.image.copy()
    rows = board.shape[0]
    board[rows // 3 : 2 * rows // 3] = board[rows // 2, board.shape[1] // 2]  # the middle block's colour all along
    covered = replace(estimate, seen=replace(estimate.seen, view=replace(view, image=board)))
    assert verify(covered, t11, CONFIG).reason is Reason.LOW_CONTRAST


def test_the_better_a_candidate_the_higher_its_rank() -> None:
    plain = Verification(contrast=2.0, coverage=0.5, score=0.5, reason=None)
    for better in (replace(plain, contrast=3.0), replace(plain, coverage=0.9), replace(plain, score=0.8)):
        assert better.rank > plain.rank
    assert replace(plain, contrast=0.0).rank == 0.0
    assert Verification(100.0, 1.0, 1.0, None).rank <= 1.0


@given(places)
def test_a_pallet_overlaps_itself_and_none_far_away(pose: LevelPose) -> None:
    assert overlapping(pose, WIDE, pose, WIDE)
    assert overlapping(pose, WIDE, pose, NARROW)
    for place in (
        beside(pose, 0.0, 1.3),
        beside(pose, 0.0, -1.3),
        beside(pose, 1.3, 0.0),
        beside(pose, 0.0, 0.0, 1.0),
    ):
        assert not overlapping(pose, WIDE, place, WIDE)


@given(places, st.floats(-1.5, 1.5), st.floats(-1.5, 1.5), st.floats(-0.3, 0.3))
def test_overlap_is_mutual_and_does_not_depend_on_the_frame(
    pose: LevelPose, into: float, left: float, up: float
) -> None:
    other = beside(pose, into, left, up)
    found = overlapping(pose, WIDE, other, NARROW)
    assert overlapping(other, NARROW, pose, WIDE) == found
    origin = LevelPose(0.0, 0.0, 0.0, 0.0)
    margins = [abs(left) - 0.92, abs(up) - 0.144, abs(into) - 0.8]
    if min(abs(margin) for margin in margins) > 1e-6:
        assert overlapping(origin, WIDE, LevelPose(into, left, up, 0.0), NARROW) == found


def test_neighbours_that_touch_and_pallets_on_each_other_do_not_overlap() -> None:
    assert not overlapping(POSE, WIDE, beside(POSE, 0.0, 1.19), WIDE)
    assert not overlapping(POSE, WIDE, beside(POSE, 0.0, 0.0, 0.144), WIDE)
    assert overlapping(POSE, WIDE, beside(POSE, 0.0, 0.5), WIDE)  # shifted by one opening
    assert overlapping(POSE, WIDE, beside(POSE, 0.1, 0.1, 0.03, 0.05), WIDE)


def test_transforms_of_the_helper_are_those_of_scipy() -> None:
    shifted = beside(POSE, 1.0, 2.0, 0.3)
    expected = POSE.transform() * RigidTransform.from_translation([1.0, 2.0, 0.3])
    np.testing.assert_allclose(shifted.matrix(), expected.as_matrix(), atol=1e-12)
