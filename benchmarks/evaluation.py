"""What a second worker gives when many recordings are evaluated: times by the wall clock, not of the processor."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from time import perf_counter

import numpy as np

from benchmarks.tables import Column, Section
from palletloc.evaluation.batch import BatchJob
from palletloc.evaluation.cluster import evaluate_in_parallel
from palletloc.evaluation.evaluated_run import Settings
from palletloc.geometry import LevelPose, level_pose
from palletloc.io.measurements import write_measurements
from palletloc.io.recording import read_recording
from palletloc.io.truth import read_truth
from palletloc.measurement import PalletMeasurement, YawSource

RECORDINGS = 100
"""How many evaluations there are."""
GOAL = 0.6
"""Time of two workers in parts of that of one."""
_COLUMNS = (Column("what"), Column("median", 2), Column("unit"), Column("ratio", 2), Column("goal", 2))


def measure_evaluation(recording: Path, rounds: int) -> list[Section]:
    """Measure how long the metrics of many recordings take with one worker and with two.

    Parameters
    ----------
    recording : Path
        With truth; it is evaluated again and again.
    rounds : int
        How often everything is timed, in turns.

    Returns
    -------
    list of Section
        One table. The time runs from the first result to the last: starting and ending the workers plays no part.
    """
    with TemporaryDirectory() as folder:
        _write_run(recording, Path(folder) / "run")
        name = str(Path(folder) / "run")
        jobs = [
            BatchJob(recording.resolve(), (name,), Path(folder) / str(number), Settings())
            for number in range(RECORDINGS)
        ]
        pairs = [(_time(jobs, 1), _time(jobs, 2)) for _ in range(rounds)]
    one, two = (median(times) for times in zip(*pairs, strict=True))
    ratio = median(second / first for first, second in pairs)
    rows = (
        (f"{RECORDINGS} recordings, one worker", one, "s", 1.0, None),
        (f"{RECORDINGS} recordings, two workers", two, "s", ratio, GOAL),
    )
    return [Section("Evaluation in parallel", _COLUMNS, rows)]


def _time(jobs: Sequence[BatchJob], workers: int) -> float:
    results = evaluate_in_parallel(jobs, workers)
    next(results)
    started = last = perf_counter()
    for result in results:
        last = perf_counter()
        if result.problem:
            raise RuntimeError(result.problem)
    return last - started


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
