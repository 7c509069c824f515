"""Many recordings, each evaluated on its own, and all of them together."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from palletloc.errors import PalletLocError
from palletloc.evaluation.consistency import chi_square_check
from palletloc.evaluation.error_table import ERRORS
from palletloc.evaluation.errors import EvaluationError
from palletloc.evaluation.estimate_error import COMPONENTS, offsets
from palletloc.evaluation.evaluated_recording import EvaluatedRecording, evaluate_recording, write_results
from palletloc.evaluation.evaluated_run import EvaluatedRun, Settings
from palletloc.evaluation.metrics import METRICS, check_document
from palletloc.evaluation.proportion import clopper_pearson
from palletloc.evaluation.requirement import Requirement, check_requirement
from palletloc.evaluation.run_files import read_run
from palletloc.evaluation.spread import spread
from palletloc.evaluation.truth import read_recording_truth
from palletloc.geometry import FloatArray
from palletloc.io.recording import RECORDING


@dataclass(frozen=True, slots=True)
class BatchJob:
    """One recording to evaluate."""

    recording: Path
    """Its folder."""
    estimates: tuple[str, ...]
    """Folders of the runs, relative to it; also their names."""
    out: Path
    """Folder for the recording's own results."""
    settings: Settings
    """How to evaluate."""


@dataclass(frozen=True, slots=True, eq=False)
class SourceTotals:
    """What one source of one run gives to the whole."""

    run: str
    """Name of the run."""
    source: str
    """Name of the source."""
    offsets: FloatArray
    """(n, 4) errors of depth, along and height in metres, and of yaw in radians."""
    nees: FloatArray
    """(n,) squared errors in units of their covariance."""
    shots: int
    """Shots whose truth is known."""
    visible: int
    """Views of pallets that had to be found."""
    false: int
    """Estimates that belong to no pallet."""


@dataclass(frozen=True, slots=True, eq=False)
class BatchResult:
    """What became of one recording."""

    name: str
    """Name of its folder."""
    totals: tuple[SourceTotals, ...] = ()
    """Of each run and source; empty if it failed."""
    problem: str = ""
    """Why it failed, in one line."""


def find_jobs(folder: Path, estimates: Sequence[str], out: Path, settings: Settings) -> tuple[BatchJob, ...]:
    """Return a job for each recording in a folder.

    Parameters
    ----------
    folder : Path
        Whose folders are recordings; what is no recording is passed over.
    estimates : sequence of str
        Folders of the runs, relative to each recording.
    out : Path
        Gets a folder for each recording, of the same name.
    settings : Settings
        How to evaluate.

    Raises
    ------
    EvaluationError
        If there is no recording.
    """
    if not folder.is_dir():
        raise EvaluationError(f"{folder}: no such folder; expected recordings in it")
    found = sorted(path.parent for path in folder.absolute().glob(f"*/{RECORDING}"))
    if not found:
        raise EvaluationError(f"{folder}: no recordings in it; expected folders with {RECORDING}")
    return tuple(BatchJob(path, tuple(estimates), out.absolute() / path.name, settings) for path in found)


def evaluate_job(
    job: BatchJob, others: Callable[[EvaluatedRecording], Mapping[str, str]] | None = None
) -> BatchResult:
    """Evaluate one recording and write its metrics.json and errors.csv.

    A recording that cannot be evaluated gives a result with the problem; what an earlier call wrote for it is
    removed.

    Parameters
    ----------
    job : BatchJob
        What to do.
    others : callable, optional
        Gives further files, by name, to be written with the two.
    """
    try:
        return BatchResult(job.recording.name, _evaluated(job, others))
    except (PalletLocError, OSError) as error:
        for name in (METRICS, ERRORS):
            (job.out / name).unlink(missing_ok=True)
        return BatchResult(job.recording.name, problem=" ".join(str(error).split()))


def _evaluated(
    job: BatchJob, others: Callable[[EvaluatedRecording], Mapping[str, str]] | None
) -> tuple[SourceTotals, ...]:
    truth = read_recording_truth(job.recording)
    files = [read_run(job.recording / name, truth.recording, name) for name in job.estimates]
    evaluated = evaluate_recording(truth, files, job.settings)
    write_results(evaluated, job.out, others(evaluated) if others else None)
    return tuple(one for run in evaluated.runs for one in _totals(run))


def _totals(run: EvaluatedRun) -> list[SourceTotals]:
    return [
        SourceTotals(
            run.files.name,
            name,
            offsets(source.errors),
            np.array([one.nees_with_truth for one in source.errors]),
            source.detection.shots,
            source.detection.found.trials,
            source.detection.false,
        )
        for name, source in run.sources.items()
    ]


def pooled(results: Iterable[BatchResult]) -> tuple[SourceTotals, ...]:
    """Return the totals of all recordings together, for each run and source."""
    groups: dict[tuple[str, str], list[SourceTotals]] = {}
    for result in results:
        for one in result.totals:
            groups.setdefault((one.run, one.source), []).append(one)
    return tuple(
        SourceTotals(
            run,
            source,
            np.concatenate([one.offsets for one in group]),
            np.concatenate([one.nees for one in group]),
            sum(one.shots for one in group),
            sum(one.visible for one in group),
            sum(one.false for one in group),
        )
        for (run, source), group in groups.items()
    )


def totals_document(one: SourceTotals, requirement: Requirement) -> dict[str, Any]:
    """Return the numbers of one source: lengths in metres, the yaw in degrees."""
    found = clopper_pearson(len(one.offsets), one.visible, requirement.confidence)
    nees = chi_square_check(one.nees, 4)
    errors: dict[str, Any] = {}
    for column, name in enumerate(COMPONENTS):
        scale, unit = (180 / np.pi, "deg") if name == "yaw" else (1.0, "m")
        values = spread(scale * one.offsets[:, column])
        errors[f"{name}_{unit}"] = None if values is None else _numbers(values.bias, values.median, values.p95)
    return {
        "run": one.run,
        "source": one.source,
        "shots": one.shots,
        "found": found.successes,
        "visible": found.trials,
        "recall": {"share": found.value, "low": found.low, "high": found.high},
        "false": one.false,
        "errors": errors,
        "nees_mean": nees.mean,
        "requirement": check_document(check_requirement(one.offsets, requirement)),
    }


def _numbers(bias: float, median: float, p95: float) -> dict[str, float]:
    return {"bias": bias, "median": median, "p95": p95}


def batch_document(folder: Path, results: Sequence[BatchResult], settings: Settings) -> dict[str, Any]:
    """Return the document about all recordings; `docs/evaluation.md` describes its keys."""
    asked = settings.requirement
    return {
        "format": 1,
        "batch": folder.resolve().name,
        "recordings": [
            {
                "name": result.name,
                "problem": result.problem or None,
                "sources": [totals_document(one, asked) for one in result.totals],
            }
            for result in sorted(results, key=lambda result: result.name)
        ],
        "overall": [totals_document(one, asked) for one in pooled(sorted(results, key=lambda result: result.name))],
    }
