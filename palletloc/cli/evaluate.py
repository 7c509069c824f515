"""The command ``palletloc evaluate``."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Annotated, NamedTuple

import numpy as np
import typer
from rich import box
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table
from rich.text import Text

from palletloc.errors import PalletLocError
from palletloc.evaluation.batch import (
    BatchJob,
    BatchResult,
    SourceTotals,
    batch_document,
    evaluate_in_parallel,
    find_jobs,
    pooled,
)
from palletloc.evaluation.metrics import METRICS, metrics_text
from palletloc.evaluation.pose_error import COMPONENTS, EvaluationError, Visibility, offsets
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
from palletloc.evaluation.run_match import NEAREST_LIMIT
from palletloc.evaluation.time_pairing import TimeRule
from palletloc.evaluation.truth import RecordingTruth, read_recording_truth, survey_notes
from palletloc.io.atomic import write_text
from palletloc.io.recording import Recording

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


def evaluate(
    estimate: Annotated[
        list[Path],
        typer.Option(
            metavar="DIR",
            help="Folder of a run: measurements.csv and, if there, tracks.csv; may be repeated."
            " With --batch relative to each recording.",
        ),
    ],
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder for the results; made if missing.")],
    recording: Annotated[
        Path | None, typer.Argument(metavar="[RECORDING]", help="Folder of the recording, with its truth.")
    ] = None,
    batch: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Evaluate every recording in this folder, in parallel.")
    ] = None,
    workers: Annotated[
        int | None, typer.Option(metavar="N", min=1, help="With --batch: how many processes to start.")
    ] = None,
    scheduler: Annotated[
        str | None, typer.Option(metavar="ADDRESS", help="With --batch: use this Dask scheduler instead.")
    ] = None,
    max_range: Annotated[
        float, typer.Option(metavar="M", help="Farthest pallet that has to be found, in metres.")
    ] = Visibility().max_range,
    pair: Annotated[TimeRule, typer.Option(help="How the truth is taken for a shot's time.")] = TimeRule.NEAREST,
    pair_limit: Annotated[
        float | None,
        typer.Option(metavar="S", help="Largest time to the nearest sample, or between the samples on both sides."),
    ] = None,
    stop_limit: Annotated[
        float, typer.Option(metavar="S", help="How far a shot may be from the time of a surveyed stop.")
    ] = NEAREST_LIMIT,
    requirement_yaw_deg: Annotated[
        float, typer.Option(metavar="DEG", help="Largest error of the yaw that is allowed.")
    ] = 2.0,
    requirement_mm: Annotated[
        float, typer.Option(metavar="MM", help="Largest error of depth, along and height that is allowed.")
    ] = 20.0,
    no_pictures: Annotated[
        bool, typer.Option("--no-pictures", help="Leave the images of the worst shots out of the report.")
    ] = False,
) -> None:
    """Hold measured poses against the truth of a recording.

    Writes metrics.json, errors.csv and report.html.
    """
    settings = _settings(max_range, pair, pair_limit, stop_limit, requirement_yaw_deg, requirement_mm)
    if batch is not None and recording is None:
        _check_batch(estimate, workers, scheduler)
        jobs = find_jobs(batch, [str(name) for name in estimate], out, settings)
        work = _Work(workers, scheduler, with_pictures=not no_pictures)
        _evaluate_batch(jobs, batch, out, work)
    elif recording is None or batch is not None:
        raise typer.BadParameter("expected either RECORDING or --batch DIR", param_hint="RECORDING")
    elif workers is not None or scheduler is not None:
        raise typer.BadParameter("go with --batch DIR only", param_hint="--workers, --scheduler")
    else:
        _evaluate_one(recording, estimate, out, settings, with_pictures=not no_pictures)


def _check_batch(estimates: Sequence[Path], workers: int | None, scheduler: str | None) -> None:
    if workers is not None and scheduler is not None:
        raise typer.BadParameter("a scheduler has its own workers; expected one of them", param_hint="--workers")
    for name in estimates:
        if name.is_absolute():
            raise typer.BadParameter(
                f"with --batch expected a name in each recording, got {name}", param_hint="--estimate"
            )
    if len(set(estimates)) < len(estimates):
        raise PalletLocError("--estimate: a run is given twice; expected different runs")


def _evaluate_one(
    recording: Path, estimate: Sequence[Path], out: Path, settings: Settings, *, with_pictures: bool
) -> None:
    """Evaluate the runs over one recording, write the results and print the tables."""
    truth = read_recording_truth(recording)
    evaluated = evaluate_recording(truth, _read_runs(estimate, truth.recording), settings)
    runs, compared = evaluated.runs, evaluated.compared
    with Console(stderr=True).status("Drawing"):
        from palletloc.report.evaluation_page import REPORT, evaluation_page  # drawing is slow to import

        page = evaluation_page(evaluated, with_pictures=with_pictures)
    write_results(evaluated, out, {REPORT: page})
    console = Console()
    console.print(_table(runs))
    if compared:
        console.print(_compared(compared))
    for line in (*_remarks(runs), *_notes(truth, settings)):
        console.print(Text(line), soft_wrap=True)
    console.print(Text(f"look at {out / REPORT}"), soft_wrap=True)


def _settings(
    max_range: float, pair: TimeRule, pair_limit: float | None, stop_limit: float, yaw_deg: float, millimetres: float
) -> Settings:
    """Return the settings that options ask for."""
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


def _new_table(title: str, names: Sequence[str], texts: Sequence[str], numbers: Sequence[str]) -> Table:
    """Return an empty table; the names of recordings and runs may wrap, the other columns do not."""
    table = Table(box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0), title=title, title_justify="left")
    for heading in names:
        table.add_column(heading)
    for heading in texts:
        table.add_column(heading, no_wrap=True)
    for heading in numbers:
        table.add_column(heading, justify="right", no_wrap=True)
    return table


def _table(runs: Sequence[EvaluatedRun]) -> Table:
    title = "errors: measured minus true, absolute"
    table = _new_table(title, ["run"], ["source", ""], ["median", "95 %", "largest", "inside"])
    table.add_column("requirement", no_wrap=True)
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
    table = _new_table(title, ["run"], ["source", ""], ["change", "from", "to", "better", "worse"])
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
    """Return the first notes about the survey."""
    notes = list(survey_notes(truth, settings.stop_limit))
    more = len(notes) - _NOTES
    rest = [f"survey: {more} more notes; {METRICS} lists all"] if more > 0 else []
    return [*(f"survey: {note}" for note in notes[:_NOTES]), *rest]


def _remarks(runs: Sequence[EvaluatedRun]) -> list[str]:
    """Say what the table does not."""
    left_out = runs[0].without_truth
    if not left_out:
        return []
    count = "1 shot has" if len(left_out) == 1 else f"{len(left_out)} shots have"
    return [f"left out: {count} no truth within the limit; {METRICS} lists the times"]


class _Work(NamedTuple):
    """Who evaluates a batch, and how."""

    workers: int | None
    scheduler: str | None
    with_pictures: bool


def _evaluate_batch(jobs: Sequence[BatchJob], folder: Path, out: Path, work: _Work) -> None:
    """Evaluate recordings, write what there is about all of them together, and print a table."""
    results = sorted(_evaluated(jobs, work), key=lambda result: result.name)
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
    stdout.print(_batch_table(results, settings.requirement))
    stdout.print(Text(f"look at {out / INDEX}"), soft_wrap=True)
    if failed:
        names = ", ".join(result.name for result in failed)
        count = f"{len(failed)} of {len(results)} recordings"
        raise EvaluationError(f"{folder}: {count} could not be evaluated: {names}; the others are")


def _evaluated(jobs: Sequence[BatchJob], work: _Work) -> Iterator[BatchResult]:
    """Yield the results as they come, and print failures."""
    from palletloc.report.evaluation_page import report_job  # drawing is slow to import

    console, job = Console(stderr=True), partial(report_job, with_pictures=work.with_pictures)
    columns = (TextColumn("Evaluating"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as progress:
        bar = progress.add_task("", total=len(jobs))
        for result in evaluate_in_parallel(jobs, work.workers, work.scheduler, job):
            yield result
            progress.advance(bar)
            if result.problem:
                console.print(Text(f"palletloc: skipped: {result.name}: {result.problem}"), soft_wrap=True)


def _batch_table(results: Sequence[BatchResult], requirement: Requirement) -> Table:
    title = "median / 95 % of the absolute errors"
    numbers = ["found", _QUANTITIES[0][0], _QUANTITIES[1][0]]
    table = _new_table(title, ["recording", "run"], ["source"], numbers)
    table.add_column("", no_wrap=True)
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
