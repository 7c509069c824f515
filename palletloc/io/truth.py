"""The truth beside a recording: where the forklift and the pallets really were."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from palletloc.geometry import LevelPose, wrap_angle
from palletloc.io.csv_table import TableError, format_number, in_order_of_time, read_rows, write_rows
from palletloc.io.measurements import POSE_COLUMNS, format_time, read_pose
from palletloc.io.reading import InputError
from palletloc.io.tum import read_tum
from palletloc.trajectory import Trajectory

FORKLIFT_COLUMNS = ("time_s", *POSE_COLUMNS)
"""Header of truth/forklift.csv."""
PALLET_COLUMNS = ("id", "model", *POSE_COLUMNS)
"""Header of truth/pallets.csv."""


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
    rows = [row.numbers(FORKLIFT_COLUMNS) for row in in_order_of_time(read_rows(path, FORKLIFT_COLUMNS))]
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
    for row in read_rows(path, PALLET_COLUMNS):
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
    write_rows(folder / "truth" / "forklift.csv", FORKLIFT_COLUMNS, poses)
    pallets = ([pallet.id, pallet.model, *_pose_cells(pallet.world_from_pallet)] for pallet in truth.pallets)
    write_rows(folder / "truth" / "pallets.csv", PALLET_COLUMNS, pallets)


def _pose_cells(pose: LevelPose) -> list[str]:
    return [format_number(value) for value in (pose.x, pose.y, pose.z, wrap_angle(pose.yaw))]
