"""The truth beside a recording: where the forklift and the pallets really were."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from palletloc.geometry import LevelPose, wrap_angle
from palletloc.io.csv_table import format_number, read_rows, write_rows
from palletloc.io.measurements import POSE_COLUMNS, format_time, read_pose
from palletloc.io.path_file import read_path
from palletloc.io.path_frame import PathForm
from palletloc.io.reading import InputError
from palletloc.trajectory import Trajectory

_FORKLIFT_COLUMNS = ("time_s", *POSE_COLUMNS)
"""Header of truth/forklift.csv."""
_PALLET_COLUMNS = ("id", "model", *POSE_COLUMNS)
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
    notes: tuple[str, ...] = ()
    """What was dropped or assumed when the files were read, one line each."""


def path_file(folder: Path) -> Path | None:
    """Return the file with the forklift's true path; None where a survey at stops may be all there is."""
    files = (folder / "truth" / name for name in ("forklift.csv", "forklift.tum"))
    return next((file for file in files if file.exists()), None)


def read_truth(folder: str | Path, form: PathForm | None = None) -> Truth:
    """Read the truth of a recording.

    Parameters
    ----------
    folder : str or Path
        The recording.
    form : PathForm, optional
        What the file of the path cannot say itself.

    Returns
    -------
    Truth
        From its files truth/forklift.csv, or truth/forklift.tum in its place, and truth/pallets.csv. The path may
        have any form that `palletloc.io.path_file.read_path` reads, under either name.

    Raises
    ------
    InputError
        If a file is missing or wrong; names the line.
    """
    truth = Path(folder) / "truth"
    if not truth.is_dir():
        raise InputError(f"{truth}: no such folder; expected forklift.csv and pallets.csv in it")
    file = path_file(Path(folder)) or truth / "forklift.csv"
    path = read_path(file, _FORKLIFT_COLUMNS, form=form)
    return Truth(path.trajectory, read_pallets(truth / "pallets.csv"), path.notes)


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
    """Read a trajectory in TUM form, or any other that `palletloc.io.path_file.read_path` reads."""
    return read_path(path, _FORKLIFT_COLUMNS).trajectory
