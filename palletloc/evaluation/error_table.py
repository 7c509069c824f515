"""The file errors.csv: every estimate of a pallet minus the truth."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np

from palletloc.evaluation.estimate_error import EstimateError
from palletloc.evaluation.evaluated_run import EvaluatedRun
from palletloc.io.csv_table import format_number, write_rows
from palletloc.io.measurements import format_time

ERRORS = "errors.csv"
"""Name of the file."""
ERROR_COLUMNS = (
    *("run", "source", "truth", "time_s", "file", "track", "state", "pallet", "model", "counted", "range_m"),
    *("depth_m", "along_m", "height_m", "yaw_rad"),
    *("sigma_depth_m", "sigma_along_m", "sigma_height_m", "sigma_yaw_rad", "nees"),
)
"""Its header."""


def write_errors(path: Path, runs: Iterable[EvaluatedRun], truth: str) -> None:
    """Write errors.csv, whole or not at all.

    Parameters
    ----------
    path : Path
        The file.
    runs : iterable of EvaluatedRun
        Of one recording.
    truth : str
        ``path`` or ``survey``: what the shots were held against. Rows of surveyed stops follow in addition.

    Raises
    ------
    OutputError
        If it cannot be written.
    """
    write_rows(path, ERROR_COLUMNS, (row for run in runs for row in _rows(run, truth)))


def _rows(run: EvaluatedRun, truth: str) -> Iterator[list[str]]:
    for name, source in run.sources.items():
        for shot in source.shots:
            for one in shot.errors:
                yield _cells(run.files.name, name, truth, one, counted=True)
            for one in shot.beyond:
                yield _cells(run.files.name, name, truth, one, counted=False)
        if truth == "survey":
            continue
        for stop in source.stops:
            for one in stop.errors:
                yield _cells(run.files.name, name, "survey", one, counted=False)


def _cells(run: str, source: str, truth: str, one: EstimateError, *, counted: bool) -> list[str]:
    estimate, face = one.estimate, one.error.face
    sigma = np.sqrt(np.diag(one.covariance))
    nees = one.nees_with_truth
    texts = [run, source, truth, format_time(one.time), estimate.file, estimate.track, estimate.state]
    texts += [face.id, estimate.model, "yes" if counted else "no"]
    numbers = [format_number(float(value)) for value in (face.range, *one.offset, *sigma)]
    return [*texts, *numbers, format_number(nees) if np.isfinite(nees) else ""]
