"""The report of a plan: one page of HTML that needs nothing but itself, and the same as JSON."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from calibration.degeneracy import NAMES, weakest
from calibration.finding_table import finding_data, finding_parts
from calibration.plan.assessment import Plan
from calibration.plan.figure import layout_figure
from calibration.plan.prediction import PlannedSight, worst
from palletloc.drawing.canvas import small_png
from palletloc.geometry import FloatArray
from palletloc.report.page import Column, embedded, heading, key_figures, page, paragraph, picture, table

_DEGREE = "\N{DEGREE SIGN}"
_VERDICT = {
    0: "A calibration with this layout would pass.",
    1: "A calibration with this layout would fail.",
    3: "This layout cannot give a calibration.",
}
_SHOWN = 10.0
TARGET_HEADINGS = ("target", "distance m", f"azimuth {_DEGREE}", f"oblique {_DEGREE}", "marker px", "corners")
"""Above the cells of `target_cells`."""


def plan_data(plan: Plan) -> dict[str, Any]:
    """Return the report as plain values for JSON: metres, radians where nothing else is said."""
    prediction = plan.prediction
    data: dict[str, Any] = {
        "format": 1,
        "exit_code": plan.exit_code,
        "reasons": [finding_data(one) for one in plan.findings],
        "targets": [_sight_data(plan, i) for i in range(len(prediction.sights))],
    }
    if not any(one.found for one in prediction.sights):
        return data
    sigma, covariance = prediction.sigma, prediction.covariance
    data["predicted"] = {
        "order": list(NAMES),
        "translation_sigma_m": [_number(v) for v in sigma[:3]],
        "rotation_sigma_deg": [_number(v) for v in np.degrees(sigma[3:])],
        "correlation": (covariance / np.outer(sigma, sigma)).tolist(),
    }
    data["lost_directions"] = prediction.lost()
    data["weakest_direction"] = weakest(covariance)[1]
    data["lens_distance_sigma_m"] = _number(prediction.lens_sigma)
    data["survey_share"] = _number(plan.survey_share)
    if plan.suggestion is not None:
        data["suggestion"] = {
            "words": plan.suggestion.words,
            "translation_sigma_m": [_number(v) for v in plan.suggestion.sigma[:3]],
            "rotation_sigma_deg": [_number(v) for v in np.degrees(plan.suggestion.sigma[3:])],
        }
    return data


def _number(value: float) -> float | None:
    """Return a number, or None where it says no more than that nothing is known."""
    return float(value) if np.isfinite(value) and value < 1e3 else None


def _sight_data(plan: Plan, index: int) -> dict[str, Any]:
    one = plan.prediction.sights[index]
    without = plan.prediction.without(index)
    return {
        "target": one.planned.survey.name,
        "found": one.found,
        "distance_m": one.distance,
        "oblique_deg": float(np.degrees(one.obliqueness)),
        "marker_px": one.marker_px,
        "corners": len(one.sight.points),
        "sigma_without": [_number(v) for v in without],
    }


def target_cells(one: PlannedSight) -> list[str]:
    """Return how a target will be seen, as texts."""
    azimuth = np.degrees(np.arctan2(one.direction[1], one.direction[0]))
    return [
        one.planned.survey.name,
        f"{one.distance:.2f}",
        f"{azimuth:+.0f}",
        f"{np.degrees(one.obliqueness):.0f}",
        f"{one.marker_px:.0f}",
        f"{len(one.sight.points)}/{len(one.planned.pattern.corners)}",
    ]


def sigma_texts(sigma: FloatArray) -> list[str]:
    """Return six standard deviations as texts; ``open`` where nothing tells."""
    places = [f"{1000 * v:.2f} mm" if v < _SHOWN else "open" for v in sigma[:3]]
    return places + [f"{np.degrees(v):.4f}{_DEGREE}" if v < np.pi else "open" for v in sigma[3:]]


def plan_page(plan: Plan) -> str:
    """Return the report as a page of HTML."""
    return page("palletloc calibrate plan", _parts(plan))


def _parts(plan: Plan) -> Iterator[str]:
    prediction = plan.prediction
    yield heading("What this layout would give", level=1)
    yield paragraph(_VERDICT[plan.exit_code], "lead")
    found = any(one.found for one in prediction.sights)
    if found:
        yield key_figures(list(zip(sigma_texts(prediction.sigma), NAMES, strict=True)))
        yield paragraph(
            "Predicted standard deviations along and about the forklift's axes, if corners and survey are as good as"
            " planned. Bent boards and errors of the camera model come on top."
        )
    yield from finding_parts(plan.findings, "Nothing has to change.")
    if prediction.sights:
        yield from _target_table(plan)
        picture_ = embedded(small_png(layout_figure(prediction)))
        yield picture(picture_, "Targets around the forklift, and in the camera's image.", keep_wide=True)
    if found:
        yield from _uncertainty(plan)


def _target_table(plan: Plan) -> Iterator[str]:
    yield heading("Targets")
    columns = (Column(TARGET_HEADINGS[0], is_text=True), *(Column(name) for name in TARGET_HEADINGS[1:]))
    rows = []
    for i, one in enumerate(plan.prediction.sights):
        rest = worst(plan.prediction.without(i))
        rows.append([*target_cells(one), f"{rest:.2f}" if rest < 100 else "open"])
    yield table((*columns, Column("worst sigma without it")), rows)
    yield paragraph("The worst sigma is in units of what passes: 5 mm or 0.1 degrees. One is the limit.")


def _uncertainty(plan: Plan) -> Iterator[str]:
    yield heading("How sure it would be")
    prediction = plan.prediction
    covariance, sigma = prediction.covariance, prediction.sigma
    correlation = covariance / np.outer(sigma, sigma)
    lost = prediction.lost()
    if lost:
        yield paragraph(f"Left open: {'; '.join(lost)}.")
    else:
        share = (
            f" {100 * plan.survey_share:.0f} % of the worst variance comes from the survey."
            if np.isfinite(plan.survey_share)
            else ""
        )
        yield paragraph(f"The weakest direction is {weakest(covariance)[1]}.{share}")
    columns = (Column("correlation", is_text=True), *(Column(name) for name in NAMES))
    yield table(
        columns,
        [
            [name, *(f"{round(float(v), 2) + 0.0:.2f}" for v in row)]
            for name, row in zip(NAMES, correlation, strict=True)
        ],
    )
    if plan.suggestion is not None:
        told = ", ".join(
            f"{name} {text}" for name, text in zip(NAMES, sigma_texts(plan.suggestion.sigma), strict=True)
        )
        yield paragraph(f"What would help most: {plan.suggestion.words}. Then: {told}.")
