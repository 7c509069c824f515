"""The command ``palletloc calibrate check`` from recording to verdict."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
from rich import box
from rich.console import RenderableType
from rich.table import Table
from rich.text import Text

from calibration.check.assessment import CheckAssessment, assess_check
from calibration.check.mounting import check_mounting
from calibration.check.report import agreement, check_data, check_page, source_row, turns
from calibration.finding_table import finding_line
from calibration.outcome import Outcome
from palletloc.io.atomic import write_text
from palletloc.io.recording import read_recording


def calibrate_check(
    folder: Path,
    tolerance_deg: float,
    out: Path | None = None,
    on_progress: Callable[[str], None] = lambda _: None,
) -> Outcome:
    """Check the mounting that a recording states.

    Parameters
    ----------
    folder : Path
        The recording.
    tolerance_deg : float
        How far the camera may be turned about x or y, in degrees.
    out : Path, optional
        The file for the report, which ends in .html; the same as JSON goes beside it.
    on_progress : callable
        Is told what is done next.

    Returns
    -------
    Outcome
        Exit code 1 where the mounting is not right.

    Raises
    ------
    PalletLocError
        If a file is missing or wrong, or cannot be written.
    """
    assessment = assess_check(check_mounting(read_recording(folder), on_progress), float(np.radians(tolerance_deg)))
    files: tuple[Path, ...] = ()
    if out is not None:
        files = (out, out.with_suffix(".json"))
        write_text(out, check_page(assessment))
        write_text(files[1], json.dumps(check_data(assessment), indent=1, allow_nan=False) + "\n")
    reasons = tuple(finding_line(finding) for finding in assessment.findings)
    return Outcome(assessment.exit_code, tuple(_summary(assessment)), files, reasons)


def _summary(assessment: CheckAssessment) -> list[RenderableType]:
    table = Table(box=box.SIMPLE_HEAD)
    for name in ("", "turned by \N{DEGREE SIGN}", "sigma \N{DEGREE SIGN}"):
        table.add_column(name, justify="right")
    for row in turns(assessment.check):
        table.add_row(*row)
    sources = Table(box=box.SIMPLE_HEAD)
    for name in ("source", "roll \N{DEGREE SIGN}", "sigma", "pitch \N{DEGREE SIGN}", "sigma", "sights"):
        sources.add_column(name, justify="left" if name == "source" else "right")
    for source in assessment.check.tilts:
        sources.add_row(*source_row(source))
    return [table, sources, Text(agreement(assessment.check))] if table.row_count else []
