from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import RigidTransform

from palletloc.contrast import opening_contrasts
from palletloc.geometry import FloatArray, LevelPose, level_pose
from palletloc.measurement import HeightPrior, Reason
from palletloc.pallet import Opening, PalletModel
from palletloc.refinement.face_fit import FaceEstimate, FaceFitConfig, YawPrior, fit_face
from palletloc.refinement.hypotheses import score_pose
from palletloc.refinement.patch import FacePatch, view_patch
from palletloc.shot import Shot
from palletloc.verification import Signs, Verification, VerificationConfig, of_use, overlapping, verify

POSE = LevelPose(0.9, 2.0, 0.0, np.pi / 2 + 0.02)
FLOOR = HeightPrior(0.0, 0.003)
CONFIG = VerificationConfig()
WIDE = PalletModel("wide", 1.2, 0.144, 0.8, (Opening(0.0, 0.02, 0.4, 0.1),))
NARROW = PalletModel("narrow", 0.8, 0.144, 1.2, (Opening(0.0, 0.02, 0.4, 0.1),))
Portrait = Callable[..., Shot]

metres, angles = st.floats(-20.0, 20.0), st.floats(-3.1, 3.1)
places = st.builds(LevelPose, metres, metres, st.floats(0.0, 5.0), angles)


def fitted(shot: Shot, model: PalletModel) -> FaceEstimate:
    found = fit_face(
        shot.camera,
        shot.image,
        shot.mounting,
        POSE,
        model,
        FLOOR,
        YawPrior(0.002, 0.0),
        0.1,
        FaceFitConfig(),
    )
    assert isinstance(found, FaceEstimate)
    return found


def beside(pose: LevelPose, into: float, left: float, up: float = 0.0, turn: float = 0.0) -> LevelPose:
    """A pose given in the frame of another."""
    return level_pose(pose.transform() * LevelPose(into, left, up, turn).transform())


def surroundings(shot: Shot) -> FacePatch:
    seen = view_patch(shot, POSE, (-0.7, 0.7, -0.1, 0.25), 0.005)
    assert isinstance(seen, FacePatch)
    return seen


def verified(shot: Shot, model: PalletModel) -> Verification:
    """What a shot shows of a pallet at its pose."""
    estimate, patch = fitted(shot, model), surroundings(shot)
    contrast = float(opening_contrasts(patch, model, POSE).min())
    score = score_pose(patch, model, estimate.forklift_from_pallet)
    return verify(Signs(contrast, estimate.coverage, score, estimate.doubt), CONFIG)


def boarded_up(shot: Shot, model: PalletModel) -> Shot:
    """The shot with a board over each opening and a little more, in the colour of the middle block."""

    def pixels(points: list[tuple[float, float]]) -> FloatArray:
        in_pallet = [[0.0, -right, up] for right, up in points]
        in_camera = shot.mounting.to_camera.apply(POSE.transform().apply(in_pallet))
        return shot.camera.project(in_camera).pixels

    image, high = shot.image.copy(), model.height / 2
    column, row = np.rint(pixels([(0.0, high)])[0]).astype(int)
    for one in model.openings:
        left, right, low, top = one.left - 0.015, one.right + 0.015, one.bottom - 0.015, one.top + 0.015
        corners = [(left, low), (right, low), (right, top), (left, top)]
        cv2.fillPoly(image, [np.rint(pixels(corners)).astype(np.int32)], image[row, column].tolist())
    return replace(shot, image=image)


@pytest.mark.parametrize("name", ["epal", "t11", "open_below"])
def test_a_pallet_passes_in_its_place(name: str, portrait: Portrait, request: pytest.FixtureRequest) -> None:
    model: PalletModel = request.getfixturevalue(name)
    found = verified(portrait(model, POSE), model)
    assert found.reason is None
    assert CONFIG.min_rank <= found.rank <= 1.0


@pytest.mark.parametrize("name", ["epal", "t11", "open_below"])
def test_a_face_without_openings_is_no_pallet(name: str, portrait: Portrait, request: pytest.FixtureRequest) -> None:
    model: PalletModel = request.getfixturevalue(name)
    shot = portrait(model, POSE)
    board = boarded_up(shot, model)
    contrast = float(opening_contrasts(surroundings(board), model, POSE).min())
    assert contrast < 1.5
    score = score_pose(surroundings(board), model, POSE)
    assert score < score_pose(surroundings(shot), model, POSE)
    camera, prior = shot.camera, YawPrior(0.002, 0.0)
    seen = fit_face(camera, board.image, shot.mounting, POSE, model, FLOOR, prior, 0.1, FaceFitConfig())
    if isinstance(seen, FaceEstimate):
        assert verify(Signs(contrast, seen.coverage, score, seen.doubt), CONFIG).reason is not None


signs = st.tuples(st.floats(0.0, 40.0), st.floats(0.0, 1.0), st.floats(-0.5, 1.5), st.floats(0.0, 12.0))


@given(signs, st.floats(0.05, 0.95))
def test_what_is_less_likely_a_pallet_than_is_asked_for_is_refused(
    sign: tuple[float, float, float, float], least: float
) -> None:
    found = verify(Signs(*sign), replace(CONFIG, min_rank=least))
    assert 0.0 <= found.rank <= 1.0
    assert (found.reason is None) is (found.rank >= least)
    assert found.signs == Signs(*sign)


@given(signs, st.floats(0.01, 1.0))
def test_more_of_a_good_sign_never_makes_a_pallet_less_likely(
    sign: tuple[float, float, float, float], more: float
) -> None:
    contrast, coverage, score, doubt = sign
    plain = verify(Signs(*sign), CONFIG).rank
    for better in (
        (contrast + more, coverage, score, doubt),
        (contrast, min(coverage + more, 1.0), score, doubt),
        (contrast, coverage, score + more, doubt),
        (contrast, coverage, score, max(doubt - more, 0.0)),
    ):
        assert verify(Signs(*better), CONFIG).rank >= plain - 1e-12


@given(signs, st.floats(0.05, 1.0))
def test_what_seems_hidden_speaks_against_a_pallet(sign: tuple[float, float, float, float], hidden: float) -> None:
    shown, covered = verify(Signs(*sign), CONFIG), verify(Signs(*sign, hidden), CONFIG)
    assert covered.evidence < shown.evidence
    assert covered.rank <= shown.rank


@given(signs, st.floats(0.05, 1.0), st.floats(0.0, 1.0))
def test_what_stands_before_a_face_explains_a_part_of_what_is_hidden(
    sign: tuple[float, float, float, float], hidden: float, share: float
) -> None:
    plain, covered = verify(Signs(*sign), CONFIG), verify(Signs(*sign, hidden), CONFIG)
    explained = verify(Signs(*sign, hidden, share * hidden), CONFIG)
    assert covered.evidence <= explained.evidence <= plain.evidence
    assert explained.shown == pytest.approx(covered.shown)
    assert verify(Signs(*sign, hidden, hidden), CONFIG).evidence > covered.evidence


def test_every_sign_counts() -> None:
    plain = verify(Signs(2.0, 0.5, 0.5, 2.0), CONFIG).rank
    for better in ((3.0, 0.5, 0.5, 2.0), (2.0, 0.7, 0.5, 2.0), (2.0, 0.5, 0.6, 2.0), (2.0, 0.5, 0.5, 1.0)):
        assert verify(Signs(*better), CONFIG).rank > plain + 0.01


@given(signs, st.floats(0.0, 500.0))
def test_few_pixels_never_make_a_pallet_more_likely(sign: tuple[float, float, float, float], width: float) -> None:
    large, small = (verify(Signs(*sign, width_px=one), CONFIG) for one in (np.inf, width))
    assert small.rank <= large.rank
    assert (small.rank > 0.5) <= (large.rank > 0.5)


def test_a_face_of_few_pixels_must_show_more() -> None:
    seen = Signs(3.0, 0.75, 0.6, 2.0)
    assert verify(seen, CONFIG).reason is None
    assert verify(seen._replace(width_px=25.0), CONFIG).reason is not None


@pytest.mark.parametrize(
    ("sign", "reason"),
    [
        ((0.5, 0.9, 0.5, 1.0), Reason.LOW_CONTRAST),
        ((6.0, 0.1, 0.1, 6.0), Reason.FEW_EDGES),
        ((1.0, 0.0, 0.0, 8.0), Reason.FEW_EDGES),
    ],
)
def test_the_reason_is_what_speaks_most_against_it(sign: tuple[float, float, float, float], reason: Reason) -> None:
    assert verify(Signs(*sign), CONFIG).reason is reason


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
