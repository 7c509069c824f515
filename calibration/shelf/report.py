"""What there is to say of a shelf's front: the plane, what each method gives, and the plan from above."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from calibration import result_page as page
from calibration.drive import compose
from calibration.findings import PASS
from calibration.report_figure import HEAD, titled_figure, wide_axes
from calibration.shelf.assessment import ShelfAssessment
from calibration.shelf.plane import Foot, PlaneEstimate
from calibration.shelf.plane_sweep import PlaneSweep
from calibration.shelf.survey import Front, ShelfSurvey
from palletloc.drawing.canvas import DEGREE, FAINT, GRID, INK, PLUS_MINUS, SERIES, add_legend
from palletloc.geometry import FloatArray
from palletloc.io.recording import RECORDING
from palletloc.io.schema import RecordingSpec, ShelfSpec
from palletloc.io.yaml_document import format_document, read_document
from palletloc.shelf import ShelfPlane

_FRONT = {Front.UPRIGHTS: "the front faces of the uprights", Front.PALLETS: "the middle of the pallets' fronts"}
"""What a front is, in words."""
_VERDICTS = {0: "The plane holds.", 1: "The plane fails.", 3: "The data cannot give the plane."}
"""By exit code."""
_USABLE = "The plane can be used"
"""Where warnings restrict it."""
_METHODS = (
    *page.words("method"),
    *page.numbers(f"facing {DEGREE}", "sigma", "distance m", "sigma mm"),
    *page.words("from"),
)
"""What each method gives."""


def shelf_page(assessment: ShelfAssessment) -> page.ResultPage:
    """Return a calibration of a shelf as all outputs show it.

    Parameters
    ----------
    assessment : ShelfAssessment
        From `calibrate_shelf`.

    Raises
    ------
    PalletLocError
        If the recording.yaml, which the result changes, cannot be read.
    """
    survey, content = assessment.survey, None
    if assessment.exit_code == PASS and survey.plane is not None:
        content = recording_text(read_document(survey.recording.folder / RECORDING, RecordingSpec), survey.plane)
    sections = tuple(_sections(assessment))
    return page.ResultPage(
        "palletloc calibrate shelf", "Where the shelf's front is", _VERDICTS, sections, content, _USABLE
    )


def _sections(assessment: ShelfAssessment) -> Iterator[page.Section]:
    survey, solution = assessment.survey, assessment.survey.solution
    yield from _plane(survey)
    yield page.Findings(assessment.findings, "Nothing is left to do: use the recording.yaml that was written.")
    yield page.JsonValues(_values(survey))
    yield page.Heading("Methods")
    yield from _methods(survey)
    yield page.Drawing(partial(_plan_figure, survey), "From above: the way, the pallets, the edges and the plane.")
    if survey.sweep is not None:
        yield from _sweep(survey.sweep, None if survey.fused is None else survey.fused.distance)
    yield page.Paragraph(
        f"{len(survey.shots)} shots were used. By them the odometry's distances are off by"
        f" {100 * (1 / solution.scale - 1):+.2f} % and its yaw rate by {np.degrees(solution.bias):+.3f}{DEGREE}/s."
    )


def _plane(survey: ShelfSurvey) -> Iterator[page.Section]:
    if survey.fused is None or survey.plane is None:
        return
    turn, distance = np.sqrt(np.diag(survey.fused.covariance))
    yield page.KeyFigures(
        (
            (f"{survey.fused.distance:.3f} m", f"from the camera {PLUS_MINUS} {1000 * distance:.1f} mm"),
            (f"{np.degrees(survey.plane.facing):.2f}{DEGREE}", f"facing {PLUS_MINUS} {np.degrees(turn):.2f}{DEGREE}"),
        )
    )
    yield page.Paragraph(
        f"The plane goes through {_FRONT[survey.front]}, in odom as it was at the first sample of the"
        " odometry. The distance is that from the camera at the middle of the way; after the sign stands one"
        " standard deviation."
    )


def _values(survey: ShelfSurvey) -> dict[str, Any]:
    """Return plain values for JSON: metres, radians where nothing else is said."""
    values: dict[str, Any] = {
        "front": str(survey.front),
        "shots": len(survey.shots),
        "foot_m": survey.foot.point.tolist(),
        "methods": [_method_values(survey.foot, estimate) for estimate in survey.estimates],
        "skipped": [
            {"method": skipped.method, "code": skipped.code, "what": skipped.what} for skipped in survey.skipped
        ],
        "odometry": {"scale": survey.solution.scale, "yaw_rate_bias_radps": survey.solution.bias},
    }
    fused, plane = survey.fused, survey.plane
    if fused is not None and plane is not None:
        values["shelf"] = {
            "point_m": [plane.x, plane.y],
            "facing_deg": float(np.degrees(plane.facing)),
            "distance_m": fused.distance,
            "distance_sigma_m": float(np.sqrt(fused.covariance[1, 1])),
            "facing_sigma_deg": float(np.degrees(np.sqrt(fused.covariance[0, 0]))),
            "covariance": fused.covariance.tolist(),
            "covariance_order": ["facing_rad", "distance_m"],
            "chance": fused.chance,
        }
    return values


def _method_values(foot: Foot, estimate: PlaneEstimate) -> dict[str, Any]:
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


def _methods(survey: ShelfSurvey) -> Iterator[page.Section]:
    rows = tuple(_method_row(survey.foot, estimate) for estimate in survey.estimates)
    total: tuple[str, ...] = ()
    fused, plane = survey.fused, survey.plane
    if fused is not None and plane is not None:
        turn, distance = np.sqrt(np.diag(fused.covariance))
        facing = (f"{np.degrees(plane.facing):.2f}", f"{np.degrees(turn):.2f}")
        total = ("together", *facing, f"{fused.distance:.4f}", f"{1000 * distance:.1f}", "")
    yield page.Table(_METHODS, rows, page.Output.PAGE | page.Output.TERMINAL if rows else page.Output.PAGE, total)


def _method_row(foot: Foot, estimate: PlaneEstimate) -> tuple[str, ...]:
    """Return the cells of one method."""
    turn, distance = estimate.sigma
    known = np.isfinite(distance)
    return (
        estimate.method,
        f"{np.degrees(foot.plane(estimate.turn, 1.0).facing):.2f}",
        f"{np.degrees(turn):.2f}" if np.isfinite(turn) else "",
        f"{estimate.distance:.4f}" if known else "",
        f"{1000 * distance:.1f}" if known else "",
        estimate.evidence,
    )


def _sweep(sweep: PlaneSweep, distance: float | None) -> Iterator[page.Section]:
    yield page.JsonValues(
        {
            "sweep": {
                "distance_m": sweep.distance,
                "code": sweep.refusal,
                "windows": sweep.windows,
                "peaks": [{"distance_m": peak.distance, "score": peak.score} for peak in sweep.peaks],
                "distances_m": sweep.distances.tolist(),
                "scores": sweep.scores.tolist(),
            }
        }
    )
    if distance is None:
        return
    yield page.Heading("Where surfaces are")
    yield page.Paragraph(
        f"The plane was moved by 15 cm to either side. At each peak of the {len(sweep.distances)} distances the most"
        f" of {sweep.windows} small windows look alike from several places: there are uprights, beams or pallets."
        " Which of them it is cannot be told, so a clear peak counts with what they stand apart."
    )
    rows = [(peak.distance, 1000 * (peak.distance - distance), 100 * peak.score) for peak in sweep.peaks]
    yield page.Table(
        page.numbers("distance m", "behind the result, mm", "windows alike, %"),
        tuple((f"{at:.3f}", f"{off:+.0f}", f"{alike:.1f}") for at, off, alike in rows),
    )


def recording_text(spec: RecordingSpec, plane: ShelfPlane) -> str:
    """Return the content of a recording.yaml with another plane, in odom; all else stays."""
    shelf = ShelfSpec(
        point_m=(round(plane.x, 4), round(plane.y, 4)),
        facing_deg=round(float(np.degrees(plane.facing)), 3),
        levels_m=spec.shelf.levels_m,
    )
    return format_document(spec.model_copy(update={"shelf": shelf}))


def _plan_figure(survey: ShelfSurvey) -> Figure:
    """Draw the plan, and below it the depths ten times as large."""
    line = (
        "Seen along the result: right is along the shelf, up is into it. Below: depths against the result, stretched"
    )
    figure = titled_figure(900, "The shelf's front from above", line)
    plan, close = wide_axes(figure, 440), wide_axes(figure, 260, HEAD + 480)
    _draw_plan(plan, survey)
    _draw_depths(close, survey)
    close.set_xlim(plan.get_xlim())
    add_legend(figure, 862, plan, close, columns=8)
    return figure


_ALONG = "along the shelf, to the right as seen from the aisle (m)"
"""What the horizontal axes show."""


def _turned(survey: ShelfSurvey, points: FloatArray) -> FloatArray:
    """Return points, (n, 2) in odom, as places along the resulting plane and depths behind it."""
    turn, distance = (0.0, 0.0) if survey.fused is None else (survey.fused.turn, survey.fused.distance)
    right, depth = survey.foot.local(np.asarray(points).reshape(-1, 2)).T
    cos, sin = np.cos(turn), np.sin(turn)
    return np.stack([cos * right + sin * depth, cos * depth - sin * right - distance], axis=1)


def _draw_plan(axes: Axes, survey: ShelfSurvey) -> None:
    solution = survey.solution
    camera = np.array([*survey.recording.mounting.center[:2], 0.0])
    way = _turned(survey, compose(solution.poses, np.tile(camera, (len(solution.poses), 1)))[:, :2])
    axes.plot(*way.T, "-o", color=SERIES[0], markersize=3, linewidth=1, label="camera")
    for i, (pallet, model) in enumerate(zip(solution.pallets, survey.models, strict=True)):
        corners = np.array([[0, -0.5], [0, 0.5], [1, 0.5], [1, -0.5], [0, -0.5]]) * (model.depth, model.width)
        placed = compose(np.tile(pallet, (5, 1)), np.concatenate([corners, np.zeros((5, 1))], axis=1))[:, :2]
        axes.plot(*_turned(survey, placed).T, color=SERIES[4], linewidth=1, label="pallet" if i == 0 else None)
    chosen = survey.members > 0
    seen = _turned(survey, survey.edges.places)
    axes.plot(*seen[~chosen].T, "x", color=FAINT, markersize=5, label="other vertical edge")
    axes.plot(*seen[chosen].T, "o", color=SERIES[1], markersize=5, label="edge of the front")
    ends = np.array([way[:, 0].min() - 3, way[:, 0].max() + 3])
    if survey.fused is not None:
        axes.plot(ends, [0, 0], color=INK, linewidth=1.5, label="result")
        prior = survey.foot.described(survey.prior)
        slope = np.tan(prior[0] - survey.fused.turn)
        axes.plot(ends, prior[1] - survey.fused.distance + slope * ends, "--", color=FAINT, label="as given")
    axes.set_aspect("equal", adjustable="datalim")
    axes.set(xlabel=_ALONG, ylabel="into the shelf (m)")
    axes.grid(color=GRID, linewidth=0.6)


def _draw_depths(axes: Axes, survey: ShelfSurvey) -> None:
    chosen = survey.members > 0
    seen = _turned(survey, survey.edges.places)
    axes.plot(seen[~chosen, 0], 1000 * seen[~chosen, 1], "x", color=FAINT, markersize=5)
    axes.plot(seen[chosen, 0], 1000 * seen[chosen, 1], "o", color=SERIES[1], markersize=5)
    fronts = _turned(survey, survey.solution.pallets[:, :2])
    axes.plot(fronts[:, 0], 1000 * fronts[:, 1], "s", color=SERIES[4], markersize=6, label="pallet's front")
    if survey.fused is not None:
        turn, distance = np.sqrt(np.diag(survey.fused.covariance))
        along = np.linspace(-5, 5, 101)
        band = 2000 * np.hypot(distance, turn * along)
        axes.fill_between(along, -band, band, color="#eef3f8", zorder=0, label="two sigma")
    axes.axhline(0.0, color=INK, linewidth=1.2)
    axes.set(ylim=(-150, 150), xlabel=_ALONG, ylabel="behind the result (mm)")
    axes.grid(color=GRID, linewidth=0.6)
    axes.set_axisbelow(True)
