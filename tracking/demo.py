"""The whole way on the sample that comes along: what ``palletloc demo`` does."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.resources import as_file, files
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
from rich.table import Table

from palletloc.cli.showing import Shown, working
from palletloc.cli.tables import new_table
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
from palletloc.io.folder_lock import locked
from palletloc.io.run_folder import MEASUREMENTS, Run, RunFolder
from palletloc.io.truth import read_truth
from palletloc.recording_run import Job, ShotOutcome, read_job, work_through
from tracking.config import TrackerConfig
from tracking.recording import TrackedRecording, read_measured, track_recording, write_run

PAGE, PICTURES = "index.html", "pictures"
"""Names of what the demo adds to the files of a run and of its evaluation: the page, and the folder of pictures."""


def run_demo(out: Path) -> Shown:
    """Localize, track and evaluate the sample, and write a page about it all.

    Parameters
    ----------
    out : Path
        Folder for the results; made if missing.

    Returns
    -------
    Shown
        The errors of single shots, tracks and smoothed tracks.
    """
    from palletloc.report.demo_page import later_start  # drawing is slow to import

    with locked(out), as_file(files("palletloc") / "sample") as sample, working("Localizing") as now:
        job, truth = read_job(sample), read_recording_truth(sample)
        outcomes = _localize(job, out, sample)
        now("Tracking")
        tracked = _track(job, out)
        now("Evaluating")
        evaluated = evaluate_recording(truth, [read_run(out, truth.recording, "demo")], Settings())
        smoothed = _smoothed(truth, tracked, out)
        now("Drawing")
        _report(job, outcomes, tracked, evaluated, smoothed, out)
    sources = _named(evaluated, smoothed)
    document = {"out": out, "page": out / PAGE, "sources": {name: _sizes(each) for name, each in sources.items()}}
    explained = later_start(TrackerConfig().life.confirm_hits)
    return Shown(document, (_table(sources), explained, "", f"look at {out / PAGE}"))


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
        pictures=write_explanation(job, explanation, out / PICTURES).pictures,
        explained=explanation.shot.file,
        confirm_hits=TrackerConfig().life.confirm_hits,
        folder=PICTURES,
    )
    write_text(out / PAGE, demo_page(result))


def _named(evaluated: EvaluatedRecording, smoothed: EvaluatedSource) -> dict[str, EvaluatedSource]:
    sources = evaluated.runs[0].sources
    return {"single shots": sources[SHOTS_SOURCE], "tracks": sources[TRACKS_SOURCE], "tracks, smoothed": smoothed}


_QUANTITIES = (
    ("yaw_deg", "yaw \N{DEGREE SIGN}", 3, 180 / np.pi, 2),
    ("depth_mm", "depth mm", 0, 1000.0, 1),
    ("along_mm", "along mm", 1, 1000.0, 1),
    ("height_mm", "height mm", 2, 1000.0, 1),
)
"""Key, title, number of the component, how many of the unit are in a metre or radian, and decimals."""


def _sizes(source: EvaluatedSource) -> dict[str, Any]:
    """Return median and 95 % of the absolute errors, and how many pallets were found."""
    sizes, found = np.abs(offsets(source.errors)), source.detection.found
    ends = {
        key: dict(zip(("median", "p95"), scale * np.percentile(sizes[:, column], (50, 95)), strict=True))
        for key, _, column, scale, _ in _QUANTITIES
        if len(sizes)
    }
    return {"found": found.successes, "of": found.trials, **ends}


def _table(sources: dict[str, EvaluatedSource]) -> Table:
    title = "median / 95 % of the absolute errors"
    table = new_table([""], ["found", *(heading for _, heading, *_ in _QUANTITIES)], title=title)
    for name, source in sources.items():
        values = _sizes(source)
        ends = [(values.get(key, {}), digits) for key, *_, digits in _QUANTITIES]
        cells = [" / ".join(f"{value:.{digits}f}" for value in pair.values()) for pair, digits in ends]
        table.add_row(name, f"{values['found']} of {values['of']}", *cells)
    return table
