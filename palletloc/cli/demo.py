"""The command ``palletloc demo``."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.resources import as_file, files
from pathlib import Path
from statistics import median
from typing import Annotated

import numpy as np
import typer
from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from palletloc.io.atomic import write_bytes, write_text
from palletloc.io.csv_table import format_number, write_rows
from palletloc.io.measurements import format_time
from palletloc.io.run_folder import Run, RunFolder
from palletloc.io.truth import Truth, read_truth
from palletloc.measurement import PalletMeasurement
from palletloc.offline import Job, Outcome, read_job, work_through
from palletloc.report.comparison import Comparison, MeasuredError, compare

ERRORS, PAGE, PICTURES, CHART = "errors.csv", "index.html", "pictures", "errors.png"
"""Names of what the demo adds to the files of a run: files, the folder of pictures, and the chart in it."""
ERROR_COLUMNS = (
    *("time_s", "file", "pallet", "model", "range_m", "depth_m", "along_m", "height_m", "yaw_rad"),
    *("sigma_depth_m", "sigma_along_m", "sigma_height_m", "sigma_yaw_rad"),
)
"""Header of errors.csv."""


def demo(
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder for the results; made if missing.")] = Path(
        "palletloc-demo"
    ),
) -> None:
    """Localize the pallets of the sample that comes along.

    Writes the results of every shot, their errors against the truth, pictures, and index.html, which explains
    them.
    """
    console = Console()
    with as_file(files("palletloc") / "sample") as sample:
        truth = read_truth(sample)
        job = read_job(sample)
        with console.status("Localizing"):
            outcomes = _localize(job, out, sample)
        with console.status("Drawing"):
            comparison = _report(job, truth, outcomes, out)
    console.print(_table(comparison))
    console.print(Text(f"look at {out / PAGE}"), soft_wrap=True)


def _localize(job: Job, out: Path, sample: Path) -> list[Outcome]:
    run = Run.of(job.recording, str(job.localizer.method), repr(job.localizer.config))
    with RunFolder(out, run, sample, job.shots) as output:
        return list(work_through(job, output, strict=True))


def _report(job: Job, truth: Truth, outcomes: Sequence[Outcome], out: Path) -> Comparison:
    """Write what the run's own files do not tell: errors, pictures and the page."""
    from palletloc.drawing.canvas import png  # drawing is slow to import
    from palletloc.report.demo_page import DemoResult, demo_page
    from palletloc.report.error_figure import error_figure
    from palletloc.report.explanation_folder import write_explanation

    found = [row for one in outcomes for row in one.rows if isinstance(row, PalletMeasurement)]
    comparison = compare(job.recording, truth, found)
    write_rows(out / ERRORS, ERROR_COLUMNS, (_cells(error) for error in comparison.errors))
    write_bytes(out / PICTURES / CHART, png(error_figure(comparison.errors)))
    shown = max(range(len(outcomes)), key=lambda i: (len(outcomes[i].rows), i))
    image, explanation = job.explain(shown)
    result = DemoResult(
        comparison=comparison,
        shots=len(outcomes),
        size=(job.recording.camera.width, job.recording.camera.height),
        seconds_per_shot=median(one.duration for one in outcomes),
        pictures=write_explanation(job, image, explanation, out / PICTURES),
        explained=explanation.file,
        folder=PICTURES,
        chart=f"{PICTURES}/{CHART}",
    )
    write_text(out / PAGE, demo_page(result))
    return comparison


def _cells(error: MeasuredError) -> list[str]:
    measured, face = error.measured, error.error.face
    texts = [format_time(measured.time), measured.file, face.id, measured.model]
    return texts + [format_number(float(value)) for value in (face.range, *error.offset, *error.sigma)]


def _table(comparison: Comparison) -> Table:
    table = Table(box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0), title="measured minus true", title_justify="left")
    table.add_column("", no_wrap=True)
    table.add_column("shot", no_wrap=True)
    for heading in ("range m", "depth mm", "along mm", "height mm", "yaw \N{DEGREE SIGN}"):
        table.add_column(heading, justify="right")
    to_shown = np.array([1000.0, 1000.0, 1000.0, 180 / np.pi])
    for one in comparison.errors:
        face, numbers = one.error.face, zip(one.offset * to_shown, one.sigma * to_shown, (1, 1, 1, 2), strict=True)
        cells = (f"{value:+.{n}f} \N{PLUS-MINUS SIGN} {sigma:.{n}f}" for value, sigma, n in numbers)
        table.add_row(face.id, Path(one.measured.file).stem, f"{face.range:.2f}", *cells)
    return table
