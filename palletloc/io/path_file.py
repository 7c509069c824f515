"""Level poses over time in files of any program: tables with a header, TUM and KITTI, told by what stands in them."""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from palletloc.errors import seconds
from palletloc.geometry import FloatArray
from palletloc.io.csv_table import Row, TableError, in_order_of_time, read_rows, shortened
from palletloc.io.odometry_check import OdometryColumns, check_odometry, check_times, in_seconds
from palletloc.io.path_columns import INDEX, PathColumns, path_columns
from palletloc.io.path_frame import PathForm, PoseFrame, level_path
from palletloc.io.reading import read_text
from palletloc.ranges import range_of
from palletloc.trajectory import Trajectory

_TUM = "time x y z qx qy qz qw"
"""Of a line in TUM form: seconds, metres, a quaternion with its scalar last (cvg.cit.tum.de, file formats)."""
_KITTI_NUMBERS = 12
"""Of a line in KITTI form: the upper three rows of a pose's matrix, row by row, without a time."""
_OTHERS = {
    "what 'ros2 topic echo --csv' prints, whose columns have no names": r"\d+,\d+,[A-Za-z/_][^,]*,[^,]*,",
    "what 'rostopic echo' or 'ros2 topic echo' prints": r"(header:|---\s|seq:)",
    "JSON": r"\s*[\[{]",
    "XML": r"\s*<",
    "sentences of a GNSS receiver": r"\$G[A-Z]{4},",
    "a graph of g2o": r"(VERTEX|EDGE)_SE[23]",
}
"""Files that hold poses, too, by how they begin."""
_ADVICE = "print it with 'rostopic echo -p', export it from PlotJuggler, or write " + _TUM
"""What to do about them."""


@dataclass(frozen=True, slots=True, eq=False)
class PathFile:
    """What a file of poses holds."""

    trajectory: Trajectory
    """The poses; with speed and yaw rate where the file has them."""
    yaw: FloatArray
    """(n,) the headings as they stand there, with their jumps by whole turns, in radians."""
    notes: tuple[str, ...] = ()
    """What was dropped or assumed, one line each."""


@dataclass(slots=True, eq=False)
class _Samples:
    """Poses row by row."""

    path: Path
    lines: list[int] = field(default_factory=list)
    times: list[float] = field(default_factory=list)
    cells: list[str] = field(default_factory=list)
    places: list[list[float]] = field(default_factory=list)
    turns: list[Sequence[float]] = field(default_factory=list)
    """Quaternions, scalar last, or nine numbers of a matrix, or a yaw."""
    rates: list[tuple[float, float]] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def add(self, row: Row, time: float, place: list[float], turn: Sequence[float], key: str) -> bool:
        """Add a pose, unless it is the row before again."""
        if self.times and time <= self.times[-1]:
            if key == self.cells[-1] and time == self.times[-1]:
                self.notes.append(f"{self.path}, line {row.line}: is line {self.lines[-1]} again; dropped")
                return False
            now, before = seconds(time, self.times[-1])
            raise row.fault(
                f"the time {now} does not follow {before} of line {self.lines[-1]};"
                " expected strictly increasing times"
            )
        for name, value in zip(("time_s", "x_m", "y_m", "z_m"), (time, *place), strict=True):
            if problem := range_of(name).fault(value):
                raise row.fault(f"{name[0] if name != 'time_s' else 'time'}: {problem}")
        self.lines.append(row.line)
        self.times.append(time)
        self.cells.append(key)
        self.places.append(place)
        self.turns.append(turn)
        return True


def read_path(path: Path, own: Sequence[str], optional: Sequence[str] = (), form: PathForm | None = None) -> PathFile:
    """Read level poses over time.

    Parameters
    ----------
    path : Path
        A table with our own columns; or one with those of EuRoC, ``rostopic echo -p``, PlotJuggler or bagpy, in any
        order; or lines in TUM form, with blanks or commas; or in KITTI form.
    own : sequence of str
        Our own columns, of which the file must have all if it has any.
    optional : sequence of str
        Those of them that may be missing.
    form : PathForm, optional
        What the file cannot say itself.

    Returns
    -------
    PathFile
        Its poses and notes.

    Raises
    ------
    InputError
        If the file cannot be read or is of another kind (names it).
    TableError
        If a row is wrong, a pose is tilted, or the times do not increase; names the line.
    """
    form = form or PathForm()
    lines = list(_lines(path))
    first = next((text for _, text in lines if not text.startswith("#")), "")
    header = [cell.strip() for cell in first.split(",")]
    if set(own) & set(header) or (path.suffix == ".csv" and not lines):
        return _assembled(_own_samples(path, own, optional, header), form)
    found = _with_header(path, lines)
    if found is not None:
        return _assembled(found, form)
    if path.suffix == ".csv" and not _numbers(first):
        _refuse_others(path, first)
        next(iter(read_rows(path, own)), None)  # whose errors name our own columns
    return _assembled(_without_header(path, lines, form), form)


def _lines(path: Path) -> Iterator[tuple[int, str]]:
    """Yield number and text of each line that is not empty."""
    for number, line in enumerate(read_text(path).splitlines(), start=1):
        if line.strip():
            yield number, line.strip()


def _refuse_others(path: Path, first: str) -> None:
    kind = next((kind for kind, start in _OTHERS.items() if re.match(start, first)), None)
    if kind is not None:
        raise TableError(f"{path}, line 1: is {kind}; {_ADVICE}")


def _own_samples(path: Path, own: Sequence[str], optional: Sequence[str], header: Sequence[str]) -> _Samples:
    quaternion = ("qx", "qy", "qz", "qw")
    has_quaternion = "qw" in header
    needed = [name for name in own if name not in optional and not (has_quaternion and name == "yaw_rad")]
    samples = _Samples(path)
    rows = read_rows(path, needed, (*optional, "yaw_rad", "z_m", *quaternion, *INDEX))
    for row in in_order_of_time(in_seconds(rows), notes=samples.notes):
        place = row.numbers(name for name in ("x_m", "y_m", "z_m") if name in row.cells)
        turn = row.numbers(quaternion if has_quaternion else ("yaw_rad",))
        samples.add(row, row.number("time_s"), [*place, 0.0][:3], turn, "")
        if {"speed_mps", "yaw_rate_radps"} <= row.cells.keys():
            samples.rates.append((row.number("speed_mps"), row.number("yaw_rate_radps")))
    if not samples.times:
        raise TableError(f"{path}: has no rows; expected at least one pose")
    return samples


def _with_header(path: Path, lines: Sequence[tuple[int, str]]) -> _Samples | None:
    """Read a table whose header names the columns; None where there is none that is known."""
    for at, (number, text) in enumerate(lines):
        if _numbers(text):
            return None
        mark = next((mark for mark in ",;\t" if mark in text), None)
        names = next(csv.reader([text], delimiter=mark)) if mark else text.lstrip("#% ").split()
        columns = path_columns(path, number, names)
        if columns is not None:
            return _table(path, lines[at + 1 :], columns, len(names), mark)
        if not text.startswith("#"):
            return None
    return None


def _table(
    path: Path, lines: Sequence[tuple[int, str]], columns: PathColumns, width: int, mark: str | None
) -> _Samples:
    samples = _Samples(path)
    for number, text in lines:
        if text.startswith("#"):
            continue
        if not samples.times:
            columns = _in_seconds(samples, columns, text.split(mark))
        if mark is not None and mark not in text:
            mark = None if len(text.split()) == width else mark
        cells = next(csv.reader([text], delimiter=mark)) if mark else text.split()
        if mark == ";":
            cells = [cell.replace(",", ".") for cell in cells]
        if len(cells) != width or (columns.is_tum and _numbers(text, mark) is None):
            what = f"eight numbers '{_TUM}', got {shortened(text)}" if columns.is_tum else f"{width} cells"
            raise TableError(
                f"{path}, line {number}: expected {what}" + ("" if columns.is_tum else f", got {len(cells)}")
            )
        row = Row(path, number, {name: cells[at].strip() for name, at in columns.places.items()})
        if not any(row.cells[name] for name in row.cells if name not in ("time", "sec", "nsec")):
            continue  # PlotJuggler writes a row for every time of any topic
        _add(samples, row, columns)
    if not samples.times:
        raise TableError(f"{path}: has no rows; expected at least one pose")
    return samples


def _in_seconds(samples: _Samples, columns: PathColumns, cells: Sequence[str]) -> PathColumns:
    """Return the columns with times in nanoseconds, where they have 18 or 19 digits, as EuRoC's."""
    at = columns.places.get("time", len(cells))
    if at >= len(cells) or columns.factors["time"] != 1.0 or not re.fullmatch(r"\d{18,19}", cells[at].strip()):
        return columns
    samples.notes.append(f"{samples.path}: the times have {len(cells[at].strip())} digits: taken for nanoseconds")
    return replace(columns, factors={**columns.factors, "time": 1e-9})


def _add(samples: _Samples, row: Row, columns: PathColumns) -> None:
    def number(name: str) -> float:
        return row.number(name, "time_s" if name in ("time", "sec", "nsec") else "") * columns.factors[name]

    time = number("sec") + number("nsec") * 1e-9 if {"sec", "nsec"} <= row.cells.keys() else number("time")
    place = [number(name) if name in row.cells else 0.0 for name in "xyz"]
    turn = [number(f"q{axis}") for axis in "xyzw"] if columns.has_quaternion else [number("yaw")]
    added = samples.add(row, time, place, turn, "\0".join(row.cells.values()))
    if added and {"speed", "yaw_rate"} <= row.cells.keys():
        samples.rates.append((number("speed"), number("yaw_rate")))


def _without_header(path: Path, lines: Sequence[tuple[int, str]], form: PathForm) -> _Samples:
    samples = _Samples(path)
    rows = [(number, text) for number, text in lines if not text.startswith("#")]
    mark = "," if rows and "," in rows[0][1] else None
    times = None
    if rows and len(_numbers(rows[0][1]) or ()) == _KITTI_NUMBERS:
        times = _read_times(path, form, len(rows))
    for at, (number, text) in enumerate(rows):
        values = [cell.strip() for cell in text.split(mark)]
        row = Row(path, number, {str(column): value for column, value in enumerate(values)})
        numbers = _numbers(text, mark)
        if numbers is None or len(numbers) != (_KITTI_NUMBERS if times else 8):
            _refuse_others(path, text)
            what = "twelve numbers of a matrix" if times else f"eight numbers '{_TUM}'"
            raise row.fault(f"expected {what}, got {shortened(text)}")
        if times:
            samples.add(row, times[at], numbers[3::4], [numbers[at] for at in (0, 1, 2, 4, 5, 6, 8, 9, 10)], text)
        else:
            samples.add(row, numbers[0], numbers[1:4], numbers[4:], text)
    if not rows:
        raise TableError(f"{path}: has no poses; expected lines '{_TUM}'")
    return samples


def _read_times(path: Path, form: PathForm, count: int) -> list[float]:
    if form.times is None:
        raise TableError(
            f"{path}: holds matrices without times, in KITTI form; expected a file of times beside it: state 'times'"
        )
    times = [_numbers(text) for _, text in _lines(form.times) if not text.startswith("#")]
    if any(numbers is None or len(numbers) != 1 for numbers in times) or len(times) != count:
        raise TableError(f"{form.times}: expected {count} lines with one time each, as {path.name} has poses")
    return [numbers[0] for numbers in times if numbers]


def _numbers(text: str, mark: str | None = None) -> list[float] | None:
    """Return the numbers of a line, none beyond what a time may be; None where it holds anything else."""
    mark = mark or ("," if "," in text else None)
    try:
        numbers = [float(cell) if "_" not in cell else math.nan for cell in text.split(mark)]
    except ValueError:
        return None
    return None if any(range_of("time_s").fault(number) for number in numbers) else numbers


def _assembled(samples: _Samples, form: PathForm) -> PathFile:
    """Return the level path."""
    check_times(samples.path, np.array(samples.times))
    places = np.array(samples.places)
    yaw: FloatArray
    if len(samples.turns[0]) == 1:
        if form.frame is PoseFrame.OPTICAL or form.rotation is not None:
            raise TableError(f"{samples.path}: holds level poses; expected none of frame and rotation_deg for them")
        yaw = np.array(samples.turns)[:, 0]
    else:
        places, yaw = level_path(samples.path, samples.lines, places, np.array(samples.turns), form)
    x, y, z = places.T
    rates = np.array(samples.rates).T if samples.rates else None
    path = Trajectory(np.array(samples.times), x, y, yaw, z=z)
    if rates is not None:
        path = replace(path, speed=rates[0], yaw_rate=rates[1])
    return PathFile(path, yaw, _few(samples.notes))


def _few(notes: list[str]) -> tuple[str, ...]:
    """Return the first of many notes of one kind, and how many more there are."""
    return tuple(notes) if len(notes) < 2 else (f"{notes[0]}, and {len(notes) - 1} more",)


def read_odometry(path: Path, own: Sequence[str], form: PathForm | None = None) -> PathFile:
    """Read odometry: a path on the floor with its rates, which agrees with itself.

    Parameters
    ----------
    path, own, form
        As for `read_path`; the rates ``speed_mps`` and ``yaw_rate_radps`` may be missing.

    Returns
    -------
    PathFile
        With speed and yaw rate, those of the poses where the file has none, and without heights.

    Raises
    ------
    InputError
        As for `read_path`, and if poses contradict the rates; names the likeliest unit.
    """
    file = read_path(path, own, ("speed_mps", "yaw_rate_radps"), form)
    found = file.trajectory
    strange = check_odometry(
        path, OdometryColumns(found.times, found.x, found.y, file.yaw, found.speed, found.yaw_rate)
    )
    return replace(file, trajectory=replace(with_rates(found), z=None), notes=(*file.notes, *strange))


def with_rates(path: Trajectory) -> Trajectory:
    """Return a path with speed and yaw rate by its own differences, where it has none.

    Parameters
    ----------
    path : Trajectory
        With two samples or more; a single one stands still.

    Returns
    -------
    Trajectory
        The speed is that along the heading.
    """
    if path.speed is not None and path.yaw_rate is not None:
        return path
    if path.times.size < 2:
        still = np.zeros_like(path.times)
        return replace(path, speed=still, yaw_rate=still)
    east, north, rate = (np.gradient(values, path.times) for values in (path.x, path.y, path.yaw))
    return replace(path, speed=east * np.cos(path.yaw) + north * np.sin(path.yaw), yaw_rate=rate)
