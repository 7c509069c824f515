"""What there is to say of a mounting from surveyed targets."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from calibration import result_page as page
from calibration.degeneracy import NAMES, weakest
from calibration.findings import Severity
from calibration.mounting.assessment import MountingAssessment, MountingResult
from calibration.mounting.checks import LeftOut
from calibration.mounting.fit import MountingFit
from calibration.mounting.forklift_frame import ForkliftFrame
from calibration.mounting.residuals import (
    CornerResiduals,
    at_reference,
    corner_residuals,
    polar_figure,
    sphere_figure,
)
from calibration.report_figure import draw_correlations, titled_figure, wide_axes
from calibration.rig_file import rig_text
from calibration.targets.observations import TargetObservation
from palletloc.drawing.canvas import DEGREE, INK, PLUS_MINUS, SERIES, add_legend
from palletloc.io.camera_spec import angles_from_transform

_VERDICTS = {0: "The calibration holds.", 1: "The calibration fails.", 3: "The data cannot give a calibration."}
"""By exit code."""
_USABLE = "The calibration can be used"
"""Where warnings restrict it."""
_NOTHING = (
    "Nothing is left to do: paste the content of rig.yaml into recording.yaml. Repeat the calibration after"
    " anything has hit the camera or its mast."
)
"""What the page says of a calibration without findings."""


def mounting_page(result: MountingResult) -> page.ResultPage:
    """Return a mounting, from `calibrate_mounting`, as all outputs show it."""
    content = None if result.mounting is None else rig_text(result.camera, result.mounting)
    heading = "Where the camera is on the forklift"
    return page.ResultPage(
        "palletloc calibrate extrinsics", heading, _VERDICTS, tuple(_sections(result)), content, _USABLE
    )


def _sections(result: MountingResult) -> Iterator[page.Section]:
    assessment, solution = result.assessment, result.assessment.solution
    residuals = () if solution is None else corner_residuals(solution, result.observations, result.names)
    if solution is not None:
        yield from _pose_figures(solution)
    # Where no target is seen, one finding says so.
    unseen = result.unseen if result.names else tuple(result.misprints)
    remarks = tuple(
        f"{Severity.WARNING}: not_seen: target {name} is in no shot{'; ' if name in result.misprints else ''}"
        f"{result.misprints.get(name, '')}"
        for name in unseen
    )
    yield page.Findings(assessment.findings, _NOTHING, remarks)
    yield from _targets(result, residuals)
    if result.frame is not None:
        yield from _frame(result.frame, solution)
    if solution is None:
        return
    yield from _pose(solution, assessment.left_out)
    yield from _uncertainty(assessment, solution)
    yield from _left_out(assessment.left_out)
    yield page.JsonValues({"residuals": [_residual_values(part) for part in residuals]})


def _pose_figures(solution: MountingFit) -> Iterator[page.Section]:
    translation, angles = angles_from_transform(solution.poses.camera)
    sigma = np.concatenate([1000 * solution.sigma[:3], np.degrees(solution.sigma[3:])])
    places = zip(NAMES[:3], translation, sigma[:3], strict=True)
    turns = zip(NAMES[3:], angles, sigma[3:], strict=True)
    yield page.KeyFigures(
        (
            *((f"{1000 * value:.1f} mm", f"{name} {PLUS_MINUS} {s:.2f} mm") for name, value, s in places),
            *((f"{value:.3f}{DEGREE}", f"{name} {PLUS_MINUS} {s:.3f}{DEGREE}") for name, value, s in turns),
        )
    )
    yield page.Paragraph(
        f"After {PLUS_MINUS} stands one standard deviation, along and about the forklift's axes, from the scatter of"
        " the corners and the stated accuracy of the survey."
    )


def _targets(result: MountingResult, residuals: Sequence[CornerResiduals]) -> Iterator[page.Section]:
    yield page.JsonValues({"targets": [_target_values(seen) for seen in result.observations]})
    yield page.JsonValues({"not_seen": list(result.unseen)})
    yield page.Heading("Targets")
    names = ("markers", "corners", "left out", f"rms {DEGREE}", "rms px", "mm at 2 m", "max px")
    found = {(part.target, part.shot): part for part in residuals}
    parts = [(seen, found.get((seen.target, seen.shot))) for seen in result.observations]
    yield page.Table(
        (*page.words("target", "shot"), *page.numbers(*names)), tuple(_page_row(*pair) for pair in parts)
    )
    if parts:
        columns = (*page.words("target"), *page.numbers("markers", "corners", "rms px", f"rms {DEGREE}"))
        yield page.Table(columns, tuple(_terminal_row(*pair) for pair in parts), page.Output.TERMINAL)
    if result.unseen:
        yield page.Paragraph(f"Not seen in any shot: {', '.join(result.unseen)}.")
    if residuals:
        yield page.Drawing(partial(sphere_figure, residuals), "Where the targets are seen, and how they are off.")
        yield page.Drawing(partial(polar_figure, residuals), "The same over the angle off the optical axis.")


def _target_values(seen: TargetObservation) -> dict[str, Any]:
    return {
        "target": seen.target,
        "shot": seen.shot,
        "markers": seen.markers,
        "corners": len(seen.corners.points),
        "legacy_pattern": seen.pattern.legacy,
    }


def _page_row(seen: TargetObservation, part: CornerResiduals | None) -> tuple[str, ...]:
    markers = f"{seen.markers} of {len(seen.pattern.marker_ids)}"
    cells = (seen.target, seen.shot, markers, f"{len(seen.corners.points)} of {len(seen.pattern.corners)}")
    if part is None:
        return (*cells, "", "", "", "", "")
    largest = (part.angle / part.pixel_angle)[part.used].max(initial=0.0)
    rms = (f"{np.degrees(part.rms):.4f}", f"{part.rms_px:.3f}", f"{at_reference(part.rms):.2f}")
    return (*cells, str(int((~part.used).sum())), *rms, f"{largest:.3f}")


def _terminal_row(seen: TargetObservation, part: CornerResiduals | None) -> tuple[str, ...]:
    markers = f"{seen.markers}/{len(seen.pattern.marker_ids)}"
    corners = f"{len(seen.corners.points)}/{len(seen.pattern.corners)}"
    rms = ("", "") if part is None else (f"{part.rms_px:.3f}", f"{np.degrees(part.rms):.4f}")
    return (seen.target + (" (legacy pattern)" if seen.pattern.legacy else ""), markers, corners, *rms)


def _residual_values(part: CornerResiduals) -> dict[str, Any]:
    return {
        "target": part.target,
        "shot": part.shot,
        "rms_deg": float(np.degrees(part.rms)),
        "rms_px": part.rms_px,
        "rms_mm_at_2_m": at_reference(part.rms),
        "pixels": part.pixels.round(4).tolist(),
        "residual_deg": np.degrees(part.angle).round(6).tolist(),
        "residual_px": (part.angle / part.pixel_angle).round(4).tolist(),
        "used": part.used.tolist(),
    }


def _frame(frame: ForkliftFrame, solution: MountingFit | None) -> Iterator[page.Section]:
    residuals = dict(frame.residuals or {})
    yield page.JsonValues({"forklift_frame": {"method": frame.method, "residual_m": residuals}})
    if not residuals:
        return
    yield page.Heading("The forklift in the survey")
    rows = tuple((name, f"{1000 * off:.2f}") for name, off in residuals.items())
    yield page.Table((*page.words("point"), *page.numbers("off mm")), rows)
    if solution is not None:
        sigma = np.sqrt(np.diag(solution.frame_covariance))
        yield page.Paragraph(
            f"Found by {frame.method}. Its errors are in the result's: {1000 * sigma[:3].max():.2f} mm and"
            f" {np.degrees(sigma[3:].max()):.4f}{DEGREE} at the camera."
        )


def _pose(solution: MountingFit, left_out: Sequence[LeftOut]) -> Iterator[page.Section]:
    translation, angles = angles_from_transform(solution.poses.camera)
    yield page.JsonValues(
        {
            "forklift_from_camera": {
                "translation_m": list(translation),
                "roll_pitch_yaw_deg": list(angles),
                "translation_sigma_m": solution.sigma[:3].tolist(),
                "rotation_sigma_deg": np.degrees(solution.sigma[3:]).tolist(),
                "covariance": solution.covariance.tolist(),
                "covariance_order": list(NAMES),
            },
            "frame_covariance": solution.frame_covariance.tolist(),
        }
    )
    most = np.abs([left.shift_in_sigma for left in left_out]).max(0) if left_out else np.zeros(6)
    values = (*(f"{place:.4f} m" for place in translation), *(f"{angle:.3f} {DEGREE}" for angle in angles))
    sigmas = (
        *(f"{1000 * sigma:.2f} mm" for sigma in solution.sigma[:3]),
        *(f"{np.degrees(sigma):.4f} {DEGREE}" for sigma in solution.sigma[3:]),
    )
    rows = tuple(zip(NAMES, values, sigmas, (f"{shift:.1f} sigma" for shift in most), strict=True))
    yield page.Table(
        page.numbers("", "forklift_from_camera", "sigma", "most without one target"), rows, page.Output.TERMINAL
    )


def _uncertainty(assessment: MountingAssessment, solution: MountingFit) -> Iterator[page.Section]:
    of_limit, direction = weakest(solution.covariance)
    value, sigma = assessment.scale
    yield page.JsonValues(
        {
            "weakest_direction": {"words": direction, "of_limit": of_limit},
            "sight_factor": solution.bearing_factor,
            "survey_factor": solution.survey_factor,
            "survey_scale_error": {"value": value, "sigma": page.finite(sigma)},
        }
    )
    yield page.Heading("How sure it is")
    yield page.Paragraph(
        f"The weakest direction is {direction}. Corners scatter {solution.bearing_factor:.2f} times as much as the"
        f" image noise says, the survey {solution.survey_factor:.2f} times as much as sigma_m says."
    )
    yield page.Paragraph(
        f"Scale of the survey against the printed size: {100 * value:+.3f} {PLUS_MINUS} {100 * sigma:.3f} %."
    )
    if assessment.centres is not None:
        centres = assessment.centres
        yield page.JsonValues({"lens_distance_m": {"value": centres.distance, "sigma": page.finite(centres.sigma)}})
        size = f"{1000 * centres.distance:.2f} {PLUS_MINUS} {1000 * centres.sigma:.2f} mm"
        yield page.Paragraph(
            "Distance of two lens centres along the camera's x axis, if there were two:"
            f" {size if np.isfinite(centres.sigma) else 'not told'}."
            f" {100 * centres.front_share:.0f} % of the corners are before the camera."
        )
    yield page.Drawing(partial(_correlation_figure, solution), "Correlations.")


def _left_out(left_out: Sequence[LeftOut]) -> Iterator[page.Section]:
    yield page.JsonValues({"left_out": [_left_out_values(left) for left in left_out]})
    if not left_out:
        return
    yield page.Heading("Each target left out")
    yield page.Paragraph(
        "The fit without a target says where it should be. Distance is between its surveyed corners and that place;"
        " chance is how probable such a distance or a larger one is if all sigmas are right."
    )
    shifts = (f"{name} {'mm' if i < 3 else DEGREE}" for i, name in enumerate(NAMES))
    columns = (*page.words("target"), *page.numbers("distance mm", "chance", *shifts, "most sigmas"))
    yield page.Table(columns, tuple(_left_out_row(left) for left in left_out))
    yield page.Drawing(partial(_left_out_figure, left_out), "Shifts of the pose without each target.")


def _left_out_values(left: LeftOut) -> dict[str, Any]:
    return {
        "target": left.target,
        "shift": left.shift.tolist(),
        "shift_in_sigma": left.shift_in_sigma.tolist(),
        "distance_m": left.distance,
        "probability": left.probability,
    }


def _left_out_row(left: LeftOut) -> tuple[str, ...]:
    shift = (*(f"{1000 * v:+.2f}" for v in left.shift[:3]), *(f"{np.degrees(v):+.4f}" for v in left.shift[3:]))
    most = f"{np.abs(left.shift_in_sigma).max():.2f}"
    return (left.target, f"{1000 * left.distance:.2f}", f"{left.probability:.3f}", *shift, most)


def _correlation_figure(solution: MountingFit) -> Figure:
    """Draw the correlations of the six numbers."""
    line = "Near 1 or -1 two of them cannot be told apart with these targets"
    figure = titled_figure(470, "Correlations of the six numbers", line)
    draw_correlations(wide_axes(figure, 350), solution.correlation, NAMES, 9.5)
    return figure


def _left_out_figure(left_out: Sequence[LeftOut]) -> Figure:
    """Draw how the pose moves without each target, in standard deviations."""
    line = "How far the pose moves, in standard deviations of the full result; beyond 2 is worth a look"
    figure = titled_figure(420, "Without one target", line)
    axes = wide_axes(figure, 260)
    axes.axhspan(-2, 2, color="#eef3f8", zorder=0)
    axes.axhline(0.0, color=INK, linewidth=0.8)
    places = np.arange(len(left_out))
    for i, name in enumerate(NAMES):
        values = [left.shift_in_sigma[i] for left in left_out]
        axes.bar(places + (i - 2.5) * 0.12, values, 0.11, color=SERIES[i], label=name)
    axes.set_xticks(places, [left.target for left in left_out])
    axes.set_ylabel("shift (sigma)")
    limit = max(2.4, *(1.1 * float(np.abs(left.shift_in_sigma).max()) for left in left_out))
    axes.set_ylim(-limit, limit)
    add_legend(figure, 372, axes, columns=6)
    return figure
