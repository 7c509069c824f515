"""What a second worker gives when many recordings are evaluated: times by the wall clock, not of the processor."""

from __future__ import annotations

import shutil
from collections.abc import Iterator, Sequence
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from time import perf_counter

import numpy as np

from benchmarks.tables import Column, Section, Value
from palletloc.evaluation.batch import BatchJob, evaluate_in_parallel
from palletloc.evaluation.run import Settings
from palletloc.geometry import LevelPose, level_pose
from palletloc.io.csv_table import write_rows
from palletloc.io.measurements import format_time, write_measurements
from palletloc.io.recording import SHOT_COLUMNS, read_recording
from palletloc.io.truth import Truth, read_truth, write_truth
from palletloc.measurement import PalletMeasurement, YawSource
from palletloc.trajectory import Trajectory

RECORDINGS, SHOTS = 100, 60
"""How many evaluations there are, and how many shots each recording has: an approach of 6 s at 10 Hz."""
GOAL = 0.6
"""Time of two workers in parts of that of one."""
_COLUMNS = (Column("what"), Column("median", 2), Column("unit"), Column("ratio", 2), Column("goal", 2))


def measure_evaluation(recording: Path, rounds: int) -> list[Section]:
    """Measure how long the metrics of many recordings take with one worker and with two.

    Parameters
    ----------
    recording : Path
        With truth. A copy with more shots, without images, is evaluated again and again.
    rounds : int
        How often everything is timed, in turns.

    Returns
    -------
    list of Section
        One table: whole times, with starting and ending the workers, and those from the first result to the last.
    """
    with TemporaryDirectory() as folder:
        copy = Path(folder) / "recording"
        _write_longer(recording, copy)
        _write_run(copy, copy / "run")
        jobs = [BatchJob(copy, ("run",), Path(folder) / str(number), Settings()) for number in range(RECORDINGS)]
        pairs = [(_times(jobs, 1), _times(jobs, 2)) for _ in range(rounds)]
    return [Section("Evaluation in parallel", _COLUMNS, tuple(_rows(pairs)))]


def _rows(pairs: Sequence[tuple[tuple[float, float], tuple[float, float]]]) -> Iterator[tuple[Value, ...]]:
    for number, what in enumerate(("start and end included", "first to last result")):
        chosen = [(alone[number], shared[number]) for alone, shared in pairs]
        times = [median(some) for some in zip(*chosen, strict=True)]
        ratio = median(shared / alone for alone, shared in chosen)
        yield (f"{RECORDINGS} recordings, one worker, {what}", times[0], "s", 1.0, None)
        yield (f"{RECORDINGS} recordings, two workers, {what}", times[1], "s", ratio, GOAL)


def _times(jobs: Sequence[BatchJob], workers: int) -> tuple[float, float]:
    """Return how long it takes as a whole, and from the first result to the last."""
    begin, arrivals = perf_counter(), []
    for result in evaluate_in_parallel(jobs, workers):
        arrivals.append(perf_counter())
        if result.problem:
            raise RuntimeError(result.problem)
    return perf_counter() - begin, arrivals[-1] - arrivals[0]


def _write_longer(recording: Path, folder: Path) -> None:
    """Write a copy without images that has more shots along the same path, each with its truth."""
    shutil.copytree(recording, folder, ignore=shutil.ignore_patterns("images", "survey*"))
    truth = read_truth(recording)
    start, end = truth.forklift.span
    times = np.linspace(start, end, SHOTS).round(6)
    poses = [truth.forklift.pose_at(min(float(time), end)) for time in times]
    x, y, z, yaw = np.array([pose.as_array() for pose in poses]).T
    write_truth(folder, Truth(Trajectory(times, x, y, yaw, z), truth.pallets))
    files = ([format_time(float(time)), f"images/{number:06}.jpg"] for number, time in enumerate(times))
    write_rows(folder / "shots.csv", SHOT_COLUMNS, files)


def _write_run(recording: Path, folder: Path) -> None:
    """Write a run that finds every pallet in every shot, 3 mm too deep."""
    truth, rows = read_truth(recording), []
    for shot in read_recording(recording).shots:
        forklift_from_world = truth.forklift.pose_at(shot.time).transform().inv()
        for pallet in truth.pallets:
            off = LevelPose(0.003, 0.0, 0.0, 0.0).transform()
            pose = level_pose(forklift_from_world * pallet.world_from_pallet.transform() * off)
            covariance = 1e-5 * np.eye(4)
            rows.append(PalletMeasurement(shot.time, pallet.model, pose, covariance, 0.9, YawSource.FACE, shot.file))
    folder.mkdir()
    write_measurements(folder / "measurements.csv", rows)
