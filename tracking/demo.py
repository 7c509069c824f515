"""The whole way on the sample that comes along: what ``palletloc demo`` does."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.resources import as_file, files
from pathlib import Path
from statistics import median

import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from palletloc.evaluation.pose_error import PalletEstimate, offsets
from palletloc.evaluation.recording import EvaluatedRecording, evaluate_recording, write_results
from palletloc.evaluation.run import (
    SHOTS_SOURCE,
    TRACKS_SOURCE,
    EvaluatedSource,
    RunFiles,
    Settings,
    evaluate_run,
    read_run,
)
from palletloc.evaluation.truth import RecordingTruth, read_recording_truth
from palletloc.io.atomic import write_text
from palletloc.io.run_folder import MEASUREMENTS, Run, RunFolder
from palletloc.io.truth import read_truth
from palletloc.recording_run import Job, ShotOutcome, read_job, work_through
from tracking.recording import TrackedRecording, read_measured, track_recording, write_run

PAGE, PICTURES = "index.html", "pictures"
"""Names of what the demo adds to the files of a run and of its evaluation: the page, and the folder of pictures."""


def run_demo(out: Path) -> None:
    """Localize, track and evaluate the sample, and write a page about it all.

    Parameters
    ----------
    out : Path
        Folder for the results; made if missing.
    """
    console = Console(stderr=True)
    with as_file(files("palletloc") / "sample") as sample:
        job, truth = read_job(sample), read_recording_truth(sample)
        with console.status("Localizing"):
            outcomes = _localize(job, out, sample)
        with console.status("Tracking"):
            tracked = _track(job, out)
        with console.status("Evaluating"):
            evaluated = evaluate_recording(truth, [read_run(out, truth.recording, "demo")], Settings())
            smoothed = _smoothed(truth, tracked, out)
        with console.status("Drawing"):
            _report(job, outcomes, tracked, evaluated, smoothed, out)
    stdout = Console()
    stdout.print(_table(_named(evaluated, smoothed)))
    stdout.print(Text(f"look at {out / PAGE}"), soft_wrap=True)


def _localize(job: Job, out: Path, sample: Path) -> list[ShotOutcome]:
    run = Run.of(job.recording, str(job.localizer.method), repr(job.localizer.config))
    with RunFolder(out, run, sample, job.shots) as output:
        return list(work_through(job, output, strict=True))


def _track(job: Job, out: Path) -> TrackedRecording:
    from palletloc.drawing.canvas import png  # drawing is slow to import
    from tracking.figure import track_deviations, track_figure

    measured = read_measured(out / MEASUREMENTS, job.recording)
    run = track_recording(job.recording, measured, smooth=True)
    deviations = track_deviations(run, read_truth(job.recording.folder, job.recording.truth_form))
    write_run(out, run, png(track_figure(deviations, "the sample")))
    return run


def _smoothed(truth: RecordingTruth, tracked: TrackedRecording, out: Path) -> EvaluatedSource:
    """Evaluate the tracks as all shots together know them."""
    rows = [
        PalletEstimate(row.time, row.model, row.pose, row.covariance, str(row.track), str(row.status))
        for row in tracked.smoothed_rows
    ]
    return evaluate_run(truth, RunFiles("smoothed", out, {TRACKS_SOURCE: rows})).sources[TRACKS_SOURCE]


def _report(
    job: Job,
    outcomes: Sequence[ShotOutcome],
    tracked: TrackedRecording,
    evaluated: EvaluatedRecording,
    smoothed: EvaluatedSource,
    out: Path,
) -> None:
    """Write the evaluation, the pictures of the shot with most pallets, and the page about everything."""
    from palletloc.report.demo_page import DemoResult, demo_page  # drawing is slow to import
    from palletloc.report.evaluation_page import REPORT, evaluation_page
    from palletloc.report.explanation_folder import write_explanation

    write_results(evaluated, out, {REPORT: evaluation_page(evaluated, worst=2)})
    shown = max(range(len(outcomes)), key=lambda i: (len(outcomes[i].rows), i))
    explanation = job.explain(shown)
    result = DemoResult(
        run=evaluated.runs[0],
        smoothed=smoothed,
        settings=evaluated.settings,
        tracks=tuple({row.track: row for row in tracked.rows}.values()),
        size=(job.recording.camera.width, job.recording.camera.height),
        seconds_per_shot=median(outcome.duration for outcome in outcomes),
        pictures=write_explanation(job, explanation, out / PICTURES),
        explained=explanation.shot.file,
        folder=PICTURES,
    )
    write_text(out / PAGE, demo_page(result))


def _named(evaluated: EvaluatedRecording, smoothed: EvaluatedSource) -> dict[str, EvaluatedSource]:
    sources = evaluated.runs[0].sources
    return {"single shots": sources[SHOTS_SOURCE], "tracks": sources[TRACKS_SOURCE], "tracks, smoothed": smoothed}


def _table(sources: dict[str, EvaluatedSource]) -> Table:
    title = "median / 95 % of the absolute errors"
    table = Table(box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0), title=title, title_justify="left")
    table.add_column("", no_wrap=True)
    for heading in ("found", "yaw \N{DEGREE SIGN}", "depth mm", "along mm", "height mm"):
        table.add_column(heading, justify="right", no_wrap=True)
    for name, source in sources.items():
        sizes, found = np.abs(offsets(source.errors)), source.detection.found
        cells = []
        for column, scale, digits in ((3, 180 / np.pi, 2), (0, 1000.0, 1), (1, 1000.0, 1), (2, 1000.0, 1)):
            ends = scale * np.percentile(sizes[:, column], (50, 95)) if len(sizes) else ()
            cells.append(" / ".join(f"{value:.{digits}f}" for value in ends))
        table.add_row(name, f"{found.successes} of {found.trials}", *cells)
    return table
