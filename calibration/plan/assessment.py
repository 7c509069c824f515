"""What there is to say about a planned layout, and what would help most."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

import numpy as np

from calibration.degeneracy import NAMES, weakest
from calibration.findings import Finding, Severity, exit_code
from calibration.mounting.checks import layout_fault, size_faults
from calibration.mounting.problem import SurveyedTarget
from calibration.mounting.two_centres import TwoCentres, lens_finding
from calibration.plan.prediction import (
    ACCEPTED,
    GOOD_MARKER_PX,
    LEAST_MARKER_PX,
    MOST_OBLIQUE,
    Layout,
    LayoutPrediction,
    PlannedTarget,
    PredictedTarget,
    covariance,
    planned_problem,
    predict,
    with_exact_survey,
    worst,
)
from calibration.plan.task import read_layout
from calibration.targets.targets import facing
from palletloc.geometry import FloatArray

_AZIMUTHS = np.radians(np.arange(-135, 181, 45))
"""Directions in which one more target is tried, in radians."""
_ABOVE = (-0.9, 0.2)
"""Heights against the camera at which it is tried, in metres: two of them, for targets at one height tell less."""
_RANGE = 2.0
"""How far away it is tried, in metres."""
_WORTH = 0.85
"""One more target is worth hanging where the worst sigma falls below this part of what it was."""
_SURVEY_RULES = 0.7
"""Share of the variance from which on a better survey helps more than one more target."""
_DEGREE = "\N{DEGREE SIGN}"
"""Sign of the texts."""


@dataclass(frozen=True, slots=True, eq=False)
class Suggestion:
    """One more target."""

    like: str
    """Which of the targets it resembles."""
    azimuth: float
    """Its direction from the camera, about the vertical from the forklift's x axis to its left, in radians."""
    above: float
    """How much higher than the camera its middle hangs, in metres."""
    sigma: FloatArray
    """(6,) standard deviations with it."""

    @property
    def words(self) -> str:
        """Where to hang it."""
        height = f"{abs(self.above):.1f} m {'above' if self.above > 0 else 'below'} the camera"
        return (
            f"a target like {self.like} at {np.degrees(self.azimuth):+.0f}{_DEGREE} from straight ahead, left is +,"
            f" {_RANGE:.0f} m away and {height}"
        )


@dataclass(frozen=True, slots=True, eq=False)
class Plan:
    """A layout with all that there is to say."""

    prediction: LayoutPrediction
    """The numbers."""
    findings: tuple[Finding, ...]
    """What is wrong."""
    survey_share: float
    """Part of the variance that comes from the survey, of the worst of the six numbers; NaN where they are open."""
    suggestion: Suggestion | None
    """What would help most; None where it would not help much."""

    @property
    def exit_code(self) -> int:
        """0 where the calibration would pass, 1 where it would fail, 3 where it could not give a result."""
        return exit_code(self.findings)


def plan_targets(layout: Path) -> Plan:
    """Predict how well planned targets will give the camera's pose, before anything is hung.

    Parameters
    ----------
    layout : Path
        A file like extrinsics.yaml, or a folder that has one.

    Returns
    -------
    Plan
        With the findings that a calibration would have; `plan_page` shows it.

    Raises
    ------
    PalletLocError
        If the file is missing or wrong.
    """
    return assess_plan(read_layout(layout))


def assess_plan(layout: Layout) -> Plan:
    """Predict what a layout will give, and say what to change."""
    faults = size_faults([planned.survey for planned in layout.targets])
    if any(finding.code == "units" for finding in faults):
        empty = LayoutPrediction(layout, ())
        return Plan(empty, tuple(faults), np.nan, None)
    prediction = predict(layout)
    findings = [*faults, *(finding for target in prediction.targets for finding in _target_findings(target))]
    problem, _ = planned_problem(prediction.targets, layout.forklift_from_camera)
    fault = layout_fault(problem.surveys, problem.observations)
    lost = prediction.lost()
    suggestion = _suggestion(prediction)
    how = f"hang {suggestion.words}" if suggestion is not None else "hang more targets on more sides"
    if fault is not None:
        findings.append(replace(fault, how=how))
    if lost:
        what = f"the layout leaves open: {'; '.join(lost)}"
        findings.append(Finding(Severity.DEGENERATE, "unobservable", what, how))
    if fault is not None or lost:
        return Plan(prediction, tuple(findings), np.nan, suggestion)
    share = _survey_share(prediction)
    findings += _limit_findings(prediction, how, share)
    return Plan(prediction, tuple(findings), share, suggestion)


def _target_findings(target: PredictedTarget) -> list[Finding]:
    name, corners = target.planned.survey.name, len(target.planned.pattern.corners)
    if not len(target.corners.points):
        what, how = f"target {name} is outside the camera's field of view", "hang it elsewhere"
        return [Finding(Severity.WARNING, "not_in_view", what, how)]
    if target.obliqueness > MOST_OBLIQUE:
        back = target.obliqueness > np.pi / 2
        what = f"the camera sees target {name} {'from behind' if back else 'nearly edge on'}"
        how = "turn it to the camera; corners are named as seen from the front of the print"
        return [Finding(Severity.WARNING, "turned_away", what, how)]
    if target.marker_px < GOOD_MARKER_PX:
        seen = "not" if target.marker_px < LEAST_MARKER_PX else "not always"
        what = f"the markers of target {name} are {target.marker_px:.0f} px wide: {seen} found"
        how = f"use markers {GOOD_MARKER_PX / target.marker_px:.1f} times as large, or hang it nearer"
        return [Finding(Severity.WARNING, "small_markers", what, how)]
    if len(target.corners.points) < corners:
        what = f"the camera sees {len(target.corners.points)} of {corners} corners of target {name}"
        return [Finding(Severity.WARNING, "partly_in_view", what, "hang it nearer to the middle of the image")]
    return []


def _limit_findings(prediction: LayoutPrediction, how: str, share: float) -> list[Finding]:
    findings, sigma = [], prediction.sigma
    if worst(sigma) > 1:
        number = int(np.argmax(sigma / ACCEPTED))
        size = f"{1000 * sigma[number]:.1f} mm" if number < 3 else f"{np.degrees(sigma[number]):.2f} degrees"
        what = (
            f"{NAMES[number]} would be known to {size} only; the weakest direction is"
            f" {weakest(prediction.covariance)[1]}"
        )
        better = "survey the targets more exactly" if share > _SURVEY_RULES else how
        findings.append(Finding(Severity.FAIL, "too_uncertain", what, better))
    found = [target for target in prediction.targets if target.found]
    if len(found) < 3:
        what = "with two targets a fault in one of them cannot be told from one in the other"
        findings.append(Finding(Severity.WARNING, "no_hold_out", what, "hang a third target"))
    if prediction.layout.camera.period_px is not None:
        sides = np.concatenate([target.corners.bearings[:, 0] for target in found])
        lens = lens_finding(TwoCentres(0.0, prediction.lens_sigma, float((sides > 0).mean())))
        findings += [] if lens is None else [lens]
    return findings


def _survey_share(prediction: LayoutPrediction) -> float:
    """Return the part of the variance that comes from the survey, of the number that is worst."""
    number = int(np.argmax(prediction.sigma / ACCEPTED))
    exact = predict(with_exact_survey(prediction.layout)).sigma
    return float(1 - (exact[number] / prediction.sigma[number]) ** 2)


def _suggestion(prediction: LayoutPrediction) -> Suggestion | None:
    """Return which one more target would help most, if any."""
    found = [target for target in prediction.targets if target.found]
    model = max(found, key=lambda target: target.marker_px).planned if found else prediction.layout.targets[0]
    offers = [_with_one_more(prediction, model, azimuth, above) for azimuth, above in product(_AZIMUTHS, _ABOVE)]
    best = min(offers, key=lambda offer: worst(offer.sigma))
    return best if worst(best.sigma) < _WORTH * worst(prediction.sigma) else None


def _with_one_more(prediction: LayoutPrediction, model: PlannedTarget, azimuth: float, above: float) -> Suggestion:
    layout, outline = prediction.layout, model.survey.outline
    eye = layout.forklift_from_camera.translation
    level = np.sqrt(_RANGE**2 - above**2)
    place = eye + np.array([level * np.cos(azimuth), level * np.sin(azimuth), above])
    board = facing(place, eye)
    middle = board.rotation.apply((outline[1] + outline[2]) / 2)
    survey = SurveyedTarget("more", outline, board.apply(outline) - middle, model.survey.sigma)
    extra = predict(replace(layout, targets=(replace(model, survey=survey),))).targets[0]
    sigma = np.sqrt(np.diag(covariance((prediction.information + extra.information)[:6, :6])))
    return Suggestion(model.survey.name, azimuth, above, sigma)
