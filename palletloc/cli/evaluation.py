"""What ``palletloc evaluate`` does: one recording or all in a folder, their results, and the tables to print."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
import typer
from rich.table import Table
from rich.text import Text

from palletloc.choices import NEAREST_LIMIT, TimeRule
from palletloc.cli.showing import Shown, progress, say, say_all, working
from palletloc.cli.tables import new_table
from palletloc.errors import PalletLocError
from palletloc.evaluation.batch import (
    BatchJob,
    BatchResult,
    SourceTotals,
    batch_document,
    evaluate_in_parallel,
    pooled,
)
from palletloc.evaluation.metrics import METRICS, metrics_document, metrics_text
from palletloc.evaluation.pose_error import COMPONENTS, EvaluationError, Visibility, offsets, squared_errors
from palletloc.evaluation.recording import evaluate_recording, write_results
from palletloc.evaluation.requirement import Requirement, check_requirement
from palletloc.evaluation.run import (
    INTERPOLATED_LIMIT,
    ComparedRuns,
    EvaluatedRun,
    EvaluatedSource,
    RunFiles,
    Settings,
    read_run,
)
from palletloc.evaluation.truth import RecordingTruth, read_recording_truth, survey_notes
from palletloc.io.atomic import write_text
from palletloc.io.recording import Recording
from palletloc.mounting_yaw import turn_lines
from palletloc.survey.plan import split_columns

BATCH = "batch.json"
"""Name of the file about all recordings of a batch."""
_NOTES = 8
"""How many notes about a survey are printed."""
_QUANTITIES = (
    ("yaw \N{DEGREE SIGN}", 3, 180 / np.pi, 2),
    ("depth mm", 0, 1000.0, 1),
    ("along mm", 1, 1000.0, 1),
    ("height mm", 2, 1000.0, 1),
)
"""Title, number of the component, how many of the unit are in a metre or radian, and decimals."""


def evaluate_one(
    recording: Path,
    estimate: Sequence[Path],
    out: Path,
    settings: Settings,
    columns: str | None = None,
    *,
    with_pictures: bool,
) -> Shown:
    """Evaluate the runs over one recording, and write the results.

    Parameters
    ----------
    recording : Path
        Folder of the recording, with its truth.
    estimate : sequence of Path
        Folders of the runs.
    out : Path
        For the results; made if missing.
    settings : Settings
        What counts.
    columns : str, optional
        What the columns of a surveyed table are, with commas between them.
    with_pictures : bool
        Whether the report shows the images of the worst shots.

    Returns
    -------
    Shown
        The content of metrics.json, and tables of the same.

    Raises
    ------
    PalletLocError
        If a file is missing or wrong, or a run is given twice.
    """
    truth = read_recording_truth(recording, split_columns(columns))
    say_all(truth.recording.notes)
    evaluated = evaluate_recording(truth, _read_runs(estimate, truth.recording), settings)
    runs, compared = evaluated.runs, evaluated.compared
    with working("Drawing"):
        from palletloc.report.evaluation_page import REPORT, evaluation_page  # drawing is slow to import

        page = evaluation_page(evaluated, with_pictures=with_pictures)
    write_results(evaluated, out, {REPORT: page})
    document = metrics_document(truth, runs, settings, compared)
    tables = (_table(runs), *((_compared(compared),) if compared else ()))
    parts = (*tables, *_remarks(runs), *_notes(truth, settings), f"look at {out / REPORT}")
    lines = [f"{run.files.name}: {line}" if len(runs) > 1 else line for run in runs for line in turn_lines(run.turn)]
    return Shown({"out": out, "report": out / REPORT, **document}, parts, tuple(lines))


def settings_of(
    max_range: float, pair: TimeRule, pair_limit: float | None, stop_limit: float, yaw_deg: float, millimetres: float
) -> Settings:
    """Return the settings that the command's options ask for.

    Raises
    ------
    typer.BadParameter
        If a number is not positive; names the option.
    """
    if pair_limit is None:
        pair_limit = INTERPOLATED_LIMIT if pair is TimeRule.INTERPOLATED else NEAREST_LIMIT
    given = {
        "--max-range": max_range,
        "--pair-limit": pair_limit,
        "--stop-limit": stop_limit,
        "--requirement-yaw-deg": yaw_deg,
        "--requirement-mm": millimetres,
    }
    for name, value in given.items():
        if not 0 < value < math.inf:
            raise typer.BadParameter(f"expected a positive number, got {value:g}", param_hint=name)
    limit = millimetres / 1000
    requirement = Requirement(depth=limit, along=limit, height=limit, yaw=math.radians(yaw_deg))
    return Settings(Visibility(max_range=max_range), pair, pair_limit, stop_limit, requirement)


def _read_runs(folders: Sequence[Path], recording: Recording) -> list[RunFiles]:
    """Read the runs; each is called like its folder, or like its path where two folders have one name."""
    places = [folder.resolve() for folder in folders]
    for number, place in enumerate(places):
        if place in places[:number]:
            raise PalletLocError(f"--estimate {folders[number]}: is given twice; expected different runs")
    names = [place.name for place in places]
    return [
        read_run(folder, recording, str(folder) if names.count(name) > 1 else name)
        for folder, name in zip(folders, names, strict=True)
    ]


def _table(runs: Sequence[EvaluatedRun]) -> Table:
    title = "errors: measured minus true, absolute"
    table = new_table(["run", "source", ""], ["median", "95 %", "largest", "inside"], ["requirement"], title=title)
    for run in runs:
        label = run.files.name
        for name, source in run.sources.items():
            for number, cells in enumerate(_rows(source)):
                table.add_row(Text("" if number else label), "" if number else name, *cells)
            label = ""
    return table


def _rows(source: EvaluatedSource) -> Iterator[list[str]]:
    """Yield the cells of each quantity, of all together, and of what was found."""
    sizes = np.abs(offsets(source.errors))
    check = source.requirement
    for title, column, scale, digits in _QUANTITIES:
        part = getattr(check, COMPONENTS[column])
        values = sizes[:, column] * scale
        numbers = (np.median(values), np.percentile(values, 95), values.max()) if len(values) else ()
        cells = [f"{value:.{digits}f}" for value in numbers] or [""] * 3
        yield [title, *cells, part.proportion.counted, str(part.verdict).replace("_", " ")]
    together = check.together
    yield ["together", "", "", "", together.proportion.counted, str(together.verdict).replace("_", " ")]
    found = source.detection
    yield ["found", "", "", "", found.found.counted, f"{found.false} false"]


def _compared(compared: Sequence[ComparedRuns]) -> Table:
    title = f"change of the mean absolute error against {compared[0].first}, with its interval"
    table = new_table(["run", "source", ""], ["change", "from", "to", "better", "worse"], title=title)
    for runs in compared:
        for number, (title, column, scale, digits) in enumerate(_QUANTITIES):
            difference = runs.comparison.differences.get(COMPONENTS[column])
            if difference is not None:
                ends = (difference.mean, difference.low, difference.high)
                cells = [f"{scale * value:+.{digits + 1}f}" for value in ends]
                names = ("", "") if number else (runs.second, runs.source)
                table.add_row(
                    Text(names[0]), names[1], title, *cells, str(difference.smaller), str(difference.larger)
                )
    return table


def _notes(truth: RecordingTruth, settings: Settings) -> list[str]:
    """Return the notes about the files, and the first about the survey."""
    notes = list(survey_notes(truth, settings.stop_limit))
    more = len(notes) - _NOTES
    rest = [f"survey: {more} more notes; {METRICS} lists all"] if more > 0 else []
    return [*truth.notes, *(f"survey: {note}" for note in notes[:_NOTES]), *rest]


def _remarks(runs: Sequence[EvaluatedRun]) -> list[str]:
    """Say what the table does not."""
    remarks = [
        f"{run.files.name}, {name}, together: undecided: {source.requirement.together.decision}"
        for run in runs
        for name, source in run.sources.items()
        if source.requirement.together.decision
    ]
    left_out = runs[0].without_truth
    if left_out:
        count = "1 shot has" if len(left_out) == 1 else f"{len(left_out)} shots have"
        remarks.append(f"left out: {count} no truth within the limit; {METRICS} lists the times")
    for run in runs:
        for name, source in run.sources.items():
            if without := int(np.isnan(squared_errors(source.errors)).sum()):
                rows = f"{without} of {len(source.errors)} poses"
                remarks.append(f"{run.files.name}, {name}: {rows} state no usable covariance; NEES leaves them out")
    return remarks


class BatchWork(NamedTuple):
    """Who evaluates a batch, and how."""

    workers: int | None
    """How many processes to start; None for one for each processor."""
    scheduler: str | None
    """Address of a Dask scheduler to use instead."""
    with_pictures: bool
    """Whether reports show the images of the worst shots."""


def evaluate_batch(jobs: Sequence[BatchJob], folder: Path, out: Path, work: BatchWork) -> Shown:
    """Evaluate recordings, and write what there is about all of them together.

    Parameters
    ----------
    jobs : sequence of BatchJob
        One for each recording, with the same settings.
    folder : Path
        The recordings' folder.
    out : Path
        For the results: batch.json, index.html, and a folder for each recording.
    work : BatchWork
        Who does it.

    Returns
    -------
    Shown
        The content of batch.json, and a table of the same; exit code 1 if a recording cannot be evaluated.

    Raises
    ------
    PalletLocError
        If none of the recordings can be evaluated, or if Dask cannot be used.
    """
    results = sorted(_evaluated(jobs, work), key=lambda result: result.name)
    failed = [result for result in results if result.problem]
    if len(failed) == len(results):
        raise EvaluationError(f"{folder}: none of {len(results)} recordings can be evaluated: {failed[0].problem}")
    settings = jobs[0].settings
    with working("Drawing"):
        from palletloc.report.batch_page import INDEX, batch_page  # drawing is slow to import

        page = batch_page(folder, results, settings.requirement)
    document = batch_document(folder, results, settings)
    write_text(out / BATCH, metrics_text(document))
    write_text(out / INDEX, page)
    parts = (_batch_table(results, settings.requirement), f"look at {out / INDEX}")
    remarks = [f"{result.name}: {remark}" for result in results for remark in result.remarks]
    if failed:
        names = ", ".join(result.name for result in failed)
        count = f"{len(failed)} of {len(results)} recordings"
        remarks.append(f"{folder}: {count} could not be evaluated: {names}; the others are")
    return Shown({"out": out, "index": out / INDEX, **document}, parts, tuple(remarks), 1 if failed else 0)


def _evaluated(jobs: Sequence[BatchJob], work: BatchWork) -> Iterator[BatchResult]:
    """Yield the results as they come, and print failures."""
    from palletloc.report.evaluation_page import report_job  # drawing is slow to import

    job = partial(report_job, with_pictures=work.with_pictures)
    with progress("Evaluating", len(jobs)) as advance:
        for result in evaluate_in_parallel(jobs, work.workers, work.scheduler, job):
            yield result
            advance()
            if result.problem:
                say(f"skipped: {result.name}: {result.problem}")


def _batch_table(results: Sequence[BatchResult], requirement: Requirement) -> Table:
    title = "median / 95 % of the absolute errors"
    numbers = ["found", _QUANTITIES[0][0], _QUANTITIES[1][0]]
    table = new_table(["recording", "run", "source"], numbers, [""], title=title)
    for result in results:
        _add(table, result.name, result.totals, requirement)
        if result.problem:
            table.add_row(Text(result.name), "", "skipped")
    table.add_section()
    _add(table, "all", pooled(results), requirement)
    return table


def _add(table: Table, name: str, totals: Sequence[SourceTotals], requirement: Requirement) -> None:
    for number, source in enumerate(totals):
        verdict = check_requirement(source.offsets, requirement).together.verdict
        table.add_row(
            Text("" if number else name),
            Text(source.run),
            source.source,
            f"{len(source.offsets)} of {source.visible}",
            _sizes(source, _QUANTITIES[0]),
            _sizes(source, _QUANTITIES[1]),
            str(verdict).replace("_", " "),
        )


def _sizes(source: SourceTotals, quantity: tuple[str, int, float, int]) -> str:
    _, column, scale, digits = quantity
    sizes = scale * np.abs(source.offsets[:, column])
    return f"{np.median(sizes):.{digits}f} / {np.percentile(sizes, 95):.{digits}f}" if len(sizes) else ""
