from __future__ import annotations

import pytest

from palletloc.candidate import Candidate
from palletloc.geometry import LevelPose
from palletloc.measurement import Reason, Stage
from palletloc.pallet import PalletModel
from palletloc.verification import Signs, Verification

START = LevelPose(1.0, 2.0, 0.0, 1.5)


@pytest.fixture
def candidate(epal: PalletModel) -> Candidate:
    return Candidate(epal, START, None, 0.7)


def test_before_its_checks_it_stands_as_its_detection(candidate: Candidate) -> None:
    assert candidate.rank == candidate.score == 0.7


def test_after_its_checks_it_stands_as_they_say(candidate: Candidate) -> None:
    candidate.verification = Verification(Signs(4.0, 0.5, 0.4, 2.0), None)
    assert candidate.rank == candidate.verification.rank != 0.7


def test_it_is_given_up_with_stage_and_reason(candidate: Candidate) -> None:
    assert candidate.refusal is None
    candidate.refuse(Stage.POSITION, Reason.NO_PEAK)
    assert candidate.refusal == (Stage.POSITION, Reason.NO_PEAK)


def test_candidates_do_not_share_what_the_steps_leave(epal: PalletModel) -> None:
    one, other = Candidate(epal, START, None), Candidate(epal, START, None)
    assert one.lines is not other.lines
    assert one.horizontal is not other.horizontal
    assert (one.pose, one.covariance, one.refusal) == (None, None, None)
