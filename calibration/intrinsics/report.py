"""The report of a lens calibration: one page of HTML that needs nothing but itself, and the same as JSON."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from calibration.findings import Finding, Severity, exit_code
from calibration.intrinsics.assessment import Checked
from calibration.intrinsics.board_views import Collected
from calibration.intrinsics.figures import (
    coverage_figure,
    matrix_figure,
    radial_figure,
    residual_figure,
    uncertainty_figure,
)
from calibration.intrinsics.result import FittedCamera
from calibration.lenses.fit import LensFit
from palletloc.drawing.canvas import small_png
from palletloc.io.camera_spec import angles_from_transform, spec_from_camera
from palletloc.report.page import Column, embedded, heading, key_figures, page, paragraph, picture, table

_PM = "\N{PLUS-MINUS SIGN}"
_VERDICT = {0: "The calibration holds.", 1: "The calibration fails.", 3: "The data cannot give a calibration."}


@dataclass(frozen=True, slots=True, eq=False)
class LensReport:
    """What there is to tell."""

    model: str
    """Name of the lens model."""
    findings: tuple[Finding, ...]
    """In the order in which they were made."""
    found: Collected
    """What the shots show."""
    fit: LensFit | None = None
    """The fit, where there is one."""
    camera: FittedCamera | None = None
    """What it gives."""
    checked: Checked | None = None
    """What was found about it."""


def report_data(report: LensReport) -> dict[str, Any]:
    """Return the report as plain values for JSON."""
    data: dict[str, Any] = {
        "format": 1,
        "exit_code": exit_code(report.findings),
        "model": report.model,
        "reasons": [
            {"severity": str(f.severity), "code": f.code, "what": f.what, "how": f.how} for f in report.findings
        ],
        "duplicates": [list(pair) for pair in report.found.duplicates],
        "without_board": list(report.found.empty),
    }
    fit, checked = report.fit, report.checked
    if fit is None:
        return data
    data["rms_px"], data["plain_rms_px"], data["sigma_factor"] = fit.rms(), fit.plain_rms, fit.sigma_factor
    values = np.concatenate(fit.rig.values)
    names = fit.problem.names()
    data["parameters"] = [
        {"name": name, "value": float(value), "sigma": float(sigma)}
        for name, value, sigma in zip(names, values, fit.sigma, strict=False)
    ]
    data["parameters_alone"] = parameters_stand_alone(fit)
    data["covariance_order"], data["covariance"] = list(names), fit.covariance.tolist()
    data["views"] = [_view_data(fit, i) for i in range(len(fit.problem.views))]
    if report.camera is not None:
        data["camera"] = spec_from_camera(report.camera.camera).model_dump(mode="json")
    if checked is not None:
        data["hold_out_rms_px"] = _number(checked.hold_out)
        data["neighbour_correlation"] = _number(checked.neighbours)
        data["lenses"] = [
            {
                "max_angle_deg": float(np.degrees(cover.max_angle)),
                "reach": cover.reach,
                "coverage": cover.filled.tolist(),
                "angle_deg": np.degrees(angle).tolist(),
                "bearing_sigma_deg": np.degrees(sigma).tolist(),
            }
            for cover, angle, sigma in zip(checked.coverage, checked.angles, checked.bearing_sigma, strict=True)
        ]
    return data


def _number(value: float) -> float | None:
    return value if np.isfinite(value) else None


def _view_data(fit: LensFit, i: int) -> dict[str, Any]:
    view, used, residual = fit.problem.views[i], fit.used[i], fit.residuals[i]
    return {
        "name": view.name,
        "lens": view.lens,
        "rms_px": float(np.sqrt((residual**2).sum(-1).mean())),
        "pixels": view.pixels.round(3).tolist(),
        "residual_px": residual.round(4).tolist(),
        "used": used.tolist(),
    }


def parameters_stand_alone(fit: LensFit) -> bool:
    """Tell whether the parameters mean something one by one: not where xi and the focal length replace each other."""
    return all(model.name != "mei" for model in fit.problem.models)


def report_page(report: LensReport) -> str:
    """Return the report as a page of HTML."""
    return page("palletloc calibrate intrinsics", _parts(report))


def _parts(report: LensReport) -> Iterator[str]:
    yield heading(f"The lens by the model {report.model}", level=1)
    yield paragraph(_VERDICT[exit_code(report.findings)], "lead")
    fit, checked = report.fit, report.checked
    if fit is not None:
        yield from _result(fit, checked)
    yield from _findings(report)
    if fit is None:
        return
    yield from _parameters(fit, report.camera)
    if checked is not None:
        yield from _quality(fit, checked)
    yield from _views(fit)


def _result(fit: LensFit, checked: Checked | None) -> Iterator[str]:
    corners = sum(int(used.sum()) for used in fit.used)
    figures = [
        (f"{fit.rms():.3f} px", "rms of the corners used"),
        (f"{fit.plain_rms:.3f} px", "rms of a plain fit to every corner"),
        (str(len(fit.problem.views)), "views"),
        (str(corners), "corners used"),
    ]
    if checked is not None:
        worst = max(float(sigma.max()) for sigma in checked.bearing_sigma)
        figures.append((f"{np.degrees(worst):.3f}\N{DEGREE SIGN}", "sigma of bearings, at worst"))
        if np.isfinite(checked.hold_out):
            figures.append((f"{checked.hold_out:.3f} px", "rms of views left out"))
    yield key_figures(figures)


def _findings(report: LensReport) -> Iterator[str]:
    yield heading("What to do next")
    if not report.findings:
        yield paragraph("Nothing is left to do: paste the camera into recording.yaml or extrinsics.yaml.")
        return
    order = list(Severity)
    columns = (Column("", is_text=True), Column("code", is_text=True), Column("what, and what to do", is_text=True))
    ordered = sorted(report.findings, key=lambda finding: order.index(finding.severity))
    yield table(
        columns, [row for f in ordered for row in ([str(f.severity), f.code, f.what], ["", "", f"do: {f.how}"])]
    )


def _parameters(fit: LensFit, camera: FittedCamera | None) -> Iterator[str]:
    yield heading("Parameters")
    values = np.concatenate(fit.rig.values)
    rows = [
        [name, f"{value:.7g}", f"{sigma:.2g}"]
        for name, value, sigma in zip(fit.problem.names(), values, fit.sigma, strict=False)
    ]
    yield table((Column("", is_text=True), Column("value"), Column("sigma")), rows)
    if not parameters_stand_alone(fit):
        yield paragraph(
            "The focal length and xi of this model make up for each other along a curve. Do not believe one of these"
            " numbers, or its standard deviation, alone, nor compare it with another calibration's: bearings are what"
            " the fit knows, and their standard deviations below hold."
        )
    if camera is not None and len(camera.lenses) > 1:
        for lens, pose in enumerate(camera.camera_from_lens):
            (x, y, z), angles = angles_from_transform(pose)
            turn = ", ".join(f"{angle:.3f}" for angle in angles)
            yield paragraph(
                f"Lens {lens} in the camera frame: {1000 * x:.2f}, {1000 * y:.2f}, {1000 * z:.2f} mm;"
                f" roll, pitch, yaw {turn} degrees."
            )
        _, poses, _ = fit.problem.columns()
        sigma = fit.sigma[poses[1]]
        yield paragraph(
            f"Between the lenses: {_PM} {1000 * float(sigma[3:].max()):.2f} mm and"
            f" {_PM} {np.degrees(float(sigma[:3].max())):.3f} degrees at worst."
        )
    yield _shown(matrix_figure(fit), "Correlations.")


def _quality(fit: LensFit, checked: Checked) -> Iterator[str]:
    yield heading("How well the field is known")
    yield _shown(coverage_figure(checked.coverage), "Where the corners are in the field of each lens.")
    yield _shown(uncertainty_figure(checked), "Standard deviation of bearings.")
    yield _shown(residual_figure(fit), "Residuals in the image.")
    yield _shown(radial_figure(fit, checked), "Residuals over the angle off axis.")
    if np.isfinite(checked.neighbours):
        yield paragraph(
            f"Residuals of neighbouring corners correlate by {checked.neighbours:.2f}; with a model that describes"
            " the lens, and flat boards, they do not."
        )


def _views(fit: LensFit) -> Iterator[str]:
    yield heading("Views")
    rows = []
    for i, view in enumerate(fit.problem.views):
        size = np.linalg.norm(fit.residuals[i], axis=-1)
        rms = np.sqrt((size**2).mean())
        counts = [str(len(view.points)), str(int((~fit.used[i]).sum()))]
        rows.append([view.name, *counts, f"{rms:.3f}", f"{size.max():.3f}"])
    names = ("corners", "left out", "rms px", "max px")
    yield table((Column("view", is_text=True), *(Column(name) for name in names)), rows)


def _shown(figure: Figure, caption: str) -> str:
    return picture(embedded(small_png(figure)), caption, keep_wide=True)
