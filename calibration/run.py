"""The command ``palletloc calibrate extrinsics`` from folder to files."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from rich import box
from rich.console import RenderableType
from rich.table import Table
from rich.text import Text

from calibration.assessment import Assessment, assess
from calibration.degeneracy import NAMES
from calibration.extrinsics_file import ExtrinsicsTask, read_extrinsics
from calibration.findings import PASS, Severity
from calibration.network import Network, Sight
from calibration.observations import TargetObservation, observe
from calibration.outcome import Outcome, free_stem
from calibration.report import Report, report_data, report_page
from calibration.rig_file import rig_text
from calibration.texture_alignment import on_board
from palletloc.io.atomic import write_text
from palletloc.io.camera_spec import angles_from_transform
from palletloc.io.images import read_image


def calibrate_extrinsics(folder: Path, out: Path, on_progress: Callable[[str], None] = lambda _: None) -> Outcome:
    """Calibrate from a folder and write the results.

    Parameters
    ----------
    folder : Path
        With extrinsics.yaml and its shots.
    out : Path
        The file rig.yaml; the reports get its name with other endings.
    on_progress : callable
        Is told what is done next.

    Returns
    -------
    Outcome
        A run that fails writes no rig.yaml, and its reports under names that do not exist yet.

    Raises
    ------
    PalletLocError
        If a file is missing or wrong, a target is there twice, or a file cannot be written.
    """
    task = read_extrinsics(folder)
    if task.frame is not None and task.frame.pose is None:
        report = Report(Assessment(task.frame.findings), (), (), (), task.frame)
        return Outcome(report.assessment.exit_code, (), _write(out, task, report), _reasons(report.assessment))
    observations = _observe(task, on_progress)
    names = tuple(name for name in task.targets if any(one.target == name for one in observations))
    on_progress("fitting")
    assessment = assess(observed_network(task, observations, names), task.camera, task.frame)
    unseen = tuple(name for name in task.targets if name not in names)
    report = Report(assessment, tuple(observations), names, unseen, task.frame)
    on_progress("writing the report")
    files = _write(out, task, report)
    reasons = list(_reasons(assessment))
    if names:  # where none is seen, one reason says so
        reasons += [f"{Severity.WARNING}: not_seen: target {name} is in no shot" for name in unseen]
    return Outcome(assessment.exit_code, tuple(_summary(report)), files, tuple(reasons))


def _reasons(assessment: Assessment) -> tuple[str, ...]:
    return tuple(f"{f.severity}: {f.code}: {f.what}; {f.how}" for f in assessment.findings)


def _observe(task: ExtrinsicsTask, on_progress: Callable[[str], None]) -> list[TargetObservation]:
    size = (task.camera.width, task.camera.height)
    observations = []
    for shot in task.shots:
        image = read_image(task.folder / shot, size, gray=True)
        observations += observe(task.camera, image, shot, task.targets, on_progress)
    return observations


def observed_network(
    task: ExtrinsicsTask, observations: Sequence[TargetObservation], names: Sequence[str]
) -> Network:
    """Return the equations for what was observed.

    Parameters
    ----------
    task : ExtrinsicsTask
        With the surveys.
    observations : sequence of TargetObservation
        Targets in shots.
    names : sequence of str
        Of the targets that are seen, in the order that the network gets.
    """
    sights = tuple(
        Sight(
            names.index(one.target),
            on_board(one.corners.points),
            one.corners.bearings,
            one.corners.origins,
            one.corners.sigma,
        )
        for one in observations
    )
    return Network(tuple(task.surveys[name] for name in names), sights, (True,) * len(names))


def _write(out: Path, task: ExtrinsicsTask, report: Report) -> tuple[Path, ...]:
    solution = report.assessment.solution
    text = json.dumps(report_data(report), indent=1, allow_nan=False) + "\n"
    passed = report.assessment.exit_code == PASS and solution is not None
    stem = out.with_suffix("") if passed else free_stem(out)
    html, numbers = stem.with_name(stem.name + ".html"), stem.with_name(stem.name + ".json")
    write_text(html, report_page(report))
    write_text(numbers, text)
    if not passed or solution is None:
        return html, numbers
    write_text(out, rig_text(task.camera_spec, solution.mounting))
    return out, html, numbers


def _summary(report: Report) -> list[RenderableType]:
    seen = Table(box=box.SIMPLE_HEAD)
    for name in ("target", "markers", "corners", "rms px", "rms \N{DEGREE SIGN}"):
        seen.add_column(name, justify="left" if name == "target" else "right")
    residuals = {(one.target, one.shot): one for one in report.residuals()}
    for one in report.observations:
        rest = residuals.get((one.target, one.shot))
        counts = (
            f"{one.markers}/{len(one.pattern.marker_ids)}",
            f"{len(one.corners.points)}/{len(one.pattern.corners)}",
        )
        fit = ("", "") if rest is None else (f"{rest.rms_px:.3f}", f"{np.degrees(rest.rms):.4f}")
        legacy = " (legacy pattern)" if one.pattern.legacy else ""
        seen.add_row(Text(one.target + legacy), *counts, *fit)
    return [seen, *_pose_table(report.assessment)] if report.observations else []


def _pose_table(assessment: Assessment) -> list[RenderableType]:
    solution = assessment.solution
    if solution is None:
        return []
    translation, angles = angles_from_transform(solution.poses.camera)
    table = Table(box=box.SIMPLE_HEAD)
    for name in ("", "forklift_from_camera", "sigma", "most without one target"):
        table.add_column(name, justify="right")
    most = np.abs([one.shift_in_sigma for one in assessment.left_out]).max(0) if assessment.left_out else np.zeros(6)
    for i, name in enumerate(NAMES):
        value = f"{translation[i]:.4f} m" if i < 3 else f"{angles[i - 3]:.3f} \N{DEGREE SIGN}"
        sigma = (
            f"{1000 * solution.sigma[i]:.2f} mm" if i < 3 else f"{np.degrees(solution.sigma[i]):.4f} \N{DEGREE SIGN}"
        )
        table.add_row(name, value, sigma, f"{most[i]:.1f} sigma")
    return [table]
