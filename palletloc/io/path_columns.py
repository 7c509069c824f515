"""The names that programs give to the columns of a pose over time, in one table."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from palletloc.io.csv_table import TableError, shortened

_NAMES: Mapping[str, tuple[str, ...]] = {
    "time": ("time_s", "header.stamp", "timestamp", "time", "stamp", "__time", "t"),
    "sec": ("stamp.sec", "stamp.secs", "timestamp.sec", "timestamp.secs"),
    "nsec": ("stamp.nanosec", "stamp.nsecs", "timestamp.nanosec", "timestamp.nsecs"),
    "x": ("x_m", "position.x", "translation.x", "p_rs_r_x", "tx", "x", "p_x", "px", "pos_x", "position_x"),
    "y": ("y_m", "position.y", "translation.y", "p_rs_r_y", "ty", "y", "p_y", "py", "pos_y", "position_y"),
    "z": ("z_m", "position.z", "translation.z", "p_rs_r_z", "tz", "z", "p_z", "pz", "pos_z", "position_z"),
    "qx": ("orientation.x", "rotation.x", "q_rs_x", "qx", "q_x", "orientation_x"),
    "qy": ("orientation.y", "rotation.y", "q_rs_y", "qy", "q_y", "orientation_y"),
    "qz": ("orientation.z", "rotation.z", "q_rs_z", "qz", "q_z", "orientation_z"),
    "qw": ("orientation.w", "rotation.w", "q_rs_w", "qw", "q_w", "orientation_w"),
    "yaw": ("yaw_rad", "orientation.yaw", "yaw_deg", "theta", "theta_rad", "theta_deg", "yaw"),
    "speed": ("speed_mps", "linear.x", "linear_x", "speed", "v", "vx", "v_x"),
    "yaw_rate": ("yaw_rate_radps", "angular.z", "angular_z", "yaw_rate", "yaw_rate_degps", "omega", "wz", "w_z"),
}
"""By field: our own name first, then those of messages (``rostopic echo -p``, PlotJuggler, bagpy), of EuRoC, TUM and
evo, and what people write. A name with a dot may follow others (``field.pose.pose.position.x``)."""
INDEX = ("", "index", "Unnamed: 0", "unnamed: 0")
"""Columns that number the rows, as pandas writes them."""
_UNITS: Mapping[str, float] = {
    "ns": 1e-9,
    "us": 1e-6,
    "ms": 1e-3,
    "s": 1.0,
    "sec": 1.0,
    "mm": 1e-3,
    "cm": 1e-2,
    "m": 1.0,
    **dict.fromkeys(("m/s", "m s^-1", "rad", "rad/s", "rad s^-1"), 1.0),
    **dict.fromkeys(("deg", "\N{DEGREE SIGN}", "deg/s", "deg s^-1"), math.pi / 180),
}
"""Units that names give in brackets, in seconds, metres and radians."""
_NANOSECONDS = re.compile(r"%time|field\.(.*\.)?stamp")
"""Names of times in whole nanoseconds, of ``rostopic echo -p`` (wiki.ros.org/rostopic)."""
_TUM = ("time", "x", "y", "z", "qx", "qy", "qz", "qw")
"""Fields in the order of a TUM file, whose header is a comment."""
_DEGREES = ("yaw_deg", "theta_deg", "yaw_rate_degps")
"""Names that say degrees."""


@dataclass(frozen=True, slots=True)
class PathColumns:
    """Which column holds what, and its unit."""

    places: Mapping[str, int]
    """Number of the column by field: time (or sec and nsec), x, y, z, a quaternion or yaw, speed, yaw_rate."""
    factors: Mapping[str, float]
    """Seconds, metres or radians in one of the column's unit, by field."""

    @property
    def has_quaternion(self) -> bool:
        """Whether the orientation is a quaternion."""
        return all(f"q{axis}" in self.places for axis in "xyzw")

    @property
    def is_tum(self) -> bool:
        """Whether the columns are those of a TUM file."""
        return self.places == dict(zip(_TUM, range(len(_TUM)), strict=True))

    @property
    def is_path(self) -> bool:
        """Whether time, place and heading are all there."""
        timed = "time" in self.places or {"sec", "nsec"} <= self.places.keys()
        return timed and {"x", "y"} <= self.places.keys() and (self.has_quaternion or "yaw" in self.places)


def path_columns(path: Path, line: int, header: Sequence[str]) -> PathColumns | None:
    """Tell the columns of a pose over time by their names.

    Parameters
    ----------
    path : Path
        The file, for errors.
    line : int
        Line of the header.
    header : sequence of str
        The names, in the file's order.

    Returns
    -------
    PathColumns or None
        None where no two of the names are known: then it is no header, or one of another kind of table.

    Raises
    ------
    TableError
        If two columns may be the same field, or one of time, place and heading is missing.
    """
    given = [_plain(name) for name in header]
    places: dict[str, int] = {}
    factors: dict[str, float] = {}
    for field, names in _NAMES.items():
        for name in names:
            found = [at for at, (plain, _) in enumerate(given) if plain == name or _ends(plain, name)]
            if len(found) > 1:
                both = " and ".join(shortened(header[at].strip()) for at in found[:2])
                raise TableError(f"{path}, line {line}: {both} may both be {field}; expected one path in a file")
            if found:
                places[field] = found[0]
                factors[field] = _factor(header[found[0]], *given[found[0]])
                break
    columns = PathColumns(places, factors)
    if len(places) < 2:
        return None
    if not columns.is_path:
        raise TableError(f"{path}, line {line}: {_lack(columns)} among {shortened(', '.join(header))}")
    return columns


def _plain(name: str) -> tuple[str, str]:
    """Return a name without marks, in small letters, and its unit in brackets."""
    found = re.fullmatch(r"[#%\s\"']*(.*?)\s*(?:[\[(]([^\])]*)[\])])?[\"'\s]*", name.strip())
    plain, unit = (found[1], found[2]) if found else (name, None)
    return plain.lower().replace("/", ".").lstrip("."), (unit or "").strip()


def _ends(plain: str, name: str) -> bool:
    return "." in name and plain.endswith(f".{name}")


def _factor(name: str, plain: str, unit: str) -> float:
    if unit in _UNITS:
        return _UNITS[unit]
    if _NANOSECONDS.fullmatch(name.strip().strip("\"'")):
        return 1e-9
    return math.pi / 180 if plain in _DEGREES else 1.0


def _lack(columns: PathColumns) -> str:
    wanted = {"time": ("time",), "x": ("x",), "y": ("y",), "heading": ("yaw", "qx")}
    missing = next(
        (what for what, keys in wanted.items() if not any(key in columns.places for key in keys)), "heading"
    )
    names = _NAMES.get(missing, (*_NAMES["yaw"][:2], "qx, qy, qz, qw"))
    return f"no column for the {missing} (such as {', '.join(names[:4])})"
