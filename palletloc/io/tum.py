"""Trajectories in TUM form: ``time x y z qx qy qz qw``, separated by blanks, as mocap systems and evo write them."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from palletloc.io.csv_table import TableError, shortened
from palletloc.io.reading import read_text
from palletloc.trajectory import Trajectory

MAX_TILT_DEG = 5.0
"""Tilt beyond which a pose is not that of a vehicle on a floor, in degrees."""
_COLUMNS = "time x y z qx qy qz qw"


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
            row = _pose(path, number, line)
            if rows and row[0] <= rows[-1][1][0]:
                raise TableError(
                    f"{path}, line {number}: the time {row[0]:.9g} does not follow {rows[-1][1][0]:.9g}"
                    f" of line {rows[-1][0]}; expected strictly increasing times"
                )
            rows.append((number, row))
    if not rows:
        raise TableError(f"{path}: has no poses; expected lines '{_COLUMNS}'")
    times, x, y, z, yaw = np.array([row for _, row in rows]).T
    return Trajectory(times=times, x=x, y=y, yaw=yaw, z=z)


def _pose(path: Path, number: int, line: str) -> list[float]:
    """Return time, x, y, z and yaw."""
    try:
        values = [float(part) for part in line.split()]
    except ValueError:
        values = []
    if len(values) != 8 or not all(math.isfinite(value) for value in values):
        raise TableError(f"{path}, line {number}: expected eight numbers '{_COLUMNS}', got {shortened(line.strip())}")
    quaternion = np.array(values[4:])
    norm = float(np.linalg.norm(quaternion))
    if abs(norm - 1) > 0.01:
        raise TableError(f"{path}, line {number}: expected a quaternion of length 1, got {norm:.3g}")
    qx, qy, qz, qw = quaternion / norm
    tilt = math.degrees(2 * math.asin(min(1.0, math.hypot(qx, qy))))
    if tilt > MAX_TILT_DEG:
        raise TableError(
            f"{path}, line {number}: the pose is tilted by {tilt:.1f} degrees, expected at most {MAX_TILT_DEG:.0f}:"
            " z up, and the scalar of the quaternion last"
        )
    return [*values[:4], math.atan2(2 * (qw * qz + qx * qy), 1 - 2 * (qy**2 + qz**2))]
