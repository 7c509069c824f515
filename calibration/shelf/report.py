"""The report on a shelf's front: one page of HTML that needs nothing but itself, and the same as JSON."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from calibration.finding_table import finding_data, finding_parts
from calibration.shelf.assessment import ShelfAssessment
from calibration.shelf.figure import plan_figure
from calibration.shelf.plane import Foot, PlaneEstimate
from calibration.shelf.plane_sweep import PlaneSweep
from calibration.shelf.survey import Front
from palletloc.drawing.canvas import small_png
from palletloc.report.page import Column, embedded, heading, key_figures, page, paragraph, picture, table
from palletloc.shelf import ShelfPlane

_DEGREE, _PM = "\N{DEGREE SIGN}", "\N{PLUS-MINUS SIGN}"
_FRONT = {
    Front.UPRIGHTS: "the front faces of the uprights",
    Front.PALLETS: "the middle of the pallets' fronts",
}
_VERDICT = {0: "The plane holds.", 1: "The plane fails.", 3: "The data cannot give the plane."}


def shelf_data(assessment: ShelfAssessment) -> dict[str, Any]:
    """Return the report as plain values for JSON: metres, radians where nothing else is said."""
    survey = assessment.survey
    data: dict[str, Any] = {
        "format": 1,
        "exit_code": assessment.exit_code,
        "reasons": [finding_data(finding) for finding in assessment.findings],
        "front": str(survey.front),
        "shots": len(survey.shots),
        "foot_m": survey.foot.point.tolist(),
        "methods": [_method_data(survey.foot, estimate) for estimate in survey.estimates],
        "skipped": [
            {"method": skipped.method, "code": skipped.code, "what": skipped.what} for skipped in survey.skipped
        ],
        "odometry": {"scale": survey.solution.scale, "yaw_rate_bias_radps": survey.solution.bias},
    }
    if survey.fused is not None and survey.plane is not None:
        fused = survey.fused
        data["shelf"] = _plane_data(survey.plane) | {
            "distance_m": fused.distance,
            "distance_sigma_m": float(np.sqrt(fused.covariance[1, 1])),
            "facing_sigma_deg": float(np.degrees(np.sqrt(fused.covariance[0, 0]))),
            "covariance": fused.covariance.tolist(),
            "covariance_order": ["facing_rad", "distance_m"],
            "chance": fused.chance,
        }
    if survey.sweep is not None:
        data["sweep"] = _sweep_data(survey.sweep)
    return data


def _sweep_data(sweep: PlaneSweep) -> dict[str, Any]:
    return {
        "distance_m": sweep.distance,
        "code": sweep.refusal,
        "windows": sweep.windows,
        "peaks": [{"distance_m": peak.distance, "score": peak.score} for peak in sweep.peaks],
        "distances_m": sweep.distances.tolist(),
        "scores": sweep.scores.tolist(),
    }


def _plane_data(plane: ShelfPlane) -> dict[str, Any]:
    return {"point_m": [plane.x, plane.y], "facing_deg": float(np.degrees(plane.facing))}


def _method_data(foot: Foot, estimate: PlaneEstimate) -> dict[str, Any]:
    turn, distance = estimate.sigma
    known = np.isfinite(distance)
    return {
        "method": estimate.method,
        "facing_deg": float(np.degrees(foot.plane(estimate.turn, 1.0).facing)),
        "facing_sigma_deg": float(np.degrees(turn)) if np.isfinite(turn) else None,
        "distance_m": estimate.distance if known else None,
        "distance_sigma_m": distance if known else None,
        "evidence": estimate.evidence,
    }


def shelf_page(assessment: ShelfAssessment) -> str:
    """Return the report as a page of HTML."""
    return page("palletloc calibrate shelf", _parts(assessment))


def _parts(assessment: ShelfAssessment) -> Iterator[str]:
    survey = assessment.survey
    yield heading("Where the shelf's front is", level=1)
    yield paragraph(_VERDICT[assessment.exit_code], "lead")
    if survey.fused is not None and survey.plane is not None:
        turn, distance = np.sqrt(np.diag(survey.fused.covariance))
        yield key_figures(
            [
                (f"{survey.fused.distance:.3f} m", f"from the camera {_PM} {1000 * distance:.1f} mm"),
                (f"{np.degrees(survey.plane.facing):.2f}{_DEGREE}", f"facing {_PM} {np.degrees(turn):.2f}{_DEGREE}"),
            ]
        )
        yield paragraph(
            f"The plane goes through {_FRONT[survey.front]}, in odom as it was at the first sample of the"
            " odometry. The distance is that from the camera at the middle of the way; after the sign stands one"
            " standard deviation."
        )
    yield from finding_parts(assessment.findings, "Nothing is left to do: use the recording.yaml that was written.")
    yield heading("Methods")
    yield table(method_columns(), [method_row(survey.foot, estimate) for estimate in survey.estimates])
    yield picture(
        embedded(small_png(plan_figure(survey))), "From above: the way, the pallets, the edges and the plane.",
        keep_wide=True,
    )  # fmt: skip
    if survey.sweep is not None and survey.fused is not None:
        yield from _sweep_parts(survey.sweep, survey.fused.distance)
    solution = survey.solution
    yield paragraph(
        f"{len(survey.shots)} shots were used. By them the odometry's distances are off by"
        f" {100 * (1 / solution.scale - 1):+.2f} % and its yaw rate by {np.degrees(solution.bias):+.3f}{_DEGREE}/s."
    )


def _sweep_parts(sweep: PlaneSweep, distance: float) -> Iterator[str]:
    yield heading("Where surfaces are")
    yield paragraph(
        f"The plane was moved by 15 cm to either side. At each peak of the {len(sweep.distances)} distances the most"
        f" of {sweep.windows} small windows look alike from several places: there are uprights, beams or pallets."
        " Which of them it is cannot be told, so a clear peak counts with what they stand apart."
    )
    columns = (Column("distance m"), Column("behind the result, mm"), Column("windows alike, %"))
    rows = [(peak.distance, 1000 * (peak.distance - distance), 100 * peak.score) for peak in sweep.peaks]
    yield table(columns, [[f"{at:.3f}", f"{off:+.0f}", f"{alike:.1f}"] for at, off, alike in rows])


def method_columns() -> tuple[Column, ...]:
    """Return the heads of the table of methods."""
    return (
        Column("method", is_text=True),
        *(Column(name) for name in (f"facing {_DEGREE}", "sigma", "distance m", "sigma mm")),
        Column("from", is_text=True),
    )


def method_row(foot: Foot, estimate: PlaneEstimate) -> list[str]:
    """Return the cells of one method."""
    turn, distance = estimate.sigma
    known = np.isfinite(distance)
    return [
        estimate.method,
        f"{np.degrees(foot.plane(estimate.turn, 1.0).facing):.2f}",
        f"{np.degrees(turn):.2f}" if np.isfinite(turn) else "",
        f"{estimate.distance:.4f}" if known else "",
        f"{1000 * distance:.1f}" if known else "",
        estimate.evidence,
    ]
