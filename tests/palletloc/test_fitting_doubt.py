"""What makes a fit less certain, or has it refused: yaws of its level lines, and uprights that are not seen."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from palletloc import fitting
from palletloc.candidate import Candidate, Fit, Refusal
from palletloc.config import LocalizerConfig
from palletloc.fitting import FitStart, fit_from_starts
from palletloc.geometry import FloatArray, LevelPose
from palletloc.measurement import HeightPrior, Reason, Stage, YawSource
from palletloc.methods import measure_refined
from palletloc.pallet import PalletModel
from palletloc.refinement.face_fit import FaceEstimate, fit_face
from palletloc.refinement.level_lines import LevelYaw
from palletloc.refinement.patch import FacePatch, view_patch
from palletloc.shot import Shot

POSE = LevelPose(0.9, 2.0, 0.0, np.pi / 2 + 0.02)
FLOOR = HeightPrior(0.0, 0.003)
CONFIG = LocalizerConfig()
Change = Callable[[FaceEstimate], FaceEstimate]
Portrait = Callable[..., Shot]


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
def test_lines_that_disagree_make_the_yaw_as_uncertain_as_they_are_apart(
    turn_deg: float, sigma_deg: float, verified: Verified
) -> None:
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


def test_level_lines_say_nothing_of_the_range(range_doubt: Callable[..., FloatArray]) -> None:
    whole = range_doubt(lambda face: without_uprights(face, 0))
    np.testing.assert_allclose(range_doubt(faint), whole, atol=1e-15)


def test_a_hidden_upright_confirms_no_range(range_doubt: Callable[..., FloatArray]) -> None:
    missing = range_doubt(lambda face: without_uprights(face, 3))
    np.testing.assert_allclose(range_doubt(hidden), missing, rtol=1e-7)
