"""Many recordings by ``palletloc evaluate --batch``."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from rich import box
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table
from rich.text import Text

from palletloc.evaluation.batch import BatchResult, SourceTotals, batch_document, find_jobs, pooled
from palletloc.evaluation.cluster import evaluate_in_parallel
from palletloc.evaluation.errors import EvaluationError
from palletloc.evaluation.evaluated_run import Settings
from palletloc.evaluation.metrics import metrics_text
from palletloc.evaluation.requirement import Requirement, check_requirement
from palletloc.io.atomic import write_text

BATCH = "batch.json"
"""Name of the file about all recordings."""


def evaluate_batch(
    folder: Path,
    estimates: Sequence[str],
    out: Path,
    settings: Settings,
    workers: int | None = None,
    scheduler: str | None = None,
) -> None:
    """Evaluate all recordings in a folder, and print a table.

    Parameters
    ----------
    folder : Path
        With a folder for each recording.
    estimates : sequence of str
        Folders of the runs, relative to each recording.
    out : Path
        For the results: batch.json, and a folder for each recording.
    settings : Settings
        How to evaluate.
    workers, scheduler
        As for `palletloc.evaluation.cluster.evaluate_in_parallel`.

    Raises
    ------
    PalletLocError
        If there is no recording, none can be evaluated, or Dask cannot be used.
    """
    jobs = find_jobs(folder, estimates, out, settings)
    console, results = Console(stderr=True), []
    columns = (TextColumn("Evaluating"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as progress:
        bar = progress.add_task("", total=len(jobs))
        for result in evaluate_in_parallel(jobs, workers, scheduler):
            results.append(result)
            progress.advance(bar)
            if result.problem:
                console.print(Text(f"palletloc: skipped: {result.name}: {result.problem}"), soft_wrap=True)
    results.sort(key=lambda result: result.name)
    if not any(result.totals for result in results):
        raise EvaluationError(f"{folder}: none of {len(results)} recordings can be evaluated: {results[0].problem}")
    write_text(out / BATCH, metrics_text(batch_document(folder, results, settings)))
    stdout = Console()
    stdout.print(_table(results, settings.requirement))
    stdout.print(Text(f"results: {out}"), soft_wrap=True)


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
