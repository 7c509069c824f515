"""What there is to say of fitted lenses: their parameters, how well the field is known, and each view."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import Any

import numpy as np

from calibration import result_page as page
from calibration.findings import Finding
from calibration.formats.camera_file import camera_text
from calibration.intrinsics.assessment import Checked
from calibration.intrinsics.figures import (
    correlation_figure,
    coverage_figure,
    halves_figure,
    radial_figure,
    residual_figure,
    uncertainty_figure,
)
from calibration.intrinsics.fit import STITCHED, LensCalibration, StitchedCalibration
from calibration.intrinsics.result import FittedCamera
from calibration.intrinsics.stitched import StitchedFit
from calibration.lenses.fit import LensFit
from palletloc.drawing.canvas import DEGREE, PLUS_MINUS
from palletloc.geometry import FloatArray
from palletloc.io.camera_spec import angles_from_transform, spec_from_camera

_COMMAND = "palletloc calibrate intrinsics"
"""Title of the pages."""
_VERDICTS = {0: "The calibration holds.", 1: "The calibration fails.", 3: "The data cannot give a calibration."}
"""Of a calibration of lenses, by exit code."""
_STITCHED_VERDICTS = {0: "The correction holds.", 1: "The correction fails.", 3: "The data cannot give a correction."}
"""Of a correction of stitched shots, by exit code."""
_NOTHING = "Nothing is left to do: paste the camera into recording.yaml or extrinsics.yaml."
"""Where there is no finding."""
_BETWEEN = ("turn about x", "turn about y", "turn about z", "x", "y", "z")
"""Of the six numbers of the back lens's place."""


def lenses_page(result: LensCalibration | StitchedCalibration) -> page.ResultPage:
    """Return a calibration of lenses, from `calibrate_lenses`, as all outputs show it."""
    content = None if result.camera is None else camera_text(result.camera)
    if isinstance(result, StitchedCalibration):
        heading, sections = "The lenses behind a stitched image", tuple(_stitched_sections(result))
        return page.ResultPage(_COMMAND, heading, _STITCHED_VERDICTS, sections, content, "The correction can be used")
    heading = f"The lens by the model {result.model}"
    return page.ResultPage(
        _COMMAND, heading, _VERDICTS, tuple(_sections(result)), content, "The calibration can be used"
    )


def _sections(result: LensCalibration) -> Iterator[page.Section]:
    yield page.JsonValues({"model": result.model})
    fit, checked = result.fit, result.checked
    if fit is not None:
        yield _key_figures(fit, checked)
    yield page.Findings(result.findings, _NOTHING)
    found = result.found
    yield page.JsonValues(
        {"duplicates": [list(pair) for pair in found.duplicates], "without_board": list(found.empty)}
    )
    if fit is None:
        return
    yield from _parameters(fit, result.fitted)
    yield page.JsonValues({"views": [_view_values(fit, i) for i in range(len(fit.problem.views))]})
    if result.fitted is not None:
        yield page.JsonValues({"camera": spec_from_camera(result.fitted.camera).model_dump(mode="json")})
    if checked is not None:
        yield from _field(fit, checked)
    yield from _views(fit)


def _key_figures(fit: LensFit, checked: Checked | None) -> page.KeyFigures:
    figures = [
        (f"{fit.rms():.3f} px", "rms of the corners used"),
        (f"{fit.plain_rms:.3f} px", "rms of a plain fit to every corner"),
        (str(len(fit.problem.views)), "views"),
        (str(_used_corners(fit)), "corners used"),
    ]
    if checked is not None:
        worst = max(float(sigma.max()) for sigma in checked.bearing_sigma)
        figures.append((f"{np.degrees(worst):.3f}{DEGREE}", "sigma of bearings, at worst"))
        if np.isfinite(checked.hold_out):
            figures.append((f"{checked.hold_out:.3f} px", "rms of views left out"))
    return page.KeyFigures(tuple(figures))


def _used_corners(fit: LensFit) -> int:
    return sum(int(used.sum()) for used in fit.used)


def _parameters(fit: LensFit, camera: FittedCamera | None) -> Iterator[page.Section]:
    values = np.concatenate(fit.rig.values)
    known = list(zip(fit.problem.names(), values, fit.sigma, strict=False))
    alone = _stand_alone(fit)
    yield page.JsonValues(
        {
            "rms_px": fit.rms(),
            "plain_rms_px": fit.plain_rms,
            "sigma_factor": fit.sigma_factor,
            "parameters": [{"name": name, "value": float(value), "sigma": float(s)} for name, value, s in known],
            "parameters_alone": alone,
            "covariance_order": list(fit.problem.names()),
            "covariance": fit.covariance.tolist(),
        }
    )
    yield page.Heading("Parameters")
    columns = (*page.words(""), *page.numbers("value", "sigma"))
    yield page.Table(columns, tuple((name, f"{value:.7g}", f"{sigma:.2g}") for name, value, sigma in known))
    short = tuple((name, f"{value:.6g}", f"{sigma:.2g}") for name, value, sigma in known)
    yield page.Table(page.numbers("", "value", "sigma"), short, page.Output.TERMINAL)
    line = (
        f"{len(fit.problem.views)} views, {_used_corners(fit)} corners: {fit.rms():.3f} px rms;"
        f" with every corner {fit.plain_rms:.3f} px"
    )
    yield page.Paragraph(line, page.Output.TERMINAL)
    if not alone:
        yield page.Paragraph(
            "The focal length and xi of this model make up for each other along a curve. Do not believe one of these"
            " numbers, or its standard deviation, alone, nor compare it with another calibration's: bearings are what"
            " the fit knows, and their standard deviations below hold."
        )
    if camera is not None and len(camera.lenses) > 1:
        yield from _places(fit, camera)
    yield page.Drawing(partial(correlation_figure, fit), "Correlations.")


def _stand_alone(fit: LensFit) -> bool:
    """Tell whether the parameters mean something one by one: not where xi and the focal length replace each other."""
    return all(model.name != "mei" for model in fit.problem.models)


def _places(fit: LensFit, camera: FittedCamera) -> Iterator[page.Section]:
    for lens, pose in enumerate(camera.camera_from_lens):
        (x, y, z), angles = angles_from_transform(pose)
        turn = ", ".join(f"{angle:.3f}" for angle in angles)
        yield page.Paragraph(
            f"Lens {lens} in the camera frame: {1000 * x:.2f}, {1000 * y:.2f}, {1000 * z:.2f} mm;"
            f" roll, pitch, yaw {turn} degrees."
        )
    _, poses, _ = fit.problem.columns()
    sigma = fit.sigma[poses[1]]
    yield page.Paragraph(
        f"Between the lenses: {PLUS_MINUS} {1000 * float(sigma[3:].max()):.2f} mm and"
        f" {PLUS_MINUS} {np.degrees(float(sigma[:3].max())):.3f} degrees at worst."
    )


def _view_values(fit: LensFit, i: int) -> dict[str, Any]:
    view, used, residual = fit.problem.views[i], fit.used[i], fit.residuals[i]
    return {
        "name": view.name,
        "lens": view.lens,
        "rms_px": _rms(residual),
        "pixels": view.pixels.round(3).tolist(),
        "residual_px": residual.round(4).tolist(),
        "used": used.tolist(),
    }


def _field(fit: LensFit, checked: Checked) -> Iterator[page.Section]:
    yield page.JsonValues(
        {
            "hold_out_rms_px": page.finite(checked.hold_out),
            "neighbour_correlation": page.finite(checked.neighbours),
            "lenses": [
                {
                    "max_angle_deg": float(np.degrees(cover.max_angle)),
                    "reach": cover.reach,
                    "coverage": cover.filled.tolist(),
                    "angle_deg": np.degrees(angle).tolist(),
                    "bearing_sigma_deg": np.degrees(sigma).tolist(),
                }
                for cover, angle, sigma in zip(checked.coverage, checked.angles, checked.bearing_sigma, strict=True)
            ],
        }
    )
    yield page.Heading("How well the field is known")
    coverage = partial(coverage_figure, checked.coverage)
    yield page.Drawing(coverage, "Where the corners are in the field of each lens.")
    yield page.Drawing(partial(uncertainty_figure, checked), "Standard deviation of bearings.")
    yield page.Drawing(partial(residual_figure, fit), "Residuals in the image.")
    yield page.Drawing(partial(radial_figure, fit, checked), "Residuals over the angle off axis.")
    if np.isfinite(checked.neighbours):
        yield page.Paragraph(
            f"Residuals of neighbouring corners correlate by {checked.neighbours:.2f}; with a model that describes"
            " the lens, and flat boards, they do not."
        )


def _views(fit: LensFit) -> Iterator[page.Section]:
    yield page.Heading("Views")
    rows = []
    for view, used, residual in zip(fit.problem.views, fit.used, fit.residuals, strict=True):
        size = np.linalg.norm(residual, axis=-1)
        rms = np.sqrt((size**2).mean())
        rows.append((view.name, str(len(used)), str(int((~used).sum())), f"{rms:.3f}", f"{size.max():.3f}"))
    yield page.Table((*page.words("view"), *page.numbers("corners", "left out", "rms px", "max px")), tuple(rows))


def _stitched_sections(result: StitchedCalibration) -> Iterator[page.Section]:
    yield page.JsonValues({"model": STITCHED})
    fit = result.fit
    if fit is None:
        yield page.Findings(result.findings, _NOTHING)
        return
    yield from _correction(fit, result.findings)
    views = zip(fit.after.problem.views, fit.before.residuals, fit.after.residuals, fit.after.used, strict=True)
    yield page.JsonValues(
        {
            "covariance_order": list(fit.after.problem.names()),
            "covariance": fit.after.covariance.tolist(),
            "camera": spec_from_camera(fit.camera).model_dump(mode="json"),
            "views": [
                {"name": view.name, "rms_px": {"before": _rms(before), "after": _rms(after)}, "used": used.tolist()}
                for view, before, after, used in views
            ],
        }
    )
    for part, name in ((fit.before, "before"), (fit.after, "after")):
        yield page.Drawing(partial(halves_figure, part, name), f"Residuals {name} the correction.", keep_wide=False)


def _rms(residuals: FloatArray) -> float:
    return float(np.sqrt((residuals**2).sum(-1).mean()))


def _correction(fit: StitchedFit, findings: tuple[Finding, ...]) -> Iterator[page.Section]:
    (values, sigma), (bends, bend_sigma) = fit.between, fit.bends
    apart, turned = 1000 * float(np.linalg.norm(values[3:])), np.degrees(float(np.linalg.norm(values[:3])))
    known, sure = 1000 * float(sigma[3:].max()), np.degrees(float(sigma[:3].max()))
    before, after = fit.before.rms(), fit.after.rms()
    yield page.Findings(findings, _NOTHING)
    yield page.KeyFigures(
        (
            (f"{before:.3f} px", "rms before"),
            (f"{after:.3f} px", "rms after"),
            (f"{apart:.1f} mm", "between the lenses' centres"),
            (f"{turned:.3f}{DEGREE}", "turn of the back lens"),
        )
    )
    yield page.Paragraph(f"{before:.3f} px rms before, {after:.3f} px after", page.Output.TERMINAL)
    line = f"lenses {apart:.1f} mm apart (sigma {known:.1f} mm), turned by {turned:.3f} degrees (sigma {sure:.3f})"
    yield page.Paragraph(line, page.Output.TERMINAL)
    yield page.JsonValues(
        {
            "rms_px": {"before": before, "after": after},
            "plain_rms_px": {"before": fit.before.plain_rms, "after": fit.after.plain_rms},
            "back_lens_off": {"order": list(_BETWEEN), "value": values.tolist(), "sigma": sigma.tolist()},
            "bends": {"value": bends.tolist(), "sigma": bend_sigma.tolist()},
        }
    )
    rows = [
        (name, *(f"{np.degrees(x):.4f} {DEGREE}" if i < 3 else f"{1000 * x:.2f} mm" for x in pair))
        for i, (name, *pair) in enumerate(zip(_BETWEEN, values, sigma, strict=True))
    ]
    rows += [
        (f"{lens} lens, {name}", f"{bends[i, j]:.5f}", f"{bend_sigma[i, j]:.5f}")
        for i, lens in enumerate(("front", "back"))
        for j, name in enumerate(("k1", "k2"))
    ]
    yield page.Heading("The correction")
    yield page.Paragraph("Back lens against its nominal place in the front lens's frame, and how each lens bends.")
    yield page.Table((*page.words(""), *page.numbers("value", "sigma")), tuple(rows))
