"""All runs over one recording, evaluated, and the files that tell of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from palletloc.evaluation.error_table import ERRORS, write_errors
from palletloc.evaluation.evaluated_run import EvaluatedRun, Settings, evaluate_run
from palletloc.evaluation.metrics import METRICS, metrics_document, metrics_text
from palletloc.evaluation.run_files import RunFiles
from palletloc.evaluation.side_by_side import ComparedRuns, side_by_side
from palletloc.evaluation.truth import RecordingTruth
from palletloc.io.atomic import write_text


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
    evaluated = tuple(evaluate_run(truth, one, settings) for one in runs)
    return EvaluatedRecording(truth, evaluated, settings, side_by_side(evaluated))


def write_results(evaluated: EvaluatedRecording, out: Path, others: Mapping[str, str] | None = None) -> None:
    """Write errors.csv, metrics.json and other texts, when all of them are ready.

    Parameters
    ----------
    evaluated : EvaluatedRecording
        What to tell of.
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
    write_errors(out / ERRORS, evaluated.runs, "survey" if truth.path is None else "path")
    for name, content in {METRICS: text, **(others or {})}.items():
        write_text(out / name, content)
