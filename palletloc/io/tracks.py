"""The file tracks.csv: every live track at the time of every shot."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from palletloc.geometry import FloatArray, LevelPose
from palletloc.io.csv_table import Row, format_number, read_rows, write_rows
from palletloc.io.measurements import (
    COVARIANCE_COLUMNS,
    POSE_COLUMNS,
    format_time,
    pose_cells,
    read_covariance,
    read_pose,
)
from palletloc.io.odometry_check import in_seconds
from palletloc.track_status import Status

TRACKS = "tracks.csv"
"""Name of the file in the folder of a run."""
TRACK_COLUMNS = ("time_s", "track", "model", "state", *POSE_COLUMNS, *COVARIANCE_COLUMNS, "age_s", "hits")
"""Header of tracks.csv."""


@dataclass(frozen=True, slots=True, eq=False)
class TrackRow:
    """A pallet at the time of a shot: a row of tracks.csv."""

    time: float
    """Of the shot, in seconds."""
    track: int
    """Number of the track."""
    model: str
    """Name of the pallet model."""
    status: Status
    """How much the track is believed."""
    pose: LevelPose
    """``forklift_from_pallet`` at that time."""
    covariance: FloatArray
    """(4, 4) covariance of (x, y, z, yaw), in metres and radians."""
    age: float
    """Time since the last measurement, in seconds."""
    hits: int
    """How many measurements the track is made of."""


def write_tracks(path: Path, rows: Iterable[TrackRow]) -> None:
    """Write tracks.csv; errors as for `write_measurements`."""
    write_rows(path, TRACK_COLUMNS, (_track_cells(row) for row in rows))


def _track_cells(row: TrackRow) -> list[str]:
    cells = [format_time(row.time), str(row.track), row.model, str(row.status)]
    return [*cells, *pose_cells(row.pose, row.covariance), format_number(row.age), str(row.hits)]


def read_tracks(path: str | Path) -> tuple[TrackRow, ...]:
    """Read tracks.csv.

    Parameters
    ----------
    path : str or Path
        The file, or one of the smoother's.

    Returns
    -------
    tuple of TrackRow
        In the file's order.

    Raises
    ------
    InputError
        If the file cannot be read or a row is wrong; names the line.
    """
    return tuple(_track(row) for row in in_seconds(read_rows(Path(path), TRACK_COLUMNS)))


def _track(row: Row) -> TrackRow:
    age = row.number("age_s")
    if age < 0:
        raise row.fault(f"age_s: expected a time since the last measurement, got {age:g}")
    return TrackRow(
        row.number("time_s"),
        read_count(row, "track"),
        row.text("model"),
        row.choice("state", Status),
        read_pose(row),
        read_covariance(row),
        age,
        read_count(row, "hits"),
    )


def read_count(row: Row, column: str) -> int:
    """Return a whole number from 1 on.

    Raises
    ------
    TableError
        If the cell holds anything else.
    """
    value = row.number(column)
    if value < 1 or value != int(value):
        raise row.fault(f"{column}: expected a whole number from 1 on, got {row.cells[column]!r}")
    return int(value)
