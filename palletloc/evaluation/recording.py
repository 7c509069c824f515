"""All runs over one recording, evaluated, and their files: metrics.json, errors.csv and pages."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from palletloc.evaluation.metrics import METRICS, metrics_document, metrics_text
from palletloc.evaluation.pose_error import PoseError
from palletloc.evaluation.run import ComparedRuns, EvaluatedRun, RunFiles, Settings, evaluate_run, side_by_side
from palletloc.evaluation.truth import RecordingTruth
from palletloc.io.atomic import write_text
from palletloc.io.csv_table import format_number, write_rows
from palletloc.io.folder_lock import locked
from palletloc.io.measurements import format_time

ERRORS = "errors.csv"
"""Name of the file."""
ERROR_COLUMNS = (
    *("run", "source", "truth", "time_s", "file", "track", "state", "pallet", "model", "counted", "range_m"),
    *("depth_m", "along_m", "height_m", "yaw_rad"),
    *("sigma_depth_m", "sigma_along_m", "sigma_height_m", "sigma_yaw_rad", "nees"),
)
"""Its header."""


@dataclass(frozen=True, slots=True, eq=False)
class EvaluatedRecording:
    """A recording with its runs."""

    truth: RecordingTruth
    """Of the recording."""
    runs: tuple[EvaluatedRun, ...]
    """At least one."""
    settings: Settings
    """With which they were evaluated."""
    compared: tuple[ComparedRuns, ...]
    """The runs side by side; empty for a single one."""


def evaluate_recording(truth: RecordingTruth, runs: Sequence[RunFiles], settings: Settings) -> EvaluatedRecording:
    """Evaluate runs, and compare every further one with the first.

    Parameters
    ----------
    truth : RecordingTruth
        Of the recording.
    runs : sequence of RunFiles
        Over it, at least one.
    settings : Settings
        How to evaluate.

    Raises
    ------
    EvaluationError
        If truth and shots have no time in common.
    """
    evaluated = tuple(evaluate_run(truth, run, settings) for run in runs)
    return EvaluatedRecording(truth, evaluated, settings, side_by_side(evaluated))


def write_results(evaluated: EvaluatedRecording, out: Path, others: Mapping[str, str] | None = None) -> None:
    """Write errors.csv, metrics.json and other texts, when all of them are ready.

    Parameters
    ----------
    evaluated : EvaluatedRecording
        The results.
    out : Path
        Folder for the files; made if missing.
    others : mapping of str to str, optional
        Further files by name.

    Raises
    ------
    OutputError
        If a file cannot be written.
    """
    truth = evaluated.truth
    text = metrics_text(metrics_document(truth, evaluated.runs, evaluated.settings, evaluated.compared))
    kind = "survey" if truth.path is None else "path"
    with locked(out):
        write_rows(out / ERRORS, ERROR_COLUMNS, (row for run in evaluated.runs for row in _rows(run, kind)))
        for name, content in {METRICS: text, **(others or {})}.items():
            write_text(out / name, content)


def _rows(run: EvaluatedRun, truth: str) -> Iterator[list[str]]:
    """Yield rows of errors.csv; those of surveyed stops follow where the shots were held against the path."""
    for name, source in run.sources.items():
        for shot in source.shots:
            for error in shot.errors:
                yield _cells(run.files.name, name, truth, error, counted=True)
            for error in shot.beyond:
                yield _cells(run.files.name, name, truth, error, counted=False)
        if truth == "survey":
            continue
        for stop in source.stops:
            for error in stop.errors:
                yield _cells(run.files.name, name, "survey", error, counted=False)


def _cells(run: str, source: str, truth: str, error: PoseError, *, counted: bool) -> list[str]:
    estimate, face = error.estimate, error.face
    sigma = np.sqrt(np.diag(error.covariance))
    nees = error.nees_with_truth
    texts = [run, source, truth, format_time(error.time), estimate.file, estimate.track, estimate.state]
    texts += [face.id, estimate.model, "yes" if counted else "no"]
    numbers = [format_number(float(value)) for value in (face.range, *error.offset, *sigma)]
    return [*texts, *numbers, format_number(nees) if np.isfinite(nees) else ""]
