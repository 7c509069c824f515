"""The command ``palletloc calibrate shelf`` from recording to files."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
from rich import box
from rich.console import RenderableType
from rich.table import Table
from rich.text import Text

from calibration.finding_table import finding_line
from calibration.findings import PASS
from calibration.outcome import Outcome, free_stem
from calibration.shelf.assessment import ShelfAssessment, assess_shelf
from calibration.shelf.report import method_columns, method_row, shelf_data, shelf_page
from calibration.shelf.survey import Front, survey_shelf
from calibration.shelf.upright_tags import TagsOnUprights
from palletloc.errors import PalletLocError
from palletloc.geometry import wrap_angle
from palletloc.io.atomic import write_text
from palletloc.io.recording import RECORDING, Recording, read_recording
from palletloc.io.schema import RecordingSpec, ShelfSpec
from palletloc.io.yaml_document import format_document, read_document
from palletloc.shelf import ShelfPlane


def calibrate_shelf(
    folder: Path,
    out: Path,
    side: str | None = None,
    distance: float | None = None,
    front: Front = Front.UPRIGHTS,
    tags: TagsOnUprights | None = None,
    on_progress: Callable[[str], None] = lambda _: None,
) -> Outcome:
    """Find the front of a recording's shelf and write the recording.yaml with it.

    Parameters
    ----------
    folder : Path
        The recording.
    out : Path
        The file to write; the reports get its name with other endings.
    side : str, optional
        ``left`` or ``right``: where the shelf is, seen in the direction of travel; from recording.yaml if left out.
    distance : float, optional
        About how far the shelf is from the camera, in metres; with `side`.
    front : Front
        Which plane is wanted.
    tags : TagsOnUprights, optional
        Tags on the uprights, where there are any.
    on_progress : callable
        Is told what is done next.

    Returns
    -------
    Outcome
        A run that fails writes only its reports, under names that do not exist yet.

    Raises
    ------
    PalletLocError
        If a file is missing or wrong, or cannot be written.
    """
    recording = read_recording(folder)
    prior = recording.shelf
    if side is not None and distance is not None:
        prior = beside(recording, side, distance)
    assessment = assess_shelf(survey_shelf(recording, prior, front, tags, on_progress))
    on_progress("writing the report")
    files = _write(folder, out, assessment)
    reasons = tuple(finding_line(finding) for finding in assessment.findings)
    return Outcome(assessment.exit_code, tuple(_summary(assessment)), files, reasons)


def beside(recording: Recording, side: str, distance: float) -> ShelfPlane:
    """Return the plane along the way of the forklift, on one side.

    Parameters
    ----------
    recording : Recording
        For its odometry and its levels.
    side : str
        ``left`` or ``right`` in the direction of travel.
    distance : float
        From the camera at the middle of the way, in metres.
    """
    if side not in ("left", "right"):
        raise PalletLocError(f"--side {side}: expected left or right")
    if not 0.3 <= distance <= 10:
        raise PalletLocError(f"--distance {distance:g}: expected metres between 0.3 and 10")
    odometry, shots = recording.odometry, recording.shots
    first, last = (odometry.pose_at(shot.time) for shot in (shots[0], shots[-1]))
    middle = odometry.pose_at(shots[len(shots) // 2].time)
    dx, dy = last.x - first.x, last.y - first.y
    heading = float(np.arctan2(dy, dx)) if np.hypot(dx, dy) > 0.05 else middle.yaw
    if np.cos(heading - middle.yaw) < 0:  # it drives backwards: left is the forklift's own left
        heading += np.pi
    into = heading + (np.pi / 2 if side == "left" else -np.pi / 2)
    x, y, _ = middle.transform().apply(recording.mounting.center)
    return ShelfPlane(
        float(x + distance * np.cos(into)),
        float(y + distance * np.sin(into)),
        float(wrap_angle(into + np.pi)),
        recording.shelf.levels,
    )


def _write(folder: Path, out: Path, assessment: ShelfAssessment) -> tuple[Path, ...]:
    plane = assessment.survey.plane
    passed = assessment.exit_code == PASS and plane is not None
    stem = out.with_suffix("") if passed else free_stem(out)
    html, numbers = stem.with_name(stem.name + ".html"), stem.with_name(stem.name + ".json")
    text = ""
    if passed and plane is not None:
        text = recording_text(read_document(folder / RECORDING, RecordingSpec), plane)
    write_text(html, shelf_page(assessment))
    write_text(numbers, json.dumps(shelf_data(assessment), indent=1, allow_nan=False) + "\n")
    if not text:
        return html, numbers
    write_text(out, text)
    return out, html, numbers


def recording_text(spec: RecordingSpec, plane: ShelfPlane) -> str:
    """Return the content of a recording.yaml with another plane; all else stays.

    Parameters
    ----------
    spec : RecordingSpec
        What stands in the file.
    plane : ShelfPlane
        The new plane, in odom.
    """
    shelf = ShelfSpec(
        point_m=(round(plane.x, 4), round(plane.y, 4)),
        facing_deg=round(float(np.degrees(plane.facing)), 3),
        levels_m=spec.shelf.levels_m,
    )
    return format_document(spec.model_copy(update={"shelf": shelf}))


def _summary(assessment: ShelfAssessment) -> list[RenderableType]:
    survey = assessment.survey
    table = Table(box=box.SIMPLE_HEAD)
    for column in method_columns():
        table.add_column(column.heading, justify="left" if column.is_text else "right")
    for estimate in survey.estimates:
        table.add_row(*(Text(cell) for cell in method_row(survey.foot, estimate)))
    fused, plane = survey.fused, survey.plane
    if fused is not None and plane is not None:
        turn, distance = np.sqrt(np.diag(fused.covariance))
        table.add_section()
        table.add_row(
            "together", f"{np.degrees(plane.facing):.2f}", f"{np.degrees(turn):.2f}", f"{fused.distance:.4f}",
            f"{1000 * distance:.1f}", "",
        )  # fmt: skip
    return [table] if survey.estimates else []
