"""The report of a correction for a stitched image: what it is, and the residuals before and after."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from calibration.findings import Finding, exit_code
from calibration.intrinsics.stitched import StitchedFit
from calibration.lenses.fit import LensFit
from palletloc.drawing.canvas import FAINT, GRID, SERIES, WIDTH_PX, add_axes, add_text, new_figure, small_png
from palletloc.io.camera_spec import spec_from_camera
from palletloc.report.page import Column, embedded, heading, key_figures, page, paragraph, picture, table

_VERDICT = {0: "The correction holds.", 1: "The correction fails.", 3: "The data cannot give a correction."}
_DEGREE = "\N{DEGREE SIGN}"
_SIDE, _TOP = 540, 84
_BETWEEN = ("turn about x", "turn about y", "turn about z", "x", "y", "z")


@dataclass(frozen=True, slots=True, eq=False)
class StitchedReport:
    """What there is to tell."""

    findings: tuple[Finding, ...]
    """In the order in which they were made."""
    fit: StitchedFit | None = None
    """The correction, where there is one."""


def stitched_data(report: StitchedReport) -> dict[str, Any]:
    """Return the report as plain values for JSON: metres, radians where nothing else is said."""
    data: dict[str, Any] = {
        "format": 1,
        "exit_code": exit_code(report.findings),
        "model": "stitched_equirectangular",
        "reasons": [
            {"severity": str(f.severity), "code": f.code, "what": f.what, "how": f.how} for f in report.findings
        ],
    }
    fit = report.fit
    if fit is None:
        return data
    values, sigma = fit.between
    bends, bend_sigma = fit.bends
    return data | {
        "rms_px": {"before": fit.before.rms(), "after": fit.after.rms()},
        "plain_rms_px": {"before": fit.before.plain_rms, "after": fit.after.plain_rms},
        "back_lens_off": {"order": list(_BETWEEN), "value": values.tolist(), "sigma": sigma.tolist()},
        "bends": {"value": bends.tolist(), "sigma": bend_sigma.tolist()},
        "covariance_order": list(fit.after.problem.names()),
        "covariance": fit.after.covariance.tolist(),
        "camera": spec_from_camera(fit.camera).model_dump(mode="json"),
        "views": [
            {
                "name": view.name,
                "rms_px": {"before": _rms(before), "after": _rms(after)},
                "used": used.tolist(),
            }
            for view, before, after, used in zip(
                fit.after.problem.views, fit.before.residuals, fit.after.residuals, fit.after.used, strict=True
            )
        ],
    }


def _rms(residuals: np.ndarray[Any, np.dtype[np.float64]]) -> float:
    return float(np.sqrt((residuals**2).sum(-1).mean()))


def stitched_page(report: StitchedReport) -> str:
    """Return the report as a page of HTML."""
    return page("palletloc calibrate intrinsics", _parts(report))


def _parts(report: StitchedReport) -> Iterator[str]:
    yield heading("The lenses behind a stitched image", level=1)
    yield paragraph(_VERDICT[exit_code(report.findings)], "lead")
    yield heading("What to do next")
    columns = (Column("", is_text=True), Column("code", is_text=True), Column("what, and what to do", is_text=True))
    rows = [([str(f.severity), f.code, f.what], ["", "", f"do: {f.how}"]) for f in report.findings]
    if rows:
        yield table(columns, [row for pair in rows for row in pair])
    else:
        yield paragraph("Nothing is left to do: paste the camera into recording.yaml or extrinsics.yaml.")
    if report.fit is not None:
        yield from _result(report.fit)


def _result(fit: StitchedFit) -> Iterator[str]:
    values, sigma = fit.between
    yield key_figures(
        [
            (f"{fit.before.rms():.3f} px", "rms before"),
            (f"{fit.after.rms():.3f} px", "rms after"),
            (f"{1000 * float(np.linalg.norm(values[3:])):.1f} mm", "between the lenses' centres"),
            (f"{np.degrees(float(np.linalg.norm(values[:3]))):.3f}{_DEGREE}", "turn of the back lens"),
        ]
    )
    rows = [
        [name, *(f"{np.degrees(x):.4f} {_DEGREE}" if i < 3 else f"{1000 * x:.2f} mm" for x in pair)]
        for i, (name, *pair) in enumerate(zip(_BETWEEN, values, sigma, strict=True))
    ]
    bends, bend_sigma = fit.bends
    rows += [
        [f"{lens} lens, {name}", f"{bends[i, j]:.5f}", f"{bend_sigma[i, j]:.5f}"]
        for i, lens in enumerate(("front", "back"))
        for j, name in enumerate(("k1", "k2"))
    ]
    yield heading("The correction")
    yield paragraph("Back lens against its nominal place in the front lens's frame, and how each lens bends.")
    yield table((Column("", is_text=True), Column("value"), Column("sigma")), rows)
    for lens_fit, name in ((fit.before, "before"), (fit.after, "after")):
        yield picture(embedded(small_png(_halves_figure(lens_fit, name))), f"Residuals {name} the correction.")


def _halves_figure(fit: LensFit, name: str) -> Figure:
    """Draw the residuals in both halves of the image, each around its lens's axis."""
    figure = new_figure(_SIDE + 150)
    used: Sequence[np.ndarray[Any, np.dtype[np.float64]]] = [
        part[keep] for part, keep in zip(fit.residuals, fit.used, strict=True)
    ]
    largest = max((float(np.linalg.norm(part, axis=-1).max()) for part in used if len(part)), default=1e-9)
    factor = 60.0 / max(largest, 1e-9)
    add_text(figure, 84, 14, f"Residuals {name}: {fit.rms():.3f} px", size=13, bold=True)
    line = f"Around each lens's axis, in pixels of the image; drawn {factor:.0f} times as long; crosses were left out"
    add_text(figure, 84, 40, line, size=10.5)
    limit = 1.08 * float(fit.rig.values[0][0]) * np.pi / 2
    for lens, title in enumerate(("front", "back")):
        axes = add_axes(figure, 84 + lens * (WIDTH_PX - 110) / 2, _TOP, _SIDE, _SIDE)
        axes.set(xlim=(-limit, limit), ylim=(limit, -limit), xlabel=f"{title} lens (px)")
        axes.grid(color=GRID, linewidth=0.6)
        for view, keep, part in zip(fit.problem.views, fit.used, fit.residuals, strict=True):
            if view.lens == lens:
                axes.quiver(
                    *view.pixels[keep].T, *(factor * part[keep].T), color=SERIES[lens], angles="xy",
                    scale_units="xy", scale=1, width=0.002, headwidth=4,
                )  # fmt: skip
                axes.plot(*view.pixels[~keep].T, "x", color=FAINT, markersize=5)
    return figure
