"""The verdict on a shelf's front: what holds, what contradicts, what cannot be told."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from calibration.findings import Finding, Severity, exit_code
from calibration.shelf.front_line import UPRIGHTS
from calibration.shelf.plane import Disagreement, FusedPlane
from calibration.shelf.survey import Front, ShelfSurvey

LOOSE_M, LOOSE_DEG = 0.0075, 0.15
"""Standard deviations above which the user is warned."""
USELESS_M, USELESS_DEG = 0.07, 0.75
"""Standard deviations above which the result fails."""
_PRIOR_M, _PRIOR_DEG = 0.65, 13.0
_LEAST_DISTANCE = 0.3
_SCALE, _BIAS_DEG_S = 0.02, 1.0
_SWEEP = {
    "sweep_flat": "moving the plane by 15 cm, at no distance do clearly more windows of the shots look alike",
    "sweep_at_edge": "moving the plane by 15 cm, the most windows of the shots look alike where the search ends",
    "sweep_ambiguous": "moving the plane by 15 cm, windows of the shots look alike at two distances or more",
}


@dataclass(frozen=True, slots=True, eq=False)
class ShelfAssessment:
    """A result with its verdict."""

    survey: ShelfSurvey
    """The result."""
    findings: tuple[Finding, ...]
    """What there is to say."""

    @property
    def exit_code(self) -> int:
        """0 pass, 1 fail, 3 degenerate."""
        return exit_code(self.findings)


def assess_shelf(survey: ShelfSurvey) -> ShelfAssessment:
    """Judge a result.

    Parameters
    ----------
    survey : ShelfSurvey
        The result.
    """
    if survey.fused is None:
        return ShelfAssessment(survey, (_nothing(survey),))
    findings = [*_contradictions(survey, survey.fused), *_uncertainty(survey.fused), *_restrictions(survey)]
    return ShelfAssessment(survey, tuple(findings))


def _nothing(survey: ShelfSurvey) -> Finding:
    reasons = "; ".join(f"{skipped.method}: {skipped.what}" for skipped in survey.skipped)
    codes = {skipped.code for skipped in survey.skipped}
    code = next((code for code in ("few_shots", "along_the_ray", "short_baseline") if code in codes), "nothing_seen")
    how = (
        "drive along the shelf past two of its uprights or past pallets of a model that recording.yaml names;"
        " check side and distance of the shelf"
    )
    return Finding(Severity.DEGENERATE, code, f"no method gives the plane ({reasons})", how)


def _contradictions(survey: ShelfSurvey, fused: FusedPlane) -> Iterator[Finding]:
    if fused.disagreement is not None:
        yield Finding(
            Severity.FAIL,
            "methods_disagree",
            disagreement_text(fused.disagreement),
            "look at the plan in the report: one of the two took something else for the front",
        )
    turn, distance = survey.foot.described(survey.prior)
    off, turned = fused.distance - distance, float(np.degrees(fused.turn - turn))
    local = survey.foot.local(survey.solution.poses[:, :2])[:, 0]
    reach = _PRIOR_M + float(np.ptp(local)) / 2 * np.tan(np.radians(10.0))
    if abs(off) > reach or abs(turned) > _PRIOR_DEG:
        yield Finding(
            Severity.FAIL,
            "far_from_prior",
            f"the plane is {off:+.2f} m and {turned:+.1f} degrees off what was given",
            "state side and distance of the shelf within half a metre and ten degrees",
        )
    if fused.distance < _LEAST_DISTANCE:
        yield Finding(
            Severity.FAIL,
            "too_near",
            f"the plane is {fused.distance:.2f} m before the camera",
            f"expected at least {_LEAST_DISTANCE} m: check side and distance of the shelf",
        )


def disagreement_text(found: Disagreement) -> str:
    """Say which two methods disagree, and by how much."""
    distance = f"{1000 * found.distance:+.0f} mm and " if np.isfinite(found.distance) else ""
    turn = f"{np.degrees(found.turn):+.2f} degrees"
    chance = f"chance leaves that to {found.chance:.1g} of cases"
    return f"{found.first} and {found.second} disagree by {distance}{turn}; {chance}"


def _uncertainty(fused: FusedPlane) -> Iterator[Finding]:
    turn, distance = np.degrees(np.sqrt(fused.covariance[0, 0])), float(np.sqrt(fused.covariance[1, 1]))
    what = f"standard deviations are {1000 * distance:.1f} mm and {turn:.2f} degrees"
    how = "drive past more uprights, a longer way, with more shots"
    if distance > USELESS_M or turn > USELESS_DEG:
        yield Finding(Severity.FAIL, "too_uncertain", what, how)
    elif distance > LOOSE_M or turn > LOOSE_DEG:
        yield Finding(Severity.WARNING, "uncertain", what, how)


def _restrictions(survey: ShelfSurvey) -> Iterator[Finding]:
    names = {estimate.method for estimate in survey.estimates}
    for skipped in survey.skipped:
        how = (
            "drive along the shelf past two uprights"
            if skipped.method == UPRIGHTS
            else "expected where there are none"
        )
        yield Finding(
            Severity.WARNING if skipped.method == UPRIGHTS else Severity.NOTE, skipped.code, skipped.what, how
        )
    if survey.front is Front.UPRIGHTS and UPRIGHTS not in names:
        yield Finding(
            Severity.WARNING,
            "pallets_only",
            "no upright tells where the front is, and pallets need not stand flush with it",
            "let the way pass two uprights of the shelf",
        )
    if survey.sweep is not None and survey.sweep.refusal is not None:
        what = _SWEEP[survey.sweep.refusal]
        yield Finding(Severity.NOTE, survey.sweep.refusal, what, "nothing: the sweep is left out of the result")
    if abs(survey.solution.scale - 1) > _SCALE:
        yield Finding(
            Severity.WARNING,
            "odometry_scale",
            f"the odometry's distances are off by {100 * (1 / survey.solution.scale - 1):+.1f} %",
            "calibrate the wheel's circumference",
        )
    bias = float(np.degrees(survey.solution.bias))
    if abs(bias) > _BIAS_DEG_S:
        yield Finding(
            Severity.WARNING,
            "gyro_bias",
            f"the yaw rate is off by {bias:+.2f} degrees per second",
            "calibrate the gyroscope while the forklift stands",
        )
