"""Many recordings, each evaluated on its own, in parallel on Dask, and all of them together."""

from __future__ import annotations

import logging
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from palletloc.errors import PalletLocError
from palletloc.evaluation.metrics import METRICS, check_document
from palletloc.evaluation.pose_error import COMPONENTS, EvaluationError, offsets, squared_errors
from palletloc.evaluation.recording import ERRORS, EvaluatedRecording, evaluate_recording, write_results
from palletloc.evaluation.requirement import Requirement, check_requirement
from palletloc.evaluation.run import EvaluatedRun, Settings, read_run
from palletloc.evaluation.statistics import chi_square_check, clopper_pearson, spread
from palletloc.evaluation.truth import read_recording_truth
from palletloc.geometry import FloatArray
from palletloc.io.recording import RECORDING
from palletloc.mounting_yaw import turn_lines

CONNECT_TIMEOUT = 10.0
"""How long to wait for a scheduler, in seconds."""


class ClusterError(PalletLocError):
    """Dask is not installed, or its scheduler cannot be reached."""


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
    remarks: tuple[str, ...] = ()
    """What contradicts its mounting, one line for each run."""


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
        return _evaluated(job, others)
    except (PalletLocError, OSError) as error:
        for name in (METRICS, ERRORS):
            (job.out / name).unlink(missing_ok=True)
        return BatchResult(job.recording.name, problem=" ".join(str(error).split()))


def _evaluated(job: BatchJob, others: Callable[[EvaluatedRecording], Mapping[str, str]] | None) -> BatchResult:
    truth = read_recording_truth(job.recording)
    files = [read_run(job.recording / name, truth.recording, name) for name in job.estimates]
    evaluated = evaluate_recording(truth, files, job.settings)
    write_results(evaluated, job.out, others(evaluated) if others else None)
    totals = tuple(totals for run in evaluated.runs for totals in _totals(run))
    remarks = tuple(f"{run.files.name}: {line}" for run in evaluated.runs for line in turn_lines(run.turn))
    return BatchResult(job.recording.name, totals, remarks=remarks)


def _totals(run: EvaluatedRun) -> list[SourceTotals]:
    return [
        SourceTotals(
            run.files.name,
            name,
            offsets(source.errors),
            squared_errors(source.errors),
            source.detection.shots,
            source.detection.found.trials,
            source.detection.false,
        )
        for name, source in run.sources.items()
    ]


def evaluate_in_parallel(
    jobs: Sequence[BatchJob],
    workers: int | None = None,
    scheduler: str | None = None,
    work: Callable[[BatchJob], BatchResult] = evaluate_job,
) -> Iterator[BatchResult]:
    """Evaluate recordings and give the results as they come.

    Parameters
    ----------
    jobs : sequence of BatchJob
        What to do. Other machines have to see the same folders under the same paths.
    workers : int, optional
        How many processes of our own to start, reachable from this machine only; as many as there are processors if
        left out.
    scheduler : str, optional
        Address of a scheduler to use instead, like ``tcp://127.0.0.1:8786``.
    work : callable
        What a worker does with a job.

    Yields
    ------
    BatchResult
        One for each job; a worker that dies is the problem of its job alone.

    Raises
    ------
    ClusterError
        If Dask is not installed or the scheduler cannot be reached.
    """
    try:
        from distributed import Client, LocalCluster, as_completed  # an extra, and slow to import
    except ImportError:
        raise ClusterError(
            "--batch needs dask.distributed; expected it to be installed: python -m pip install 'palletloc[batch]'"
        ) from None
    logging.getLogger("distributed").setLevel(logging.CRITICAL)  # the results name what fails
    if scheduler is not None:
        try:
            client = Client(scheduler, timeout=CONNECT_TIMEOUT)
        except (OSError, ValueError) as error:
            reason = " ".join(str(error).split()) or type(error).__name__
            raise ClusterError(f"--scheduler {scheduler}: cannot be reached: {reason}") from None
        with client:
            yield from _results(client, as_completed, jobs, work)
        return
    count = min(workers or os.cpu_count() or 1, len(jobs))
    cluster = LocalCluster(
        n_workers=count,
        threads_per_worker=1,
        host="127.0.0.1",
        dashboard_address="127.0.0.1:0",
        silence_logs=logging.CRITICAL,
    )
    with cluster, Client(cluster) as client:
        yield from _results(client, as_completed, jobs, work)


def _results(
    client: Any, as_completed: Any, jobs: Sequence[BatchJob], work: Callable[[BatchJob], BatchResult]
) -> Iterator[BatchResult]:
    futures = client.map(work, jobs, pure=False)
    names = {future.key: job.recording.name for future, job in zip(futures, jobs, strict=True)}
    for future in as_completed(futures):
        error = future.exception()
        if error is None:
            yield future.result()
        else:
            problem = " ".join(f"{type(error).__name__}: {error}".split())
            yield BatchResult(names[future.key], problem=problem)


def pooled(results: Iterable[BatchResult]) -> tuple[SourceTotals, ...]:
    """Return the totals of all recordings together, for each run and source."""
    groups: dict[tuple[str, str], list[SourceTotals]] = {}
    for result in results:
        for totals in result.totals:
            groups.setdefault((totals.run, totals.source), []).append(totals)
    return tuple(
        SourceTotals(
            run,
            source,
            np.concatenate([totals.offsets for totals in group]),
            np.concatenate([totals.nees for totals in group]),
            sum(totals.shots for totals in group),
            sum(totals.visible for totals in group),
            sum(totals.false for totals in group),
        )
        for (run, source), group in groups.items()
    )


def _totals_document(totals: SourceTotals, requirement: Requirement) -> dict[str, Any]:
    """Return the numbers of one source: lengths in metres, the yaw in degrees."""
    found = clopper_pearson(len(totals.offsets), totals.visible, requirement.confidence)
    nees = chi_square_check(totals.nees, 4)
    errors: dict[str, Any] = {}
    for column, name in enumerate(COMPONENTS):
        scale, unit = (180 / np.pi, "deg") if name == "yaw" else (1.0, "m")
        values = spread(scale * totals.offsets[:, column])
        errors[f"{name}_{unit}"] = None if values is None else _numbers(values.bias, values.median, values.p95)
    return {
        "run": totals.run,
        "source": totals.source,
        "shots": totals.shots,
        "found": found.successes,
        "visible": found.trials,
        "recall": {"share": found.value, "low": found.low, "high": found.high},
        "false": totals.false,
        "errors": errors,
        "nees_mean": nees.mean,
        "requirement": check_document(check_requirement(totals.offsets, requirement)),
    }


def _numbers(bias: float, median: float, p95: float) -> dict[str, float]:
    return {"bias": bias, "median": median, "p95": p95}


def batch_document(folder: Path, results: Sequence[BatchResult], settings: Settings) -> dict[str, Any]:
    """Return the document about all recordings; `docs/evaluation.md` describes its keys."""
    asked = settings.requirement
    ordered = sorted(results, key=lambda result: result.name)
    return {
        "format": 1,
        "batch": folder.resolve().name,
        "recordings": [
            {
                "name": result.name,
                "problem": result.problem or None,
                "sources": [_totals_document(totals, asked) for totals in result.totals],
            }
            for result in ordered
        ],
        "overall": [_totals_document(totals, asked) for totals in pooled(ordered)],
    }
