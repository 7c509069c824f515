"""How accurate the methods are, on recordings with truth."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import track

from benchmarks.run_parts import FAR_BELOW, between, match_recording
from benchmarks.tables import Column, Section, Value
from palletloc.choices import Method
from palletloc.evaluation.breakdown import spreads
from palletloc.evaluation.run_match import ShotMatch, detection
from palletloc.evaluation.statistics import Spread
from palletloc.io.atomic import write_bytes
from palletloc.io.recording import Recording
from palletloc.io.truth import Truth, read_truth
from palletloc.measurement import PalletMeasurement
from palletloc.recording_run import Job, read_job

PARTS = {f"{FAR_BELOW} m or more below": (FAR_BELOW, math.inf), "other heights": (-math.inf, FAR_BELOW)}
"""Least and greatest height of the camera above the pallets' lower edges, in metres."""
ORDER = (Method.PAPER, Method.HORIZONTAL_PLANE, Method.JOINT_SEARCH, Method.REFINED)
"""The methods from the paper's on, in tables and figures."""

_COLUMNS = (
    Column("pallets"),
    Column("method"),
    Column("views"),
    Column("recall", 3),
    Column("false/shot", 2),
    Column("yaw deg", 2),
    Column("depth mm"),
    Column("along mm"),
    Column("height mm"),
    Column("NEES", 1),
)


def measure_accuracy(folders: Sequence[Path], console: Console, figures: Path | None = None) -> list[Section]:
    """Compare the methods on recordings.

    Parameters
    ----------
    folders : sequence of Path
        The recordings, with truth.
    console : Console
        Shows progress.
    figures : Path, optional
        Gets ``methods_RECORDING.png`` for each recording; made if missing.

    Returns
    -------
    list of Section
        A table for each recording.

    Raises
    ------
    PalletLocError
        If a recording or its truth cannot be read, or a figure cannot be written.
    """
    return [_section(folder, read_truth(folder), console, figures) for folder in folders]


def _section(folder: Path, truth: Truth, console: Console, figures: Path | None) -> Section:
    jobs = {method: read_job(folder, method) for method in ORDER}
    runs = {method: _measured(job, f"{folder.name}, {method}", console) for method, job in jobs.items()}
    recording = jobs[Method.PAPER].recording
    height = float(recording.forklift_from_camera.translation[2])
    shots = {method: match_recording(recording, truth, measured).shots for method, measured in runs.items()}
    if figures is not None:
        _draw(recording, truth, runs, figures)
    rows = [
        _row(part, method, [between(shot, *heights, height) for shot in shots[method]])
        for part, heights in PARTS.items()
        for method in ORDER
    ]
    note = f"{len(shots[Method.PAPER])} shots; errors as median / 95 % / largest of the absolute values."
    return Section(f"Accuracy on {folder.name}", _COLUMNS, tuple(rows), note)


def _measured(job: Job, label: str, console: Console) -> list[PalletMeasurement]:
    measured: list[PalletMeasurement] = []
    quiet = not console.is_terminal
    for number in track(range(len(job.shots)), label, console=console, transient=True, disable=quiet):
        measured += job.explain(number).measurements
    return measured


def _draw(
    recording: Recording, truth: Truth, runs: Mapping[Method, Sequence[PalletMeasurement]], figures: Path
) -> None:
    from benchmarks.method_figure import method_figure  # drawing is slow to import
    from palletloc.drawing.canvas import small_png

    figure = method_figure(recording, truth, {str(method): measured for method, measured in runs.items()})
    write_bytes(figures / f"methods_{recording.folder.name}.png", small_png(figure))


def _row(part: str, method: Method, shots: Sequence[ShotMatch]) -> tuple[Value, ...]:
    errors = [error for shot in shots for error in shot.errors]
    found, sizes = detection(shots), spreads(errors)
    return (
        part,
        str(method),
        found.found.trials,
        found.recall,
        found.false_per_shot,
        _triple(sizes.yaw, float(np.degrees(1))),
        _triple(sizes.depth, 1e3),
        _triple(sizes.along, 1e3),
        _triple(sizes.height, 1e3),
        float(np.mean([error.nees for error in errors])) if errors else math.nan,
    )


def _triple(spread: Spread | None, unit: float) -> tuple[float, ...] | None:
    if spread is None:
        return None
    return spread.median * unit, spread.p95 * unit, spread.maximum * unit
