"""The report of a calibration: one page of HTML that needs nothing but itself, and the same as JSON."""

from __future__ import annotations

import base64
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from calibration.assessment import Assessment
from calibration.degeneracy import NAMES, weakest
from calibration.extrinsics import Extrinsics
from calibration.findings import Finding, Severity
from calibration.forklift_frame import ForkliftFrame
from calibration.observations import TargetObservation
from calibration.report_figures import correlation_figure, left_out_figure, polar_figure, sphere_figure
from calibration.residuals import CornerResiduals, at_reference, corner_residuals
from palletloc.drawing.canvas import small_png
from palletloc.io.camera_spec import angles_from_transform
from palletloc.report.page import Column, heading, key_figures, page, paragraph, picture, table

_DEGREE, _PM = "\N{DEGREE SIGN}", "\N{PLUS-MINUS SIGN}"
_VERDICT = {0: "The calibration holds.", 1: "The calibration fails.", 3: "The data cannot give a calibration."}


@dataclass(frozen=True, slots=True, eq=False)
class Report:
    """What there is to tell."""

    assessment: Assessment
    """Result and verdict."""
    observations: tuple[TargetObservation, ...]
    """Targets in shots."""
    names: tuple[str, ...]
    """Of the targets that are seen, in the fit's order."""
    unseen: tuple[str, ...]
    """Targets that no shot shows."""
    frame: ForkliftFrame | None = None
    """Where the forklift stood in the survey; None where the corners were given in its frame."""

    def residuals(self) -> tuple[CornerResiduals, ...]:
        """Return the residuals of all corners; none where there is no solution."""
        solution = self.assessment.solution
        return () if solution is None else corner_residuals(solution, self.observations, self.names)


def report_data(report: Report) -> dict[str, Any]:
    """Return the report as plain values for JSON: metres, radians where nothing else is said."""
    assessment = report.assessment
    data: dict[str, Any] = {
        "format": 1,
        "exit_code": assessment.exit_code,
        "reasons": [_finding_data(finding) for finding in assessment.findings],
        "targets": [_observation_data(one) for one in report.observations],
        "not_seen": list(report.unseen),
    }
    if report.frame is not None:
        data["forklift_frame"] = {"method": report.frame.method, "residual_m": dict(report.frame.residuals or {})}
    solution = assessment.solution
    if solution is None:
        return data
    translation, angles = angles_from_transform(solution.poses.camera)
    worst, words = weakest(solution.covariance)
    data["forklift_from_camera"] = {
        "translation_m": list(translation),
        "roll_pitch_yaw_deg": list(angles),
        "translation_sigma_m": solution.sigma[:3].tolist(),
        "rotation_sigma_deg": np.degrees(solution.sigma[3:]).tolist(),
        "covariance": solution.covariance.tolist(),
        "covariance_order": list(NAMES),
    }
    data["frame_covariance"] = solution.frame_covariance.tolist()
    data["weakest_direction"] = {"words": words, "of_limit": worst}
    data["sight_factor"], data["survey_factor"] = solution.sight_factor, solution.survey_factor
    data["survey_scale_error"] = {"value": assessment.scale[0], "sigma": _number(assessment.scale[1])}
    if assessment.centres is not None:
        centres = assessment.centres
        data["lens_distance_m"] = {"value": centres.distance, "sigma": _number(centres.sigma)}
    data["left_out"] = [
        {
            "target": one.target,
            "shift": one.shift.tolist(),
            "shift_in_sigma": one.shift_in_sigma.tolist(),
            "distance_m": one.distance,
            "probability": one.probability,
        }
        for one in assessment.left_out
    ]
    data["residuals"] = [_residual_data(one) for one in report.residuals()]
    return data


def _number(value: float) -> float | None:
    return value if np.isfinite(value) else None


def _finding_data(finding: Finding) -> dict[str, str]:
    return {"severity": str(finding.severity), "code": finding.code, "what": finding.what, "how": finding.how}


def _observation_data(one: TargetObservation) -> dict[str, Any]:
    return {
        "target": one.target,
        "shot": one.shot,
        "markers": one.markers,
        "corners": len(one.corners.points),
        "legacy_pattern": one.pattern.legacy,
    }


def _residual_data(one: CornerResiduals) -> dict[str, Any]:
    return {
        "target": one.target,
        "shot": one.shot,
        "rms_deg": float(np.degrees(one.rms)),
        "rms_px": one.rms_px,
        "rms_mm_at_2_m": at_reference(one.rms),
        "pixels": one.pixels.round(4).tolist(),
        "residual_deg": np.degrees(one.angle).round(6).tolist(),
        "residual_px": (one.angle / one.pixel_angle).round(4).tolist(),
        "used": one.used.tolist(),
    }


def report_page(report: Report) -> str:
    """Return the report as a page of HTML."""
    return page("palletloc calibrate extrinsics", _parts(report))


def _parts(report: Report) -> Iterator[str]:
    assessment = report.assessment
    yield heading("Where the camera is on the forklift", level=1)
    yield paragraph(_VERDICT[assessment.exit_code], "lead")
    yield from _result(assessment)
    yield from _findings(assessment.findings)
    yield from _targets(report)
    if report.frame is not None and report.frame.residuals:
        yield from _frame(report.frame, assessment.solution)
    if assessment.solution is not None:
        yield from _uncertainty(assessment)
        yield from _left_out(assessment)


def _result(assessment: Assessment) -> Iterator[str]:
    solution = assessment.solution
    if solution is None:
        return
    translation, angles = angles_from_transform(solution.poses.camera)
    sigma = np.concatenate([1000 * solution.sigma[:3], np.degrees(solution.sigma[3:])])
    places = zip(NAMES[:3], translation, sigma[:3], strict=True)
    turns = zip(NAMES[3:], angles, sigma[3:], strict=True)
    yield key_figures(
        [
            *((f"{1000 * value:.1f} mm", f"{name} {_PM} {s:.2f} mm") for name, value, s in places),
            *((f"{value:.3f}{_DEGREE}", f"{name} {_PM} {s:.3f}{_DEGREE}") for name, value, s in turns),
        ]
    )
    yield paragraph(
        f"After {_PM} stands one standard deviation, along and about the forklift's axes, from the scatter of the"
        " corners and the stated accuracy of the survey."
    )


def _findings(findings: Sequence[Finding]) -> Iterator[str]:
    yield heading("What to do next")
    if not findings:
        text = (
            "Nothing is left to do: paste the content of rig.yaml into recording.yaml. Repeat the calibration after"
        )
        yield paragraph(f"{text} anything has hit the camera or its mast.")
        return
    order = list(Severity)
    ordered = sorted(findings, key=lambda finding: order.index(finding.severity))
    columns = (Column("", is_text=True), Column("code", is_text=True), Column("what, and what to do", is_text=True))
    rows = [[str(f.severity), f.code, f.what] for f in ordered]
    yield table(
        columns, [cell for row, f in zip(rows, ordered, strict=True) for cell in (row, ["", "", f"do: {f.how}"])]
    )


def _targets(report: Report) -> Iterator[str]:
    yield heading("Targets")
    residuals = {(one.target, one.shot): one for one in report.residuals()}
    columns = (
        Column("target", is_text=True),
        Column("shot", is_text=True),
        *(
            Column(name)
            for name in ("markers", "corners", "left out", f"rms {_DEGREE}", "rms px", "mm at 2 m", "max px")
        ),
    )
    rows = []
    for one in report.observations:
        counts = [one.target, one.shot, f"{one.markers} of {len(one.pattern.marker_ids)}"]
        counts.append(f"{len(one.corners.points)} of {len(one.pattern.corners)}")
        rest = residuals.get((one.target, one.shot))
        rows.append([*counts, *([""] * 5 if rest is None else _residual_cells(rest))])
    yield table(columns, rows)
    if report.unseen:
        yield paragraph(f"Not seen in any shot: {', '.join(report.unseen)}.")
    if residuals:
        yield _embedded(sphere_figure(list(residuals.values())), "Where the targets are seen, and how they are off.")
        yield _embedded(polar_figure(list(residuals.values())), "The same over the angle off the optical axis.")


def _residual_cells(one: CornerResiduals) -> list[str]:
    largest = (one.angle / one.pixel_angle)[one.used].max(initial=0.0)
    refused = str(int((~one.used).sum()))
    return [
        refused, f"{np.degrees(one.rms):.4f}", f"{one.rms_px:.3f}", f"{at_reference(one.rms):.2f}", f"{largest:.3f}"
    ]  # fmt: skip


def _frame(frame: ForkliftFrame, solution: Extrinsics | None) -> Iterator[str]:
    yield heading("The forklift in the survey")
    rows = [[name, f"{1000 * off:.2f}"] for name, off in (frame.residuals or {}).items()]
    yield table((Column("point", is_text=True), Column("off mm")), rows)
    if solution is not None:
        sigma = np.sqrt(np.diag(solution.frame_covariance))
        yield paragraph(
            f"Found by {frame.method}. Its errors are in the result's: {1000 * sigma[:3].max():.2f} mm and"
            f" {np.degrees(sigma[3:].max()):.4f}{_DEGREE} at the camera."
        )


def _uncertainty(assessment: Assessment) -> Iterator[str]:
    solution = assessment.solution
    if solution is None:
        return
    yield heading("How sure it is")
    words = weakest(solution.covariance)[1]
    yield paragraph(
        f"The weakest direction is {words}. Corners scatter {solution.sight_factor:.2f} times as much as the image"
        f" noise says, the survey {solution.survey_factor:.2f} times as much as sigma_m says."
    )
    value, sigma = assessment.scale
    yield paragraph(f"Scale of the survey against the printed size: {100 * value:+.3f} {_PM} {100 * sigma:.3f} %.")
    if assessment.centres is not None:
        centres = assessment.centres
        known = (
            f"{1000 * centres.distance:.2f} {_PM} {1000 * centres.sigma:.2f} mm"
            if np.isfinite(centres.sigma)
            else "not told"
        )
        yield paragraph(
            f"Distance of two lens centres along the camera's x axis, if there were two: {known}."
            f" {100 * centres.front_share:.0f} % of the corners are before the camera."
        )
    yield _embedded(correlation_figure(solution), "Correlations.")


def _left_out(assessment: Assessment) -> Iterator[str]:
    if not assessment.left_out:
        return
    yield heading("Each target left out")
    yield paragraph(
        "The fit without a target says where it should be. Distance is between its surveyed corners and that place;"
        " chance is how probable such a distance or a larger one is if all sigmas are right."
    )
    columns = (
        Column("target", is_text=True), Column("distance mm"), Column("chance"),
        *(Column(f"{name} {'mm' if i < 3 else _DEGREE}") for i, name in enumerate(NAMES)), Column("most sigmas"),
    )  # fmt: skip
    rows = []
    for one in assessment.left_out:
        shift = [*(f"{1000 * v:+.2f}" for v in one.shift[:3]), *(f"{np.degrees(v):+.4f}" for v in one.shift[3:])]
        most = f"{np.abs(one.shift_in_sigma).max():.2f}"
        rows.append([one.target, f"{1000 * one.distance:.2f}", f"{one.probability:.3f}", *shift, most])
    yield table(columns, rows)
    yield _embedded(left_out_figure(assessment.left_out), "Shifts of the pose without each target.")


def _embedded(figure: Figure, caption: str) -> str:
    content = base64.b64encode(small_png(figure)).decode("ascii")
    return picture(f"data:image/png;base64,{content}", caption, keep_wide=True)
