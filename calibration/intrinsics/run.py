"""The command ``palletloc calibrate intrinsics`` from folder to files."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
from rich import box
from rich.console import RenderableType
from rich.table import Table
from scipy.spatial.transform import RigidTransform

from calibration.findings import PASS, Finding, Severity, exit_code
from calibration.intrinsics.assessment import check_fit, view_findings
from calibration.intrinsics.board_views import Collected, collect, measure_again
from calibration.intrinsics.report import LensReport, report_data, report_page
from calibration.intrinsics.result import fitted_camera, measuring_lenses
from calibration.intrinsics.stitched_run import MODEL, calibrate_stitched
from calibration.intrinsics.task import IntrinsicsTask, read_intrinsics
from calibration.lenses.fit import LensFit, NoStartError, fit_lenses
from calibration.lenses.linking import UnlinkedError
from calibration.lenses.models import MODELS, LensModel, lens_model
from calibration.outcome import Outcome, free_stem
from palletloc.errors import PalletLocError, nearest_name
from palletloc.io.atomic import write_text

_MEASURED_AGAIN = 3  # corners lean on the lens that they are measured through, ever less
_TILT = "tilt the board by 30 degrees and more in several directions, and bring it to the rim of the image"


def calibrate_intrinsics(
    folder: Path, model: str, out: Path, on_progress: Callable[[str], None] = lambda _: None
) -> Outcome:
    """Calibrate one lens or two from a folder and write the results.

    Parameters
    ----------
    folder : Path
        With intrinsics.yaml and its shots or corners.
    model : str
        Name of the lens model.
    out : Path
        The file for the camera; the reports get its name with other endings.
    on_progress : callable
        Is told what is done next.

    Returns
    -------
    Outcome
        A run that fails writes no camera, and its reports under names that do not exist yet.

    Raises
    ------
    PalletLocError
        If the model is unknown, a file is missing or wrong, or a file cannot be written.
    """
    if model == MODEL:
        return calibrate_stitched(folder, out, on_progress)
    if model not in MODELS:
        raise PalletLocError(f"--model {model}: unknown lens model{nearest_name(model, [*MODELS, MODEL])}")
    lens = lens_model(model)
    task = read_intrinsics(folder)
    if task.lenses == 2 and lens.name != "kannala_brandt":
        raise PalletLocError(f"--model {model}: a camera with two lenses needs the model kannala_brandt")
    found = collect(task, on_progress)
    report = _calibrate(task, lens, found, on_progress)
    on_progress("writing the report")
    files = _write(out, report)
    reasons = tuple(f"{f.severity}: {f.code}: {f.what}; {f.how}" for f in report.findings)
    return Outcome(exit_code(report.findings), tuple(_summary(report)), files, reasons)


def _calibrate(
    task: IntrinsicsTask, lens: LensModel, found: Collected, on_progress: Callable[[str], None]
) -> LensReport:
    findings = view_findings(task, found)
    if exit_code(findings) != PASS:
        return LensReport(lens.name, tuple(findings), found)
    on_progress("fitting")
    fit = _fitted(task, lens, found)
    if isinstance(fit, Finding):
        return LensReport(lens.name, (*findings, fit), found)
    for _ in range(_MEASURED_AGAIN if found.patterns else 0):
        lenses = measuring_lenses(fit, task.size)
        if lenses is None:
            break
        found.views = measure_again(task, found, lenses, _poses(fit), on_progress)
        on_progress("fitting")
        again = _fitted(task, lens, found)
        if isinstance(again, Finding):
            return LensReport(lens.name, (*findings, again), found)
        fit = again
    camera = fitted_camera(fit, task.size, task.max_angle)
    if isinstance(camera, Finding):
        return LensReport(lens.name, (*findings, camera), found, fit)
    checked = check_fit(fit, camera.lenses, [aperture.width for aperture in task.apertures])
    return LensReport(lens.name, (*findings, *checked.findings), found, fit, camera, checked)


def _poses(fit: LensFit) -> dict[str, RigidTransform]:
    return {view.name: fit.rig.lens_from_board(view) for view in fit.problem.views}


def _fitted(task: IntrinsicsTask, lens: LensModel, found: Collected) -> LensFit | Finding:
    boards = max(view.board for view in found.views) + 1 if task.boards_stand_still else 1
    try:
        return fit_lenses(found.views, [lens] * task.lenses, task.apertures, boards)
    except NoStartError as error:
        return Finding(Severity.DEGENERATE, "no_start", str(error), "check the boards' sizes and the shots")
    except UnlinkedError as error:
        how = "show the board in the ring that both lenses see, or let several boards stand still and say so"
        return Finding(Severity.DEGENERATE, "lenses_not_linked", str(error), how)
    except np.linalg.LinAlgError as error:
        return Finding(Severity.DEGENERATE, "unobservable", f"the boards leave the lens open: {error}", _TILT)


def _write(out: Path, report: LensReport) -> tuple[Path, ...]:
    passed = exit_code(report.findings) == PASS and report.camera is not None
    text = json.dumps(report_data(report), indent=1, allow_nan=False) + "\n"
    stem = out.with_suffix("") if passed else free_stem(out)
    html, numbers = stem.with_name(stem.name + ".html"), stem.with_name(stem.name + ".json")
    write_text(html, report_page(report))
    write_text(numbers, text)
    if not passed or report.camera is None:
        return html, numbers
    write_text(out, report.camera.text())
    return out, html, numbers


def _summary(report: LensReport) -> list[RenderableType]:
    fit = report.fit
    if fit is None:
        return []
    table = Table(box=box.SIMPLE_HEAD)
    for name in ("", "value", "sigma"):
        table.add_column(name, justify="right")
    values = np.concatenate(fit.rig.values)
    for name, value, sigma in zip(fit.problem.names(), values, fit.sigma, strict=False):
        table.add_row(name, f"{value:.6g}", f"{sigma:.2g}")
    corners = sum(int(used.sum()) for used in fit.used)
    line = (
        f"{len(fit.problem.views)} views, {corners} corners: {fit.rms():.3f} px rms;"
        f" with every corner {fit.plain_rms:.3f} px"
    )
    return [table, line]
