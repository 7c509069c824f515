"""The files of a run over a recording: tracks.csv, one path per track in TUM form, and events.csv."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from palletloc.geometry import LevelPose
from palletloc.io.atomic import cannot_write, write_text
from palletloc.io.csv_table import Row, format_number, read_rows, write_rows
from palletloc.io.measurements import format_time
from palletloc.io.tracks import TRACKS, TrackRow, read_count
from tracking.events import Event, EventKind
from tracking.track_state import TrackState

PATHS, EVENTS, FIGURE = "tracks", "events.csv", "tracks.png"
"""Names of what a run writes beside tracks.csv: the folder of the paths, what became of every input, a picture."""
SMOOTHED_TRACKS, SMOOTHED_PATHS = "tracks_smoothed.csv", "tracks_smoothed"
"""The same table and folder from the smoother."""
EVENT_COLUMNS = ("time_s", "event", "track", "distance", "limit", "age_s", "window_s", "revised", "reason")
"""Header of events.csv."""

_FLAGS = {"no": False, "yes": True}
"""Words of the column ``revised``."""


def track_row(state: TrackState) -> TrackRow:
    """Return the row of a tracker's answer."""
    return TrackRow(
        state.time, state.track, state.model, state.status, state.pose, state.covariance, state.age, state.hits
    )


def write_events(path: Path, events: Iterable[Event]) -> None:
    """Write events.csv, whole or not at all; a time that is not finite is left empty.

    Raises
    ------
    OutputError
        If it cannot be written.
    """
    write_rows(path, EVENT_COLUMNS, (_event_cells(event) for event in events))


def _event_cells(event: Event) -> list[str]:
    return [
        format_time(event.time) if math.isfinite(event.time) else "",
        str(event.kind),
        "" if event.track is None else str(event.track),
        *(_optional(value) for value in (event.distance, event.limit, event.age, event.window)),
        "yes" if event.revised else "no",
        event.reason,
    ]


def _optional(value: float | None) -> str:
    return "" if value is None or not math.isfinite(value) else format_number(value)


def read_events(path: str | Path) -> tuple[Event, ...]:
    """Read events.csv.

    Raises
    ------
    InputError
        If the file cannot be read or a row is wrong; names the line.
    """
    return tuple(_event(row) for row in read_rows(Path(path), EVENT_COLUMNS))


def _event(row: Row) -> Event:
    columns = ("distance", "limit", "age_s", "window_s")
    distance, limit, age, window = (row.number(name) if row.cells[name] else None for name in columns)
    if row.cells["revised"] not in _FLAGS:
        raise row.fault(f"revised: expected yes or no, got {row.cells['revised']!r}")
    return Event(
        row.choice("event", EventKind),
        row.number("time_s") if row.cells["time_s"] else math.nan,
        read_count(row, "track") if row.cells["track"] else None,
        distance,
        limit,
        age,
        window,
        row.cells["reason"],
        _FLAGS[row.cells["revised"]],
    )


@dataclass(frozen=True, slots=True)
class PathPoint:
    """A pallet in the odometry's frame at some time."""

    track: int
    """Number of the track."""
    time: float
    """In seconds."""
    odom_from_pallet: LevelPose
    """Its pose."""


def write_paths(folder: Path, points: Sequence[PathPoint]) -> None:
    """Write one file ``ID.tum`` per track, each whole or not at all.

    Parameters
    ----------
    folder : Path
        Made if missing and needed.
    points : sequence of PathPoint
        In the order of time.

    Raises
    ------
    OutputError
        If a file cannot be written.
    """
    for number in sorted({point.track for point in points}):
        lines = [_tum_line(point) for point in points if point.track == number]
        write_text(folder / f"{number}.tum", "".join(lines))


def remove_run(folder: Path) -> None:
    """Remove what an earlier run wrote to a folder; measurements and all other files stay.

    Raises
    ------
    OutputError
        If that is not possible.
    """
    for name in (TRACKS, SMOOTHED_TRACKS, EVENTS, FIGURE):
        try:
            (folder / name).unlink(missing_ok=True)
        except OSError as error:
            raise cannot_write(folder / name, error) from error
    for name in (PATHS, SMOOTHED_PATHS):
        _remove_paths(folder / name)


def _remove_paths(folder: Path) -> None:
    """Remove the files ``ID.tum`` in a folder, and the folder if nothing is left in it."""
    if not folder.is_dir():
        return
    try:
        for path in folder.iterdir():
            if re.fullmatch(r"\d+\.tum", path.name):
                path.unlink(missing_ok=True)
        if not any(folder.iterdir()):
            folder.rmdir()
    except OSError as error:
        raise cannot_write(folder, error) from error


def _tum_line(point: PathPoint) -> str:
    """Return ``time x y z qx qy qz qw``; of the two quaternions of a turn about z the one with qw >= 0."""
    pose = point.odom_from_pallet
    half = np.arctan2(np.sin(pose.yaw), np.cos(pose.yaw)) / 2
    place = " ".join(format_number(value) for value in (pose.x, pose.y, pose.z))
    turn = " ".join(format_number(float(value), 9) for value in (0.0, 0.0, np.sin(half), np.cos(half)))
    return f"{format_time(point.time)} {place} {turn}\n"
