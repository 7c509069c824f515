"""Many recordings by ``palletloc evaluate --batch``."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from rich import box
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table
from rich.text import Text

from palletloc.evaluation.batch import (
    BatchJob,
    BatchResult,
    SourceTotals,
    batch_document,
    evaluate_in_parallel,
    pooled,
)
from palletloc.evaluation.metrics import metrics_text
from palletloc.evaluation.pose_error import EvaluationError
from palletloc.evaluation.requirement import Requirement, check_requirement
from palletloc.io.atomic import write_text

BATCH = "batch.json"
"""Name of the file about all recordings."""


@dataclass(frozen=True, slots=True)
class Workers:
    """Who does the work."""

    count: int | None = None
    """How many processes of our own; None for as many as there are processors."""
    scheduler: str | None = None
    """Address of a scheduler whose workers to use instead."""


def evaluate_batch(
    jobs: Sequence[BatchJob], folder: Path, out: Path, workers: Workers, *, with_pictures: bool = True
) -> None:
    """Evaluate recordings, write what there is about all of them together, and print a table.

    Parameters
    ----------
    jobs : sequence of BatchJob
        One for each recording, with the same settings.
    folder : Path
        The recordings' folder.
    out : Path
        For the results: batch.json, index.html, and a folder for each recording.
    workers : Workers
        Who does the work.
    with_pictures : bool
        Whether reports show the images and stages of the worst shots.

    Raises
    ------
    PalletLocError
        If a recording cannot be evaluated, when all others are, or if Dask cannot be used.
    """
    results = sorted(_evaluated(jobs, workers, with_pictures), key=lambda result: result.name)
    failed = [result for result in results if result.problem]
    if len(failed) == len(results):
        raise EvaluationError(f"{folder}: none of {len(results)} recordings can be evaluated: {failed[0].problem}")
    settings = jobs[0].settings
    with Console(stderr=True).status("Drawing"):
        from palletloc.report.batch_page import INDEX, batch_page  # drawing is slow to import

        page = batch_page(folder, results, settings.requirement)
    write_text(out / BATCH, metrics_text(batch_document(folder, results, settings)))
    write_text(out / INDEX, page)
    stdout = Console()
    stdout.print(_table(results, settings.requirement))
    stdout.print(Text(f"look at {out / INDEX}"), soft_wrap=True)
    if failed:
        names = ", ".join(result.name for result in failed)
        count = f"{len(failed)} of {len(results)} recordings"
        raise EvaluationError(f"{folder}: {count} could not be evaluated: {names}; the others are")


def _evaluated(jobs: Sequence[BatchJob], workers: Workers, with_pictures: bool) -> Iterator[BatchResult]:
    """Yield the results as they come, and tell of failures."""
    from palletloc.report.evaluation_job import report_job  # drawing is slow to import

    console, work = Console(stderr=True), partial(report_job, with_pictures=with_pictures)
    columns = (TextColumn("Evaluating"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as progress:
        bar = progress.add_task("", total=len(jobs))
        for result in evaluate_in_parallel(jobs, workers.count, workers.scheduler, work):
            yield result
            progress.advance(bar)
            if result.problem:
                console.print(Text(f"palletloc: skipped: {result.name}: {result.problem}"), soft_wrap=True)


def _table(results: Sequence[BatchResult], requirement: Requirement) -> Table:
    title = "median / 95 % of the absolute errors"
    table = Table(box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0), title=title, title_justify="left")
    table.add_column("recording")
    table.add_column("run")
    table.add_column("source", no_wrap=True)
    for heading in ("found", "yaw \N{DEGREE SIGN}", "depth mm"):
        table.add_column(heading, justify="right", no_wrap=True)
    table.add_column("", no_wrap=True)
    for result in results:
        _add(table, result.name, result.totals, requirement)
        if result.problem:
            table.add_row(Text(result.name), "", "skipped")
    table.add_section()
    _add(table, "all", pooled(results), requirement)
    return table


def _add(table: Table, name: str, totals: Sequence[SourceTotals], requirement: Requirement) -> None:
    for number, one in enumerate(totals):
        verdict = check_requirement(one.offsets, requirement).together.verdict
        table.add_row(
            Text("" if number else name),
            Text(one.run),
            one.source,
            f"{len(one.offsets)} of {one.visible}",
            _sizes(one, 3, 180 / np.pi, 2),
            _sizes(one, 0, 1000.0, 1),
            str(verdict).replace("_", " "),
        )


def _sizes(one: SourceTotals, column: int, scale: float, digits: int) -> str:
    sizes = scale * np.abs(one.offsets[:, column])
    return f"{np.median(sizes):.{digits}f} / {np.percentile(sizes, 95):.{digits}f}" if len(sizes) else ""
