"""What there is to say of a planned layout of targets."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from calibration import result_page as page
from calibration.degeneracy import NAMES, weakest
from calibration.plan.assessment import Plan
from calibration.plan.prediction import LayoutPrediction, PredictedTarget, worst
from calibration.report_figure import HEAD, LEFT, RIGHT, titled_figure
from palletloc.drawing.canvas import DEGREE, FAINT, GRID, INK, SERIES, WIDTH_PX, add_axes
from palletloc.geometry import FloatArray

_VERDICTS = {
    0: "A calibration with this layout would pass.",
    1: "A calibration with this layout would fail.",
    3: "This layout cannot give a calibration.",
}
"""By exit code."""
_OPEN_PLACE, _OPEN_TURN = 10.0, np.pi
"""Standard deviations from which on a number is open, in metres and radians: nothing tells it."""
_MOST_WORST = 100.0
"""The same, in units of what passes."""
_COLUMNS = (
    *page.words("target"),
    *page.numbers("distance m", f"azimuth {DEGREE}", f"oblique {DEGREE}", "marker px", "corners"),
)
"""How a target will be seen."""


def plan_page(plan: Plan) -> page.ResultPage:
    """Return a plan, from `plan_targets`, as all outputs show it."""
    return page.ResultPage(
        "palletloc calibrate plan", "What this layout would give", _VERDICTS, tuple(_sections(plan))
    )


def _sections(plan: Plan) -> Iterator[page.Section]:
    prediction = plan.prediction
    found = any(target.found for target in prediction.targets)
    if found:
        yield page.KeyFigures(tuple(zip(_sigma_texts(prediction.sigma), NAMES, strict=True)))
        yield page.Paragraph(
            "Predicted standard deviations along and about the forklift's axes, if corners and survey are as good as"
            " planned. Bent boards and errors of the camera model come on top."
        )
    yield page.Findings(plan.findings, "Nothing has to change.")
    yield from _targets(plan)
    if found:
        yield from _sigmas(plan)
        yield from _uncertainty(plan)


def _targets(plan: Plan) -> Iterator[page.Section]:
    prediction = plan.prediction
    without = [prediction.without(i) for i in range(len(prediction.targets))]
    pairs = list(zip(prediction.targets, without, strict=True))
    yield page.JsonValues({"targets": [_target_values(target, rest) for target, rest in pairs]})
    if not pairs:
        return
    yield page.Heading("Targets")
    rows = tuple(_target_row(target) for target in prediction.targets)
    rest = (f"{size:.2f}" if (size := worst(sigma)) < _MOST_WORST else "open" for sigma in without)
    longer = tuple((*row, cell) for row, cell in zip(rows, rest, strict=True))
    yield page.Table((*_COLUMNS, *page.numbers("worst sigma without it")), longer)
    yield page.Table(_COLUMNS, rows, page.Output.TERMINAL)
    yield page.Paragraph("The worst sigma is in units of what passes: 5 mm or 0.1 degrees. One is the limit.")
    yield page.Drawing(partial(_figure, prediction), "Targets around the forklift, and in the camera's image.")


def _target_values(target: PredictedTarget, without: FloatArray) -> dict[str, Any]:
    return {
        "target": target.planned.survey.name,
        "found": target.found,
        "distance_m": target.distance,
        "oblique_deg": float(np.degrees(target.obliqueness)),
        "marker_px": target.marker_px,
        "corners": len(target.corners.points),
        "sigma_without": _known(without),
    }


def _target_row(target: PredictedTarget) -> tuple[str, ...]:
    azimuth = np.degrees(np.arctan2(target.direction[1], target.direction[0]))
    return (
        target.planned.survey.name,
        f"{target.distance:.2f}",
        f"{azimuth:+.0f}",
        f"{np.degrees(target.obliqueness):.0f}",
        f"{target.marker_px:.0f}",
        f"{len(target.corners.points)}/{len(target.planned.pattern.corners)}",
    )


def _known(values: FloatArray) -> list[float | None]:
    """Return numbers, with None where they say no more than that nothing is known."""
    return [float(value) if np.isfinite(value) and value < 1e3 else None for value in values]


def _sigma_values(sigma: FloatArray) -> dict[str, list[float | None]]:
    return {"translation_sigma_m": _known(sigma[:3]), "rotation_sigma_deg": _known(np.degrees(sigma[3:]))}


def _sigma_texts(sigma: FloatArray) -> list[str]:
    """Return six standard deviations as texts; ``open`` where nothing tells."""
    places = [f"{1000 * place:.2f} mm" if place < _OPEN_PLACE else "open" for place in sigma[:3]]
    return places + [f"{np.degrees(turn):.4f}{DEGREE}" if turn < _OPEN_TURN else "open" for turn in sigma[3:]]


def _sigmas(plan: Plan) -> Iterator[page.Section]:
    """Yield what the terminal says of the six numbers."""
    columns, texts = ["", "predicted sigma"], [_sigma_texts(plan.prediction.sigma)]
    if plan.suggestion is not None:
        columns.append("with one more target")
        texts.append(_sigma_texts(plan.suggestion.sigma))
    yield page.Table(page.numbers(*columns), tuple(zip(NAMES, *texts, strict=True)), page.Output.TERMINAL)
    if plan.suggestion is not None:
        yield page.Paragraph(f"one more target: {plan.suggestion.words}", page.Output.TERMINAL)


def _uncertainty(plan: Plan) -> Iterator[page.Section]:
    prediction = plan.prediction
    covariance, sigma, lost = prediction.covariance, prediction.sigma, prediction.lost()
    correlation, weakest_direction = covariance / np.outer(sigma, sigma), weakest(covariance)[1]
    (lens_sigma, share) = _known(np.array([prediction.lens_sigma, plan.survey_share]))
    yield page.JsonValues(
        {
            "predicted": {"order": list(NAMES), **_sigma_values(sigma), "correlation": correlation.tolist()},
            "lost_directions": lost,
            "weakest_direction": weakest_direction,
            "lens_distance_sigma_m": lens_sigma,
            "survey_share": share,
        }
    )
    yield page.Heading("How sure it would be")
    if lost:
        yield page.Paragraph(f"Left open: {'; '.join(lost)}.")
    else:
        known = np.isfinite(plan.survey_share)
        words_ = f" {100 * plan.survey_share:.0f} % of the worst variance comes from the survey." if known else ""
        yield page.Paragraph(f"The weakest direction is {weakest_direction}.{words_}")
    rows = (
        (name, *(f"{round(float(value), 2) + 0.0:.2f}" for value in row))
        for name, row in zip(NAMES, correlation, strict=True)
    )
    yield page.Table((*page.words("correlation"), *page.numbers(*NAMES)), tuple(rows))
    if plan.suggestion is not None:
        suggestion = plan.suggestion
        yield page.JsonValues({"suggestion": {"words": suggestion.words, **_sigma_values(suggestion.sigma)}})
        pairs = zip(NAMES, _sigma_texts(suggestion.sigma), strict=True)
        told = ", ".join(f"{name} {text}" for name, text in pairs)
        yield page.Paragraph(f"What would help most: {suggestion.words}. Then: {told}.")


def _figure(prediction: LayoutPrediction) -> Figure:
    """Draw a layout from above, and what the camera will see of it."""
    line = (
        "From above, with the camera's lines of sight; and all directions as the camera sees them. Gray is not found"
    )
    figure = titled_figure(560, "The layout", line)
    above = add_axes(figure, LEFT, HEAD, 440, 430)
    around = add_axes(figure, LEFT + 520, HEAD, WIDTH_PX - LEFT - RIGHT - 520, 430)
    eye = prediction.layout.forklift_from_camera.translation
    for i, target in enumerate(prediction.targets):
        color = SERIES[i % len(SERIES)] if target.found else FAINT
        _draw_above(above, target, color, eye)
        _draw_around(around, target, color)
    above.annotate("", (0, 0.6), (0, 0), arrowprops={"arrowstyle": "->", "color": INK})
    above.plot(0, 0, "+", color=INK, markersize=9)
    above.plot(eye[1], eye[0], "o", color=INK, markersize=6)
    above.set_aspect("equal", adjustable="datalim")
    above.set(xlabel="to the left (m)", ylabel="forward (m)")
    above.invert_xaxis()
    around.set(xlim=(180, -180), ylim=(-90, 90), xlabel=f"longitude ({DEGREE})", ylabel=f"latitude ({DEGREE})")
    around.set_xticks(range(-180, 181, 90))
    around.set_yticks(range(-90, 91, 30))
    for axes in (above, around):
        axes.grid(color=GRID, linewidth=0.6)
        axes.set_axisbelow(True)
    return figure


def _draw_above(axes: Axes, target: PredictedTarget, color: str, eye: FloatArray) -> None:
    left, right, lower = target.planned.survey.points
    ring = np.array([left, right, right + lower - left, lower, left])
    axes.plot(ring[:, 1], ring[:, 0], color=color, linewidth=2.5, solid_capstyle="butt")
    x, y, _ = ring[:4].mean(0)
    axes.plot([eye[1], y], [eye[0], x], color=color, linewidth=0.6, alpha=0.6)
    axes.annotate(target.planned.survey.name, (y, x), (4, 6), textcoords="offset points", color=INK, size=10)


def _draw_around(axes: Axes, target: PredictedTarget, color: str) -> None:
    x, y, z = target.corners.bearings.T
    if not len(x):
        return
    lon, lat = np.degrees(np.arctan2(y, x)), np.degrees(np.arctan2(z, np.hypot(x, y)))
    axes.plot(lon, lat, "o", color=color, markersize=2.5)
    place = float(np.median(lon)), float(lat.max()) + 4
    axes.annotate(target.planned.survey.name, place, color=INK, size=10, ha="center")
