from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from palletloc.contrast import opening_contrasts
from palletloc.geometry import FloatArray, LevelPose
from palletloc.measurement import HeightPrior, Reason
from palletloc.pallet import PalletModel
from palletloc.refinement.face_fit import FaceEstimate, FaceFitConfig, FacePrior, YawPrior, fit_face
from palletloc.refinement.hypotheses import score_pose
from palletloc.refinement.patch import FacePatch, view_patch
from palletloc.shot import Shot
from palletloc.verification import Evidence, VerificationConfig, of_use, verify

POSE = LevelPose(0.9, 2.0, 0.0, np.pi / 2 + 0.02)
FLOOR = HeightPrior(0.0, 0.003)
CONFIG = VerificationConfig()
Portrait = Callable[..., Shot]


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
    for one in model.openings:
        left, right, low, top = one.left - 0.015, one.right + 0.015, one.bottom - 0.015, one.top + 0.015
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


def test_every_sign_counts() -> None:
    plain = Evidence(2.0, 0.5, 0.5, 2.0)
    for sign in ({"contrast": 3.0}, {"coverage": 0.7}, {"score": 0.6}, {"doubt": 1.0}):
        assert replace(plain, **sign).probability > plain.probability + 0.01


@given(signs, st.floats(0.0, 500.0))
def test_few_pixels_never_make_a_pallet_more_likely(large: Evidence, width: float) -> None:
    small = replace(large, width_px=width)
    assert small.probability <= large.probability
    assert (small.probability > 0.5) <= (large.probability > 0.5)


def test_a_face_of_few_pixels_must_show_more() -> None:
    seen = Evidence(3.0, 0.75, 0.6, 2.0)
    assert verify(seen, CONFIG) is None
    assert verify(replace(seen, width_px=25.0), CONFIG) is not None


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
