"""Given starts, which take the place of detection: the file that ``--initial`` names."""

from __future__ import annotations

from bisect import bisect
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path

from palletloc.errors import seconds
from palletloc.io.csv_table import Row, read_rows
from palletloc.io.measurements import POSE_COLUMNS, read_pose
from palletloc.io.odometry_check import in_seconds
from palletloc.io.recording import ShotFile
from palletloc.localizer import Start

START_COLUMNS = ("time_s", "model", *POSE_COLUMNS)
"""Header of the file."""
TIME_TOLERANCE = 5e-4
"""How far a start's time may be from that of its shot, in seconds."""


@dataclass(frozen=True, slots=True)
class ShotStarts:
    """The starts of one shot that stand together in the file."""

    shot: ShotFile
    """The shot that their times mean."""
    starts: tuple[Start, ...]
    """In the file's order."""


def read_starts(path: Path, shots: Sequence[ShotFile]) -> tuple[ShotStarts, ...]:
    """Read the starts of a recording's shots.

    Parameters
    ----------
    path : Path
        A csv file with the columns `START_COLUMNS`, poses in the forklift frame, in any order.
    shots : sequence of ShotFile
        Those of the recording, in order of time.

    Returns
    -------
    tuple of ShotStarts
        In the file's order, neighbours of the same shot together: a shot that the file comes back to
        is there again.

    Raises
    ------
    InputError
        If the file cannot be read, a row is wrong or its time is that of no shot; names the line.
    """
    pairs = _pairs(path, shots)
    return tuple(
        ShotStarts(shot, tuple(start for _, start in group))
        for shot, group in groupby(pairs, key=lambda pair: pair[0])
    )


def _pairs(path: Path, shots: Sequence[ShotFile]) -> Iterator[tuple[ShotFile, Start]]:
    times = [shot.time for shot in shots]
    for row in in_seconds(read_rows(path, START_COLUMNS)):
        yield _shot_of(row, shots, times), Start(row.text("model"), read_pose(row))


def _shot_of(row: Row, shots: Sequence[ShotFile], times: Sequence[float]) -> ShotFile:
    time = row.number("time_s")
    after = bisect(times, time)
    nearest = min(shots[max(after - 1, 0) : after + 1], key=lambda shot: abs(shot.time - time))
    if abs(nearest.time - time) > TIME_TOLERANCE:
        at, there = seconds(time, nearest.time)
        raise row.fault(f"time_s: no shot at {at} s; the nearest is at {there} s")
    return nearest
