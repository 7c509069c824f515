"""The truth beside a recording: where the forklift and the pallets really were."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from palletloc.geometry import LevelPose, wrap_angle
from palletloc.io.csv_table import TableError, format_number, in_order_of_time, read_rows, shortened, write_rows
from palletloc.io.measurements import POSE_COLUMNS, format_time, read_pose
from palletloc.io.reading import InputError, read_text
from palletloc.trajectory import Trajectory

_FORKLIFT_COLUMNS = ("time_s", *POSE_COLUMNS)
"""Header of truth/forklift.csv."""
_PALLET_COLUMNS = ("id", "model", *POSE_COLUMNS)
"""Header of truth/pallets.csv."""
_MAX_TILT_DEG = 5.0
"""Tilt beyond which a pose is not that of a vehicle on a floor, in degrees."""
_TUM_COLUMNS = "time x y z qx qy qz qw"
"""Of a line in TUM form: seconds, metres, a quaternion with its scalar last."""


@dataclass(frozen=True, slots=True)
class TruePallet:
    """A pallet of the scene."""

    id: str
    """Its name in the scene."""
    model: str
    """Name of its model."""
    world_from_pallet: LevelPose
    """Where it stands."""


@dataclass(frozen=True, slots=True)
class Truth:
    """What a measurement is compared with."""

    forklift: Trajectory
    """``world_from_forklift`` over time."""
    pallets: tuple[TruePallet, ...]
    """The pallets of the scene."""


def path_file(folder: Path) -> Path | None:
    """Return the file with the forklift's true path; None where a survey at stops may be all there is."""
    files = (folder / "truth" / name for name in ("forklift.csv", "forklift.tum"))
    return next((file for file in files if file.exists()), None)


def read_truth(folder: str | Path) -> Truth:
    """Read the truth of a recording.

    Parameters
    ----------
    folder : str or Path
        The recording.

    Returns
    -------
    Truth
        From its files truth/forklift.csv, or truth/forklift.tum in its place, and truth/pallets.csv.

    Raises
    ------
    InputError
        If a file is missing or wrong; names the line.
    """
    truth = Path(folder) / "truth"
    if not truth.is_dir():
        raise InputError(f"{truth}: no such folder; expected forklift.csv and pallets.csv in it")
    file = path_file(Path(folder)) or truth / "forklift.csv"
    path = read_tum(file) if file.suffix == ".tum" else _read_forklift(file)
    return Truth(path, read_pallets(truth / "pallets.csv"))


def _read_forklift(path: Path) -> Trajectory:
    rows = [row.numbers(_FORKLIFT_COLUMNS) for row in in_order_of_time(read_rows(path, _FORKLIFT_COLUMNS))]
    if not rows:
        raise TableError(f"{path}: has no rows; expected at least one pose")
    times, x, y, z, yaw = np.array(rows).T
    return Trajectory(times=times, x=x, y=y, yaw=yaw, z=z)


def read_pallets(path: Path) -> tuple[TruePallet, ...]:
    """Read truth/pallets.csv.

    Raises
    ------
    InputError
        If it is missing or wrong; names the line.
    """
    lines: dict[str, int] = {}
    pallets = []
    for row in read_rows(path, _PALLET_COLUMNS):
        name = row.text("id")
        if name in lines:
            raise row.fault(f"id: '{name}' stands in line {lines[name]} already; expected different names")
        lines[name] = row.line
        pose = read_pose(row)
        if abs(pose.yaw) > 2 * np.pi:
            raise row.fault(f"yaw_rad: expected radians, within a whole turn, got {pose.yaw:g}")
        pallets.append(TruePallet(name, row.text("model"), pose))
    return tuple(pallets)


def write_truth(folder: Path, truth: Truth) -> None:
    """Write the truth of a recording, each file whole or not at all.

    Parameters
    ----------
    folder : Path
        The recording; its folder ``truth`` is made.
    truth : Truth
        What `read_truth` reads back, to six decimals.

    Raises
    ------
    OutputError
        If a file cannot be written.
    """
    path = truth.forklift
    poses = ([format_time(float(time)), *_pose_cells(path.pose_at(float(time)))] for time in path.times)
    write_rows(folder / "truth" / "forklift.csv", _FORKLIFT_COLUMNS, poses)
    pallets = ([pallet.id, pallet.model, *_pose_cells(pallet.world_from_pallet)] for pallet in truth.pallets)
    write_rows(folder / "truth" / "pallets.csv", _PALLET_COLUMNS, pallets)


def _pose_cells(pose: LevelPose) -> list[str]:
    return [format_number(value) for value in (pose.x, pose.y, pose.z, wrap_angle(pose.yaw))]


def read_tum(path: Path) -> Trajectory:
    """Read a trajectory in TUM form and keep its level part.

    Parameters
    ----------
    path : Path
        The file; lines that start with ``#`` and empty ones are comments.

    Returns
    -------
    Trajectory
        Position and heading over time.

    Raises
    ------
    InputError
        If the file cannot be read.
    TableError
        If a line is wrong, a pose is tilted, or the times do not increase; names the line.
    """
    rows: list[tuple[int, list[float]]] = []
    for number, line in enumerate(read_text(path).splitlines(), start=1):
        if line.strip() and not line.lstrip().startswith("#"):
            row = _tum_pose(path, number, line)
            if rows and row[0] <= rows[-1][1][0]:
                raise TableError(
                    f"{path}, line {number}: the time {row[0]:.9g} does not follow {rows[-1][1][0]:.9g}"
                    f" of line {rows[-1][0]}; expected strictly increasing times"
                )
            rows.append((number, row))
    if not rows:
        raise TableError(f"{path}: has no poses; expected lines '{_TUM_COLUMNS}'")
    times, x, y, z, yaw = np.array([row for _, row in rows]).T
    return Trajectory(times=times, x=x, y=y, yaw=yaw, z=z)


def _tum_pose(path: Path, number: int, line: str) -> list[float]:
    """Return time, x, y, z and yaw."""
    try:
        values = [float(part) for part in line.split()]
    except ValueError:
        values = []
    if len(values) != 8 or not all(math.isfinite(value) for value in values):
        raise TableError(
            f"{path}, line {number}: expected eight numbers '{_TUM_COLUMNS}', got {shortened(line.strip())}"
        )
    quaternion = np.array(values[4:])
    norm = float(np.linalg.norm(quaternion))
    if abs(norm - 1) > 0.01:
        raise TableError(f"{path}, line {number}: expected a quaternion of length 1, got {norm:.3g}")
    qx, qy, qz, qw = quaternion / norm
    tilt = math.degrees(2 * math.asin(min(1.0, math.hypot(qx, qy))))
    if tilt > _MAX_TILT_DEG:
        raise TableError(
            f"{path}, line {number}: the pose is tilted by {tilt:.1f} degrees, expected at most {_MAX_TILT_DEG:.0f}:"
            " z up, and the scalar of the quaternion last"
        )
    return [*values[:4], math.atan2(2 * (qw * qz + qx * qy), 1 - 2 * (qy**2 + qz**2))]
