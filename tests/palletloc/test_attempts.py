from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import cast

import numpy as np
import pytest
from palletloc.attempts import keep_best
from palletloc.horizontal_view import HorizontalView

from palletloc.cameras import Pinhole
from palletloc.candidate import Candidate, ShotView
from palletloc.config import LocalizerConfig
from palletloc.geometry import LevelPose
from palletloc.measurement import HeightPrior, Reason, Stage
from palletloc.pallet import PalletModel
from palletloc.refinement.patch import FacePatch, view_patch

FLOOR = HeightPrior(0.0, 0.003)
CONFIG = LocalizerConfig()
CERTAIN = replace(CONFIG, face_fit=replace(CONFIG.face_fit, max_doubt=4.0))
"""The first fit of a pallet leaves no doubt."""
NEVER_CERTAIN = replace(
    CONFIG,
    face_fit=replace(CONFIG.face_fit, max_doubt=-0.5),
    verification=replace(CONFIG.verification, certain=2.0),
)
"""Every start is tried."""
LEFT, RIGHT = LevelPose(0.2, 2.0, 0.0, np.pi / 2 + 0.02), LevelPose(1.7, 2.02, 0.0, np.pi / 2 - 0.015)
CENTER = (0.9, -0.4, 1.6)
Starts = list[tuple[LevelPose, FacePatch]]


@pytest.fixture(scope="module")
def pair(photograph: Callable[..., ShotView], t11: PalletModel) -> ShotView:
    """Return a picture of two pallets that are alike, side by side."""
    camera = Pinhole(1400, 420, 860.0, 860.0, 699.5, 209.5)
    return photograph(((t11, LEFT), (t11, RIGHT)), camera, (*CENTER, 90.0, 31.5, 0.5))


def with_views(shot: ShotView, poses: Sequence[LevelPose]) -> Starts:
    """Starts with views of their surroundings."""
    starts = []
    for pose in poses:
        patch = view_patch(
            shot.projector, shot.image, shot.camera_from_forklift, pose, (-0.75, 0.75, -0.1, 0.3), 0.005
        )
        assert isinstance(patch, FacePatch)
        starts.append((pose, patch))
    return starts


def kept(
    shot: ShotView,
    model: PalletModel,
    poses: Sequence[LevelPose],
    weak: bool = False,
    height: HeightPrior | None = FLOOR,
    config: LocalizerConfig = CONFIG,
) -> Candidate:
    candidate = Candidate(model, LEFT, height)
    keep_best(shot, candidate, with_views(shot, poses), lambda _, start: start, weak, config)
    return candidate


def near(candidate: Candidate, truth: LevelPose) -> bool:
    """Tell whether a candidate was measured within some centimetres of a pose."""
    return candidate.pose is not None and bool(np.abs(candidate.pose.as_array() - truth.as_array()).max() < 0.03)


def test_no_start_is_refused(pair: ShotView, t11: PalletModel) -> None:
    found = kept(pair, t11, [])
    assert found.refusal == (Stage.VERIFICATION, Reason.LOW_CONTRAST)
    assert found.pose is None
    assert found.covariance is None


def test_starts_that_show_no_pallet_at_a_glance_are_not_fitted(pair: ShotView, t11: PalletModel) -> None:
    called: list[LevelPose] = []

    def prepare(_: Candidate, start: LevelPose) -> LevelPose:
        called.append(start)
        return start

    nowhere = [LevelPose(0.9, 1.6, 0.0, np.pi / 2), LevelPose(0.9, 2.4, 0.0, np.pi / 2)]
    candidate = Candidate(t11, LEFT, FLOOR)
    plain = replace(pair, image=np.full_like(pair.image, 90))
    keep_best(plain, candidate, with_views(plain, [*nowhere, LEFT]), prepare, False, CONFIG)
    assert called == []
    assert candidate.refusal == (Stage.VERIFICATION, Reason.LOW_CONTRAST)


@pytest.mark.parametrize("truth", [LEFT, RIGHT], ids=["left", "right"])
def test_a_good_start_leads_to_its_pallet(truth: LevelPose, pair: ShotView, t11: PalletModel) -> None:
    found = kept(pair, t11, [replace(truth, x=truth.x + 0.005)])
    assert found.refusal is None
    assert near(found, truth)
    assert found.face is not None
    assert found.verification is not None
    assert found.pose == found.face.forklift_from_pallet


def test_the_first_that_leaves_no_doubt_ends_the_search(pair: ShotView, t11: PalletModel) -> None:
    tried: list[LevelPose] = []

    def prepare(_: Candidate, start: LevelPose) -> LevelPose:
        tried.append(start)
        return start

    for weak in (False, True):
        tried.clear()
        candidate = Candidate(t11, LEFT, FLOOR)
        keep_best(pair, candidate, with_views(pair, [LEFT, RIGHT]), prepare, weak, CERTAIN)
        assert candidate.face is not None
        assert candidate.face.doubt < 4.0
        assert tried == ([LEFT, RIGHT] if weak else [LEFT])


def test_a_pallet_beyond_doubt_ends_the_search_where_its_yaw_is_known(pair: ShotView, t11: PalletModel) -> None:
    tried: list[LevelPose] = []

    def prepare(_: Candidate, start: LevelPose) -> LevelPose:
        tried.append(start)
        return start

    doubting = replace(CONFIG, face_fit=replace(CONFIG.face_fit, max_doubt=-0.5))
    for weak in (False, True):
        tried.clear()
        candidate = Candidate(t11, LEFT, FLOOR)
        keep_best(pair, candidate, with_views(pair, [LEFT, RIGHT]), prepare, weak, doubting)
        assert candidate.rank >= CONFIG.verification.certain
        assert tried == ([LEFT, RIGHT] if weak else [LEFT])


def test_a_start_next_to_what_was_measured_is_not_tried_again(pair: ShotView, t11: PalletModel) -> None:
    tried: list[LevelPose] = []

    def prepare(_: Candidate, start: LevelPose) -> LevelPose:
        tried.append(start)
        return start

    beside = replace(LEFT, x=LEFT.x + 0.01, yaw=LEFT.yaw + 0.01)
    keep_best(pair, Candidate(t11, LEFT, None), with_views(pair, [LEFT, beside]), prepare, True, CONFIG)
    assert tried == [LEFT]


@pytest.mark.parametrize("height", [FLOOR, None], ids=["floor", "any"])
def test_a_start_next_to_a_fit_that_was_refused_is_tried_on_a_level(
    height: HeightPrior | None, pair: ShotView, t11: PalletModel
) -> None:
    tried: list[LevelPose] = []

    def prepare(attempt: Candidate, start: LevelPose) -> LevelPose:
        if not tried:
            attempt.refuse(Stage.VERIFICATION, Reason.FEW_EDGES)
        tried.append(start)
        return start

    beside = replace(LEFT, x=LEFT.x + 0.01, yaw=LEFT.yaw + 0.01)
    keep_best(pair, Candidate(t11, LEFT, height), with_views(pair, [LEFT, beside]), prepare, True, CONFIG)
    assert tried == ([LEFT, beside] if height else [LEFT])


def test_the_fit_begins_where_the_preparation_says(pair: ShotView, t11: PalletModel) -> None:
    candidate = Candidate(t11, LEFT, FLOOR)
    keep_best(pair, candidate, with_views(pair, [LEFT]), lambda _, __: RIGHT, False, CONFIG)
    assert candidate.pose is None or near(candidate, RIGHT)
    assert not near(candidate, LEFT)


@pytest.mark.parametrize("bad_first", [True, False])
def test_the_best_of_several_attempts_is_kept(bad_first: bool, pair: ShotView, t11: PalletModel) -> None:
    nowhere = LevelPose(RIGHT.x - 0.53, RIGHT.y, 0.0, RIGHT.yaw)  # one opening aside
    poses = [nowhere, LEFT] if bad_first else [LEFT, nowhere]
    found = kept(pair, t11, poses, weak=True)
    assert found.refusal is None
    assert near(found, LEFT)


@pytest.mark.parametrize("weak", [True, False])
def test_a_rival_pose_widens_the_covariance(weak: bool, pair: ShotView, t11: PalletModel) -> None:
    rivalled = kept(pair, t11, [LEFT, RIGHT], weak, config=NEVER_CERTAIN)
    assert rivalled.covariance is not None
    alone = kept(pair, t11, [LEFT if near(rivalled, LEFT) else RIGHT], weak, config=NEVER_CERTAIN)
    assert alone.pose == rivalled.pose
    assert alone.covariance is not None
    gained = rivalled.covariance - alone.covariance
    sizes, axes = np.linalg.eigh(gained[:2, :2])
    way = RIGHT.as_array()[:2] - LEFT.as_array()[:2]
    assert abs(axes[:, 1] @ way) == pytest.approx(np.linalg.norm(way), rel=1e-3)
    assert abs(sizes[0]) < 1e-3 * sizes[1]
    # at most as if both were equally likely
    assert 0.01 < np.sqrt(sizes[1]) < 1.01 * np.linalg.norm(way) / np.sqrt(2)
    assert rivalled.refusal == (Stage.VERIFICATION, Reason.UNCERTAIN)


def test_the_order_of_the_starts_does_not_matter_where_all_are_tried(pair: ShotView, t11: PalletModel) -> None:
    one, other = (kept(pair, t11, poses, weak=True) for poses in ([LEFT, RIGHT], [RIGHT, LEFT]))
    assert one.pose == other.pose
    assert one.covariance is not None
    assert other.covariance is not None
    np.testing.assert_allclose(one.covariance, other.covariance, rtol=1e-6, atol=1e-12)


def test_doubt_widens_the_covariance_where_only_the_face_tells(pair: ShotView, t11: PalletModel) -> None:
    sure, weak = (kept(pair, t11, [LEFT], weak=one, config=CERTAIN) for one in (False, True))
    factors = []
    for found in (sure, weak):
        assert found.covariance is not None
        assert found.face is not None
        factors.append(found.covariance[0, 0] / found.face.covariance[0, 0])
        np.testing.assert_allclose(found.covariance, factors[-1] * found.face.covariance, rtol=1e-9)
    assert sure.face is not None
    assert sure.face.doubt > 1.0
    assert factors[0] == pytest.approx(1.0)
    assert factors[1] > 1.1


@pytest.mark.parametrize("off", [-0.12, -0.08, -0.06, -0.05, 0.05, 0.06, 0.08, 0.12])
def test_a_pallet_off_its_level_is_refused(off: float, pair: ShotView, t11: PalletModel) -> None:
    found = kept(pair, t11, [LEFT], height=HeightPrior(off, 0.003))
    assert found.refusal is not None
    assert found.refusal[0] in (Stage.VERIFICATION, Stage.POSITION)


@pytest.mark.parametrize("off", [-0.04, -0.03, -0.02, 0.02, 0.03, 0.04])
def test_a_pallet_a_little_off_its_level_is_nearly_right_or_says_how_wrong_it_is(
    off: float, pair: ShotView, t11: PalletModel
) -> None:
    found = kept(pair, t11, [LEFT], height=HeightPrior(off, 0.003))
    if found.refusal is None:
        assert found.pose is not None
        assert found.covariance is not None
        error = found.pose.as_array() - LEFT.as_array()
        sigmas = np.sqrt(error @ np.linalg.solve(found.covariance, error))
        assert np.abs(error[:3]).max() < 0.06 or sigmas < 5.0


def test_every_attempt_starts_from_the_candidate_as_it_was(pair: ShotView, t11: PalletModel) -> None:
    lengths: list[int] = []

    def prepare(attempt: Candidate, start: LevelPose) -> LevelPose:
        lengths.append(len(attempt.horizontal))
        attempt.horizontal.append(cast(HorizontalView, None))
        return start

    candidate = Candidate(t11, LEFT, None)
    keep_best(pair, candidate, with_views(pair, [LEFT, RIGHT]), prepare, True, CONFIG)
    assert lengths == [0, 0]
    assert len(candidate.horizontal) == 1
