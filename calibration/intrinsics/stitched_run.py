"""The command ``palletloc calibrate intrinsics --model stitched_equirectangular`` from folder to files."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from rich.console import RenderableType

from calibration.findings import PASS, Finding, Severity, exit_code
from calibration.formats.camera_file import camera_text
from calibration.intrinsics.assessment import view_findings
from calibration.intrinsics.board_views import Collected, collect, measure_again
from calibration.intrinsics.stitched import StitchedFit, fit_stitched, whole_pose
from calibration.intrinsics.stitched_report import StitchedReport, stitched_data, stitched_page
from calibration.intrinsics.task import INTRINSICS, Chessboard, IntrinsicsTask, read_intrinsics
from calibration.lenses.fit import NoStartError
from calibration.lenses.linking import UnlinkedError
from calibration.outcome import Outcome, free_stem
from palletloc.cameras import Equirectangular
from palletloc.io.atomic import write_text
from palletloc.io.yaml_document import DocumentError

MODEL = "stitched_equirectangular"
"""Name of the model."""
_MAX_PLACE, _MAX_TURN = 0.005, float(np.radians(0.1))
_OPEN_PLACE, _OPEN_TURN = 0.1, float(np.radians(2.0))
_LEAST_GAIN = 0.97
_AROUND = (
    "let boards stand still on all sides, say boards_stand_still, and take shots from several places and headings"
)


def calibrate_stitched(folder: Path, out: Path, on_progress: Callable[[str], None] = lambda _: None) -> Outcome:
    """Find the lenses behind stitched shots, and write the results.

    Parameters
    ----------
    folder : Path
        With intrinsics.yaml and its shots or corners.
    out : Path
        The file for the camera; the reports get its name with other endings.
    on_progress : callable
        Is told what is done next.

    Raises
    ------
    PalletLocError
        If a file is missing or wrong, or cannot be written.
    """
    task = _task(folder)
    camera = Equirectangular(*task.size)
    found = collect(task, on_progress)
    report = _calibrate(task, camera, found, on_progress)
    files = _write(out, report)
    reasons = tuple(f"{f.severity}: {f.code}: {f.what}; {f.how}" for f in report.findings)
    return Outcome(exit_code(report.findings), tuple(_summary(report)), files, reasons)


def _task(folder: Path) -> IntrinsicsTask:
    task = read_intrinsics(folder)
    path = folder / INTRINSICS
    if task.lenses != 1:
        raise DocumentError(f"{path}: lenses: expected no such key with --model {MODEL}: the shots are stitched")
    plain = [name for name, board in task.boards.items() if isinstance(board, Chessboard)]
    if plain:
        raise DocumentError(f"{path}: boards.{plain[0]}: expected a ChArUco board in stitched shots")
    return replace(task, start=Equirectangular(*task.size))


def _calibrate(
    task: IntrinsicsTask, camera: Equirectangular, found: Collected, on_progress: Callable[[str], None]
) -> StitchedReport:
    findings = view_findings(task, found)
    if exit_code(findings) != PASS:
        return StitchedReport(tuple(findings))
    if found.patterns:
        poses = {view.name: pose for view in found.views if (pose := whole_pose(camera, view)) is not None}
        found.views = measure_again(task, found, [camera], poses, on_progress)
    on_progress("fitting")
    boards = max(view.board for view in found.views) + 1 if task.boards_stand_still else 1
    try:
        fit = fit_stitched(camera, found.views, boards)
    except NoStartError as error:
        fault = Finding(Severity.DEGENERATE, "no_start", str(error), "check the boards' sizes and the shots")
        return StitchedReport((*findings, fault))
    except UnlinkedError as error:
        return StitchedReport((*findings, Finding(Severity.DEGENERATE, "boards_not_linked", str(error), _AROUND)))
    except np.linalg.LinAlgError as error:
        what = f"the boards leave the lenses open: {error}"
        return StitchedReport((*findings, Finding(Severity.DEGENERATE, "unobservable", what, _AROUND)))
    except ValueError as error:
        return StitchedReport((*findings, Finding(Severity.FAIL, "not_invertible", str(error), _AROUND)))
    return StitchedReport((*findings, *_findings(fit)), fit)


def _findings(fit: StitchedFit) -> list[Finding]:
    _, sigma = fit.between
    turn, place = float(sigma[:3].max()), float(sigma[3:].max())
    what = f"the back lens's place is known to {1000 * place:.1f} mm and {np.degrees(turn):.2f} degrees only"
    if place > _OPEN_PLACE or turn > _OPEN_TURN:
        return [Finding(Severity.DEGENERATE, "unobservable", what, _AROUND)]
    findings = []
    if place > _MAX_PLACE or turn > _MAX_TURN:
        findings.append(Finding(Severity.FAIL, "too_uncertain", what, _AROUND))
    if fit.after.rms() > _LEAST_GAIN * fit.before.rms():
        what = f"the residuals stay as they are: {fit.before.rms():.3f} px before, {fit.after.rms():.3f} px after"
        findings.append(Finding(Severity.NOTE, "no_gain", what, "keep the camera model equirectangular"))
    return findings


def _write(out: Path, report: StitchedReport) -> tuple[Path, ...]:
    passed = exit_code(report.findings) == PASS and report.fit is not None
    text = json.dumps(stitched_data(report), indent=1, allow_nan=False) + "\n"
    stem = out.with_suffix("") if passed else free_stem(out)
    html, numbers = stem.with_name(stem.name + ".html"), stem.with_name(stem.name + ".json")
    write_text(html, stitched_page(report))
    write_text(numbers, text)
    if not passed or report.fit is None:
        return html, numbers
    write_text(out, camera_text(report.fit.camera))
    return out, html, numbers


def _summary(report: StitchedReport) -> list[RenderableType]:
    fit = report.fit
    if fit is None:
        return []
    values, sigma = fit.between
    apart, known = 1000 * float(np.linalg.norm(values[3:])), 1000 * float(sigma[3:].max())
    turned, sure = np.degrees(float(np.linalg.norm(values[:3]))), np.degrees(float(sigma[:3].max()))
    return [
        f"{fit.before.rms():.3f} px rms before, {fit.after.rms():.3f} px after",
        f"lenses {apart:.1f} mm apart (sigma {known:.1f} mm), turned by {turned:.3f} degrees (sigma {sure:.3f})",
    ]
