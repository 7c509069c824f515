"""The csv files of a localization: measurements.csv and refusals.csv."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import combinations_with_replacement
from pathlib import Path

import numpy as np

from palletloc.geometry import FloatArray, LevelPose
from palletloc.io.csv_table import Row, format_number, read_rows, write_rows
from palletloc.io.odometry_check import in_seconds
from palletloc.measurement import PalletMeasurement, Reason, RefusedCandidate, Stage, YawSource, covariance_fault

POSE_COLUMNS = ("x_m", "y_m", "z_m", "yaw_rad")
"""A level pose."""
COVARIANCE_COLUMNS = tuple(f"cov_{first}{second}" for first, second in combinations_with_replacement("xyzw", 2))
"""The upper triangle of the covariance of (x, y, z, yaw), row by row; ``w`` is the yaw."""
MEASUREMENT_COLUMNS = ("time_s", "file", "model", *POSE_COLUMNS, *COVARIANCE_COLUMNS, "score", "yaw_from")
"""Header of measurements.csv."""
REFUSAL_COLUMNS = ("time_s", "file", "model", "stage", "reason")
"""Header of refusals.csv."""

_RESULT_COLUMNS = MEASUREMENT_COLUMNS[3:]
"""Empty where a start led to no pose."""
_UPPER = np.triu_indices(4)
"""Rows and columns of the covariance's upper triangle, in the order of its columns."""


@dataclass(frozen=True, slots=True)
class NoPose:
    """The row of a given start from which no pallet was found: a measurement with empty cells."""

    time: float
    """When the shot was exposed, in seconds."""
    model: str
    """Name of the pallet model, as the start gives it."""
    file: str = ""
    """The shot's image, as the recording names it."""


def measurement_cells(measured: PalletMeasurement | NoPose) -> list[str]:
    """Return the cells of a row of measurements.csv.

    Metres and radians have six decimals, the covariance seven digits, the time all of its digits.

    Raises
    ------
    ValueError
        If a value is not finite.
    """
    cells = [format_time(measured.time), measured.file, measured.model]
    if isinstance(measured, NoPose):
        return cells + [""] * len(_RESULT_COLUMNS)
    cells += pose_cells(measured.forklift_from_pallet, measured.covariance)
    return [*cells, format_number(measured.score, 4), str(measured.yaw_from)]


def pose_cells(pose: LevelPose, covariance: FloatArray) -> list[str]:
    """Return the cells of `POSE_COLUMNS` and `COVARIANCE_COLUMNS`; errors as for `format_number`."""
    if not np.isfinite(covariance).all():
        raise ValueError(f"expected a finite covariance to write, got {covariance}")
    cells = [format_number(float(value)) for value in pose.as_array()]
    return cells + [f"{value + 0.0:.6e}" for value in covariance[_UPPER]]


def refusal_cells(refusal: RefusedCandidate) -> list[str]:
    """Return the cells of a row of refusals.csv."""
    return [format_time(refusal.time), refusal.file, refusal.model, str(refusal.stage), str(refusal.reason)]


def format_time(time: float) -> str:
    """Return a time with all of its digits, so that it finds its shot again; errors as for `format_number`."""
    if not math.isfinite(time):
        raise ValueError(f"expected a finite time to write, got {time}")
    return repr(float(time))


def write_measurements(path: Path, rows: Iterable[PalletMeasurement | NoPose]) -> None:
    """Write measurements.csv, whole or not at all.

    Raises
    ------
    OutputError
        If it cannot be written.
    """
    write_rows(path, MEASUREMENT_COLUMNS, (measurement_cells(row) for row in rows))


def read_measurements(path: str | Path) -> tuple[PalletMeasurement | NoPose, ...]:
    """Read measurements.csv.

    Parameters
    ----------
    path : str or Path
        The file.

    Returns
    -------
    tuple of PalletMeasurement and NoPose
        In the file's order.

    Raises
    ------
    InputError
        If the file cannot be read or a row is wrong; names the line.
    """
    return tuple(parse_measurement(row) for row in in_seconds(read_rows(Path(path), MEASUREMENT_COLUMNS)))


def parse_measurement(row: Row) -> PalletMeasurement | NoPose:
    """Return what a row of measurements.csv says; errors as for `Row.number`."""
    time, model, file = row.number("time_s"), row.text("model"), row.cells["file"]
    if row.is_empty(_RESULT_COLUMNS):
        return NoPose(time, model, file)
    return PalletMeasurement(
        time,
        model,
        read_pose(row),
        read_covariance(row),
        row.number("score"),
        row.choice("yaw_from", YawSource),
        file,
    )


def read_covariance(row: Row) -> FloatArray:
    """Return the (4, 4) covariance of a row that has `COVARIANCE_COLUMNS`.

    Raises
    ------
    TableError
        If a cell is not a finite number, a variance is negative, or the matrix is not positive semidefinite.
    """
    covariance = np.zeros((4, 4))
    covariance[_UPPER] = row.numbers(COVARIANCE_COLUMNS)
    covariance += np.triu(covariance, 1).T
    if not (np.diag(covariance) >= 0).all():
        raise row.fault("cov_xx, cov_yy, cov_zz, cov_ww: expected variances, which are not negative")
    if problem := covariance_fault(covariance):
        raise row.fault(f"{COVARIANCE_COLUMNS[0]} to {COVARIANCE_COLUMNS[-1]}: {problem}")
    return covariance


def read_pose(row: Row) -> LevelPose:
    """Return the level pose of a row that has `POSE_COLUMNS`; errors as for `Row.number`."""
    x, y, z = row.numbers(POSE_COLUMNS[:3])
    return LevelPose(x, y, z, row.number(POSE_COLUMNS[3], "pallet_yaw_rad"))


def write_refusals(path: Path, refusals: Iterable[RefusedCandidate]) -> None:
    """Write refusals.csv; errors as for `write_measurements`."""
    write_rows(path, REFUSAL_COLUMNS, (refusal_cells(refusal) for refusal in refusals))


def read_refusals(path: str | Path) -> tuple[RefusedCandidate, ...]:
    """Read refusals.csv; errors as for `read_measurements`."""
    return tuple(parse_refusal(row) for row in read_rows(Path(path), REFUSAL_COLUMNS))


def parse_refusal(row: Row) -> RefusedCandidate:
    """Return what a row of refusals.csv says; errors as for `Row.number`."""
    return RefusedCandidate(
        row.number("time_s"),
        row.text("model"),
        row.choice("stage", Stage),
        row.choice("reason", Reason),
        row.cells["file"],
    )
