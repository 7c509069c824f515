"""Fits from several starts: which are tried, which is kept, and what the others leave in doubt."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from palletloc import Candidate, Fit, LevelPose, LocalizerConfig, PalletModel, Refusal, Shot, fitting
from palletloc.cameras import Pinhole
from palletloc.fitting import FitStart, fit_from_starts
from palletloc.measurement import HeightPrior, Reason, Stage, YawSource
from palletloc.refinement.face_fit import FaceEstimate, fit_face
from palletloc.refinement.level_lines import LevelYaw
from palletloc.refinement.patch import FacePatch, view_patch
from tests.palletloc.poses import CONFIG, FLOOR, Height, Outcome, Photograph, fit_of

CERTAIN = replace(CONFIG, face_fit=replace(CONFIG.face_fit, max_doubt=4.0))
"""The first fit of a pallet leaves no doubt."""
NEVER_CERTAIN = replace(
    CONFIG, face_fit=replace(CONFIG.face_fit, max_doubt=-0.5), verification=replace(CONFIG.verification, certain=2.0)
)
"""Every start is tried."""
LEFT, RIGHT = LevelPose(0.2, 2.0, 0.0, np.pi / 2 + 0.02), LevelPose(1.7, 2.02, 0.0, np.pi / 2 - 0.015)
CENTER = (0.9, -0.4, 1.6)
Starts = list[tuple[LevelPose, FacePatch]]


@pytest.fixture(scope="module")
def pair(photograph: Photograph, t11: PalletModel) -> Shot:
    """Return a picture of two pallets that are alike, side by side."""
    camera = Pinhole(1400, 420, 860.0, 860.0, 699.5, 209.5)
    return photograph(((t11, LEFT), (t11, RIGHT)), camera, (*CENTER, 90.0, 31.5, 0.5))


def with_views(shot: Shot, poses: Sequence[LevelPose]) -> Starts:
    """Starts with views of their surroundings."""
    patches = [view_patch(shot, pose, (-0.75, 0.75, -0.1, 0.3), 0.005) for pose in poses]
    return [(pose, patch) for pose, patch in zip(poses, patches, strict=True) if isinstance(patch, FacePatch)]


def as_found(pose: LevelPose) -> FitStart:
    return FitStart(pose, YawSource.FACE)


def kept(
    shot: Shot,
    model: PalletModel,
    poses: Sequence[LevelPose],
    weak: bool = False,
    height: Height = FLOOR,
    config: LocalizerConfig = CONFIG,
    prepare: Callable[[LevelPose], FitStart] = as_found,
) -> Outcome:
    return fit_from_starts(shot, Candidate(model, LEFT, height), with_views(shot, poses), prepare, weak, config)


def tried(
    shot: Shot,
    model: PalletModel,
    poses: Sequence[LevelPose],
    weak: bool,
    config: LocalizerConfig = CONFIG,
    height: Height = FLOOR,
) -> tuple[list[LevelPose], Outcome]:
    """Return which starts are fitted, and what is kept."""
    called: list[LevelPose] = []

    def prepare(pose: LevelPose) -> FitStart:
        called.append(pose)
        return as_found(pose)

    return called, kept(shot, model, poses, weak, height, config, prepare)


def near(outcome: Outcome, truth: LevelPose) -> bool:
    """Tell whether something was measured within some centimetres of a pose."""
    return outcome.fit is not None and bool(np.abs(outcome.fit.pose.minus(truth)).max() < 0.03)


def test_neither_no_start_nor_one_that_shows_no_pallet_at_a_glance_is_fitted(pair: Shot, t11: PalletModel) -> None:
    found = kept(pair, t11, [])
    assert isinstance(found, Refusal)
    assert (found.stage, found.reason, found.fit) == (Stage.VERIFICATION, Reason.LOW_CONTRAST, None)
    nowhere = [LevelPose(0.9, 1.6, 0.0, np.pi / 2), LevelPose(0.9, 2.4, 0.0, np.pi / 2)]
    plain = replace(pair, image=np.full_like(pair.image, 90))
    called, found = tried(plain, t11, [*nowhere, LEFT], False)
    assert called == []
    assert isinstance(found, Refusal)
    assert (found.stage, found.reason) == (Stage.VERIFICATION, Reason.LOW_CONTRAST)


@pytest.mark.parametrize("truth", [LEFT, RIGHT], ids=["left", "right"])
def test_a_good_start_leads_to_its_pallet(truth: LevelPose, pair: Shot, t11: PalletModel) -> None:
    found = kept(pair, t11, [replace(truth, x=truth.x + 0.005)])
    assert isinstance(found, Fit)
    assert near(found, truth)
    assert found.face is not None
    assert found.evidence is not None
    assert found.pose == found.face.forklift_from_pallet


def test_a_fit_without_or_beyond_doubt_ends_the_search_if_its_yaw_is_known(pair: Shot, t11: PalletModel) -> None:
    for weak in (False, True):
        called, found = tried(pair, t11, [LEFT, RIGHT], weak, CERTAIN)
        face = fit_of(found).face
        assert face is not None
        assert face.doubt < 4.0
        assert called == ([LEFT, RIGHT] if weak else [LEFT])
    doubting = replace(CONFIG, face_fit=replace(CONFIG.face_fit, max_doubt=-0.5))
    for weak in (False, True):
        called, found = tried(pair, t11, [LEFT, RIGHT], weak, doubting)
        assert found.rank >= CONFIG.verification.certain
        assert called == ([LEFT, RIGHT] if weak else [LEFT])


BESIDE = replace(LEFT, x=LEFT.x + 0.01, yaw=LEFT.yaw + 0.01)


def test_a_start_next_to_what_was_measured_is_not_tried_again(pair: Shot, t11: PalletModel) -> None:
    called, _ = tried(pair, t11, [LEFT, BESIDE], True, height=None)
    assert called == [LEFT]


@pytest.mark.parametrize("height", [FLOOR, None], ids=["floor", "any"])
def test_a_start_next_to_a_fit_that_was_refused_is_tried_on_a_level(
    height: Height, pair: Shot, t11: PalletModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    def contradicted(*given: Any) -> FaceEstimate | Reason:
        face = fit_face(*given)
        return face if isinstance(face, Reason) else replace(face, level_yaw=LevelYaw(0.1, 0.001, 3))

    monkeypatch.setattr(fitting, "fit_face", contradicted)
    called, found = tried(pair, t11, [LEFT, BESIDE], True, height=height)
    assert isinstance(found, Refusal)
    assert called == ([LEFT, BESIDE] if height else [LEFT])


def test_the_fit_begins_where_the_preparation_says_and_keeps_its_yaw_and_steps(pair: Shot, t11: PalletModel) -> None:
    found = kept(pair, t11, [LEFT], prepare=lambda _: as_found(RIGHT))
    assert found.fit is None or near(found, RIGHT)
    assert not near(found, LEFT)
    candidate = Candidate(t11, LEFT, FLOOR)

    def prepare(pose: LevelPose) -> FitStart:
        return FitStart(pose, YawSource.TOP, steps=(f"prepared at {pose.x}",))

    starts = with_views(pair, [LEFT, RIGHT])
    found = fit_of(fit_from_starts(pair, candidate, starts, prepare, True, NEVER_CERTAIN, ("searched",)))
    assert found.yaw_from is YawSource.TOP
    # of each attempt its own steps, after those before all of them
    assert found.steps == ("searched", f"prepared at {LEFT.x if near(found, LEFT) else RIGHT.x}")
    assert found.candidate is candidate
    assert found.prior is not None
    assert found.prior.height == FLOOR


@pytest.mark.parametrize("bad_first", [True, False])
def test_the_best_of_several_attempts_is_kept(bad_first: bool, pair: Shot, t11: PalletModel) -> None:
    nowhere = LevelPose(RIGHT.x - 0.53, RIGHT.y, 0.0, RIGHT.yaw)  # one opening aside
    found = kept(pair, t11, [nowhere, LEFT] if bad_first else [LEFT, nowhere], weak=True)
    assert isinstance(found, Fit)
    assert near(found, LEFT)


@pytest.mark.parametrize("weak", [True, False])
def test_a_rival_pose_widens_the_covariance(weak: bool, pair: Shot, t11: PalletModel) -> None:
    refused = kept(pair, t11, [LEFT, RIGHT], weak, config=NEVER_CERTAIN)
    rivalled = fit_of(refused)
    alone = fit_of(kept(pair, t11, [LEFT if near(rivalled, LEFT) else RIGHT], weak, config=NEVER_CERTAIN))
    assert alone.pose == rivalled.pose
    gained = rivalled.covariance - alone.covariance
    sizes, axes = np.linalg.eigh(gained[:2, :2])
    way = RIGHT.as_array()[:2] - LEFT.as_array()[:2]
    assert abs(axes[:, 1] @ way) == pytest.approx(np.linalg.norm(way), rel=1e-3)
    assert abs(sizes[0]) < 1e-3 * sizes[1]
    # at most as if both were equally likely
    assert 0.01 < np.sqrt(sizes[1]) < 1.01 * np.linalg.norm(way) / np.sqrt(2)
    assert isinstance(refused, Refusal)
    assert (refused.stage, refused.reason) == (Stage.VERIFICATION, Reason.UNCERTAIN)


def test_the_order_of_the_starts_does_not_matter_where_all_are_tried(pair: Shot, t11: PalletModel) -> None:
    first, second = (fit_of(kept(pair, t11, poses, weak=True)) for poses in ([LEFT, RIGHT], [RIGHT, LEFT]))
    assert first.pose == second.pose
    np.testing.assert_allclose(first.covariance, second.covariance, rtol=1e-6, atol=1e-12)


def test_doubt_widens_the_covariance_where_only_the_face_tells(pair: Shot, t11: PalletModel) -> None:
    factors = []
    for weak in (False, True):
        found = fit_of(kept(pair, t11, [LEFT], weak, config=CERTAIN))
        assert found.face is not None
        assert found.face.doubt > 1.0
        factors.append(found.covariance[0, 0] / found.face.covariance[0, 0])
        np.testing.assert_allclose(found.covariance, factors[-1] * found.face.covariance, rtol=1e-9)
    assert factors[0] == pytest.approx(1.0)
    assert factors[1] > 1.1


@pytest.mark.parametrize("off", [-0.12, -0.08, -0.06, -0.05, 0.05, 0.06, 0.08, 0.12])
def test_a_pallet_off_its_level_is_refused(off: float, pair: Shot, t11: PalletModel) -> None:
    found = kept(pair, t11, [LEFT], height=HeightPrior(off, 0.003))
    assert isinstance(found, Refusal)
    assert found.stage in (Stage.VERIFICATION, Stage.POSITION)


@pytest.mark.parametrize("off", [-0.04, -0.03, -0.02, 0.02, 0.03, 0.04])
def test_a_bit_off_its_level_a_pose_is_nearly_right_or_says_so(off: float, pair: Shot, t11: PalletModel) -> None:
    found = kept(pair, t11, [LEFT], height=HeightPrior(off, 0.003))
    if isinstance(found, Fit):
        error = found.pose.minus(LEFT)
        sigmas = np.sqrt(error @ np.linalg.solve(found.covariance, error))
        assert np.abs(error[:3]).max() < 0.06 or sigmas < 5.0
