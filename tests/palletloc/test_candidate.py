"""Candidates, fits and refusals are values: nothing can be written into them, and they hold what pictures need."""

from __future__ import annotations

import math
from dataclasses import FrozenInstanceError, fields, is_dataclass, replace

import numpy as np
import pytest

from palletloc.cameras import Equirectangular
from palletloc.candidate import Candidate, Fit, Refusal, last_step, steps_of
from palletloc.geometry import LevelPose
from palletloc.localizer import Explanation
from palletloc.measurement import Reason, RefusedCandidate, Stage, YawSource
from palletloc.mounting import Mounting
from palletloc.pallet import PalletModel
from palletloc.shot import Shot
from palletloc.verification import Evidence

START, POSE = LevelPose(1.0, 2.0, 0.0, 1.5), LevelPose(1.02, 2.03, 0.01, 1.52)
EVIDENCE = Evidence(4.0, 0.5, 0.4, 2.0)


@pytest.fixture
def candidate(epal: PalletModel) -> Candidate:
    return Candidate(epal, START, None, 0.7)


@pytest.fixture
def fit(candidate: Candidate) -> Fit:
    return Fit(candidate, POSE, np.eye(4), YawSource.TOP, steps=("a view", 1, "another view"))


@pytest.fixture
def shot(mounting: Mounting) -> Shot:
    return Shot(np.zeros((32, 64), np.uint8), Equirectangular(64, 32), mounting, 2.5, "a.png")


@pytest.fixture
def mounting() -> Mounting:
    return Mounting(LevelPose(0.3, 0.0, 0.0, 0.0).transform())


def test_nothing_can_be_written_into_a_shot_or_into_what_is_found_in_it(fit: Fit, shot: Shot) -> None:
    refusal = Refusal(fit.candidate, Stage.VERIFICATION, Reason.FEW_EDGES, fit)
    for value in (shot, fit.candidate, fit, refusal, EVIDENCE, Explanation(shot, (), (), (fit, refusal))):
        assert is_dataclass(value)
        for field in fields(value):
            with pytest.raises(FrozenInstanceError):
                setattr(value, field.name, None)
        assert not hasattr(value, "__dict__")  # nothing can be added, either


def test_its_rank_is_its_score_before_the_checks_and_what_they_say_after_them(fit: Fit) -> None:
    assert fit.rank == fit.candidate.score == 0.7
    checked = replace(fit, evidence=EVIDENCE)
    assert checked.rank == EVIDENCE.probability != 0.7
    before, after = (Refusal(fit.candidate, Stage.POSITION, Reason.NO_PEAK, each) for each in (None, checked))
    assert (before.rank, after.rank) == (0.7, EVIDENCE.probability)


def test_what_was_not_measured_or_checked_explains_nothing(fit: Fit) -> None:
    unseen = Refusal(fit.candidate, Stage.SEARCH, Reason.NO_PEAK)
    for outcome in (fit, replace(fit, evidence=EVIDENCE), unseen):
        assert outcome.likelihood == -math.inf


def test_a_fit_and_a_refusal_give_what_was_measured_alike(fit: Fit) -> None:
    assert fit.fit is fit
    assert Refusal(fit.candidate, Stage.VERIFICATION, Reason.OVERLAP, fit).fit is fit
    assert Refusal(fit.candidate, Stage.YAW, Reason.NO_LINE).fit is None


def test_steps_are_found_by_their_kind_in_their_order(fit: Fit) -> None:
    for outcome in (fit, Refusal(fit.candidate, Stage.YAW, Reason.NO_LINE, None, fit.steps)):
        assert steps_of(outcome, str) == ["a view", "another view"]
        assert last_step(outcome, str) == "another view"
        assert last_step(outcome, int) == 1
        assert last_step(outcome, float) is None
        assert steps_of(outcome, float) == []


def test_a_shots_rows_are_its_fits_and_its_refusals_in_their_order(fit: Fit, shot: Shot) -> None:
    refusal = Refusal(fit.candidate, Stage.YAW, Reason.NO_LINE, fit)
    explained = Explanation(shot, (), (), (refusal, fit, refusal))
    (row,) = explained.measurements
    assert (row.time, row.model, row.file) == (2.5, "epal", "a.png")
    assert (row.forklift_from_pallet, row.score, row.yaw_from) == (POSE, 0.7, YawSource.TOP)
    assert row.covariance is fit.covariance
    assert explained.refusals == [RefusedCandidate(2.5, "epal", Stage.YAW, Reason.NO_LINE, "a.png")] * 2
