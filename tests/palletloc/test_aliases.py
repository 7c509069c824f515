"""The pallet one opening aside: taken for the real one, or given up, but never reported."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from palletloc.aliases import ask_beside
from palletloc.refined import measure_refined

from palletloc.candidate import Candidate, ShotView
from palletloc.config import LocalizerConfig
from palletloc.geometry import LevelPose
from palletloc.measurement import HeightPrior, Reason, Stage
from palletloc.pallet import PalletModel
from palletloc.verification import Signs, Verification

POSE = LevelPose(0.9, 2.0, 0.0, np.pi / 2 + 0.02)
FLOOR = HeightPrior(0.0, 0.003)
CONFIG = LocalizerConfig()
Portrait = Callable[..., ShotView]


def beside(pose: LevelPose, right: float) -> LevelPose:
    return replace(pose, x=pose.x + np.sin(pose.yaw) * right, y=pose.y - np.cos(pose.yaw) * right)


def measured(shot: ShotView, model: PalletModel, start: LevelPose = POSE) -> Candidate:
    candidate = Candidate(model, start, FLOOR)
    measure_refined(shot, candidate, CONFIG)
    return candidate


def believed(shot: ShotView, model: PalletModel, right: float, hidden: float) -> Candidate:
    """Return a candidate that was measured aside and believed, as if something stood before its missing end."""
    candidate = measured(shot, model)
    assert candidate.refusal is None
    assert candidate.pose is not None
    candidate.pose = candidate.start = beside(candidate.pose, right)
    candidate.verification = Verification(Signs(3.0, 0.8, 0.5, 1.0, hidden, hidden), None)
    return candidate


@pytest.mark.parametrize("side", [-1, 1])
@pytest.mark.parametrize("name", ["epal", "t11"])
def test_a_pallet_taken_one_opening_aside_is_taken_back(
    portrait: Portrait, request: pytest.FixtureRequest, name: str, side: int
) -> None:
    model: PalletModel = request.getfixturevalue(name)
    shot = portrait(model, POSE)
    pitch = float(np.diff([one.center for one in model.openings])[0])
    alias = believed(shot, model, side * pitch, 0.3)
    ask_beside(shot, alias, measure_refined, CONFIG)
    assert alias.refusal is None
    assert alias.pose is not None
    assert np.hypot(alias.pose.x - POSE.x, alias.pose.y - POSE.y) < 0.01


def test_the_right_one_stays_as_it_is(portrait: Portrait, epal: PalletModel) -> None:
    shot = portrait(epal, POSE)
    candidate = measured(shot, epal)
    assert candidate.verification is not None
    signs = candidate.verification.signs._replace(hidden=0.1)
    candidate.verification = replace(candidate.verification, signs=signs)
    before = candidate.pose
    ask_beside(shot, candidate, measure_refined, CONFIG)
    assert candidate.refusal is None
    assert candidate.pose is before


def test_a_rival_that_fails_its_checks_still_refuses(portrait: Portrait, epal: PalletModel) -> None:
    shot = portrait(epal, POSE)
    alias = believed(shot, epal, float(epal.openings[1].center - epal.openings[0].center), 0.3)

    def measure_badly(shot: ShotView, candidate: Candidate, config: LocalizerConfig) -> None:
        measure_refined(shot, candidate, config)
        if candidate.refusal is None:
            candidate.refuse(Stage.VERIFICATION, Reason.UNCERTAIN)

    ask_beside(shot, alias, measure_badly, CONFIG)
    assert alias.refusal == (Stage.VERIFICATION, Reason.OVERLAP)


def test_what_is_beyond_doubt_is_not_asked_again(portrait: Portrait, epal: PalletModel) -> None:
    shot = portrait(epal, POSE)
    candidate = measured(shot, epal)
    candidate.verification = Verification(Signs(4.0, 1.0, 0.8, 0.1), None)
    assert candidate.rank >= CONFIG.verification.certain

    asked: list[Candidate] = []

    def note(shot: ShotView, candidate: Candidate, config: LocalizerConfig) -> None:
        asked.append(candidate)
        measure_refined(shot, candidate, config)

    ask_beside(shot, candidate, note, CONFIG)
    refused = measured(shot, epal, beside(POSE, 3.0))
    assert refused.refusal is not None
    ask_beside(shot, refused, note, CONFIG)
    assert not asked
    ask_beside(shot, believed(shot, epal, 0.0, 0.1), note, CONFIG)
    assert asked
