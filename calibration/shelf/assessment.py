"""The verdict on a shelf's front: what holds, what contradicts, what cannot be told."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calibration.findings import Finding, Severity, exit_code, notes_on_input
from calibration.shelf.front_line import UPRIGHTS
from calibration.shelf.plane import Disagreement, FusedPlane
from calibration.shelf.survey import Front, ShelfSurvey, survey_shelf
from calibration.shelf.upright_tags import TagsOnUprights
from palletloc.errors import PalletLocError
from palletloc.geometry import wrap_angle
from palletloc.io.recording import Recording, read_recording
from palletloc.shelf import ShelfPlane

LOOSE_M, LOOSE_DEG = 0.0075, 0.15
"""Standard deviations above which the user is warned."""
USELESS_M, USELESS_DEG = 0.07, 0.75
"""Standard deviations above which the result fails."""
_PRIOR_M, _PRIOR_DEG = 0.65, 13.0
"""A result farther from what was given fails, in metres and degrees: the search covers 0.5 m and 10 degrees."""
_LEAST_DISTANCE = 0.3
"""A nearer plane is taken for a mistake, in metres: the camera would stand in the shelf."""
_SCALE, _BIAS_DEG_S = 0.02, 1.0
"""Errors of the odometry that are told: of distances, relative, and of the yaw rate, in degrees per second."""
_SWEEP = {
    "sweep_flat": "moving the plane by 15 cm, at no distance do clearly more windows of the shots look alike",
    "sweep_at_edge": "moving the plane by 15 cm, the most windows of the shots look alike where the search ends",
    "sweep_ambiguous": "moving the plane by 15 cm, windows of the shots look alike at two distances or more",
}
"""Why a sweep is left out, in words."""


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


def calibrate_shelf(
    folder: Path,
    side: str | None = None,
    distance: float | None = None,
    front: Front = Front.UPRIGHTS,
    tags: TagsOnUprights | None = None,
    on_progress: Callable[[str], None] = lambda _: None,
) -> ShelfAssessment:
    """Find the front of a recording's shelf.

    Parameters
    ----------
    folder : Path
        The recording.
    side : str, optional
        ``left`` or ``right``: where the shelf is, seen in the direction of travel; from recording.yaml if left out.
    distance : float, optional
        About how far the shelf is from the camera, in metres; with `side`.
    front : Front
        Which plane is wanted.
    tags : TagsOnUprights, optional
        Tags on the uprights, where there are any.
    on_progress : callable
        Is told what is done next.

    Returns
    -------
    ShelfAssessment
        With the findings; `shelf_page` shows it.

    Raises
    ------
    PalletLocError
        If a file is missing or wrong.
    """
    recording = read_recording(folder)
    prior = recording.shelf
    if side is not None and distance is not None:
        prior = plane_beside(recording, side, distance)
    return assess_shelf(survey_shelf(recording, prior, front, tags, on_progress))


def plane_beside(recording: Recording, side: str, distance: float) -> ShelfPlane:
    """Return the plane along the way of the forklift, on one side.

    Parameters
    ----------
    recording : Recording
        For its odometry and its levels.
    side : str
        ``left`` or ``right`` in the direction of travel.
    distance : float
        From the camera at the middle of the way, in metres.
    """
    if side not in ("left", "right"):
        raise PalletLocError(f"--side {side}: expected left or right")
    if not 0.3 <= distance <= 10:
        raise PalletLocError(f"--distance {distance:g}: expected metres between 0.3 and 10")
    odometry, shots = recording.odometry, recording.shots
    first, last = (odometry.pose_at(shot.time) for shot in (shots[0], shots[-1]))
    middle = odometry.pose_at(shots[len(shots) // 2].time)
    dx, dy = last.x - first.x, last.y - first.y
    heading = float(np.arctan2(dy, dx)) if np.hypot(dx, dy) > 0.05 else middle.yaw
    if np.cos(heading - middle.yaw) < 0:  # it drives backwards: left is the forklift's own left
        heading += np.pi
    into = heading + (np.pi / 2 if side == "left" else -np.pi / 2)
    x, y, _ = middle.transform().apply(recording.mounting.center)
    return ShelfPlane(
        float(x + distance * np.cos(into)),
        float(y + distance * np.sin(into)),
        float(wrap_angle(into + np.pi)),
        recording.shelf.levels,
    )


def assess_shelf(survey: ShelfSurvey) -> ShelfAssessment:
    """Judge the result of a survey."""
    if survey.fused is None:
        return ShelfAssessment(survey, (_nothing(survey), *notes_on_input(survey.recording.notes)))
    findings = [*_contradictions(survey, survey.fused), *_uncertainty(survey.fused), *_restrictions(survey)]
    findings += notes_on_input(survey.recording.notes)
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
            _disagreement_text(fused.disagreement),
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


def _disagreement_text(found: Disagreement) -> str:
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
