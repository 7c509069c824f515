"""Whether odometry agrees with itself: its poses with its rates, the way with the yaw, its times with seconds."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from palletloc.geometry import FloatArray, wrap_angle
from palletloc.io.csv_table import Row
from palletloc.io.reading import InputError

ComplexArray = NDArray[np.complex128]
"""Places on the floor, x + iy."""
_WINDOW_S = 0.5
"""Over how long changes are compared, in seconds: jitter of single samples averages out."""
_LEAST_WAY, _LEAST_TURN = 0.02, 0.002
"""Less in a window tells nothing, in metres and radians."""
_LEAST_PART = 0.2
"""Nor does less than this part of the largest: windows in which little moves."""
_LEAST_WINDOWS = 3
"""Windows from which on factors are told."""
_LEAST_REACH = 0.5
"""Way from which on it is added up along the yaw, in metres."""
_CLOSE, _FAR, _BETTER = 0.008, 0.03, 0.6
"""Misfits of the added way, relative to its length: one that is good, one that explains nothing, and by which factor
that of another explanation has to be smaller."""
_TURNED_DEG = 2.5
"""Constant errors of the yaw up to which they may be what is wrong instead, in degrees."""
_ALIKE, _AGREEING = 0.25, 0.7
"""How far a factor may be off the common one, relative, and which part of the motion has to be within that."""
_NEAR, _NEAR_CURVE = 0.12, 0.35
"""How far a common factor may be off that of a unit, relative: scale errors, slip, the chords of curves; and where
the way swings."""
_STRAIGHT = 0.9
"""Part of the way that has to lead aside alike."""
_LEVER = 3.0
"""Metres driven per radian turned from which on a way leads ahead, even of a point off the axle."""
_LEAST_ASIDE, _ACROSS = 20.0, 10.0
"""Angles between way and yaw from which on they are told: a reference point off the axle swings by less; and how near
to a right angle nothing but exchanged axes explains them. In degrees."""
_JUMP_M, _JUMP_MPS, _JUMP_RAD, _JUMP_RADPS = 0.1, 10.0, 0.1, math.pi
"""Steps that are larger and faster than this are jumps; the speeds are those of `tracking.odometry.PathLimits`."""
_BEYOND = 5.0
"""How many times as large as nine tenths of all steps a jump is at least."""
_STAMPS = {1e16: "nanoseconds", 1e14: "microseconds", 1e11: "milliseconds"}
"""Units of stamps since 1970 by the least value that they have until 5138; seconds are below all of them."""
_LARGEST_STAMP = 1e20
"""Beyond this a time is no stamp in any unit."""
_WAY_UNITS = {1000.0: "millimetres", 100.0: "centimetres", 1 / 0.3048: "feet", 1 / 0.0254: "inches"}
"""Units of the place, by how many of them are a metre."""
_YAW_UNITS = {180 / math.pi: "degrees", -180 / math.pi: "degrees, clockwise", -1.0: "clockwise"}
"""Units of the yaw, by how many of them are a radian to the left."""
_CURVE_UNITS = {
    -1.0: "y_m to the right, or yaw_rad clockwise",
    math.pi / 180: "yaw_rad in degrees",
    -math.pi / 180: "yaw_rad in degrees, and clockwise or y_m to the right",
}
"""What makes the way turn otherwise than the yaw, by the factor."""
_TIME_UNITS = {1e-3: "milliseconds", 1e-6: "microseconds", 1e-9: "nanoseconds"}
"""Units of the time, by how many seconds they are."""
_SPEED_UNITS = {1e-3: "mm/s", 1e-2: "cm/s", 1 / 3.6: "km/h"}
"""Units of the speed, by how many metres per second they are."""
_LEAST_SPEED_UNIT = 1e-4
"""No speed is stated in smaller units, in metres per second."""
_RATE_UNITS = {math.pi / 180: "degrees/s", -math.pi / 180: "degrees/s, clockwise"}
"""Units of the yaw rate, by how many radians per second they are."""


class OdometryError(InputError):
    """Odometry that contradicts itself; names file, column and factor."""


@dataclass(frozen=True, slots=True, eq=False)
class OdometryColumns:
    """The columns of odometry as they were read, none of them changed."""

    time: FloatArray
    """(n,) increasing, in seconds."""
    x: FloatArray
    """(n,) in metres."""
    y: FloatArray
    """(n,) in metres."""
    yaw: FloatArray
    """(n,) in radians, wrapped or not."""
    speed: FloatArray | None = None
    """(n,) forward, in metres per second; None where it was not recorded."""
    yaw_rate: FloatArray | None = None
    """(n,) in radians per second; None where it was not recorded."""


def check_times(path: Path, times: FloatArray) -> None:
    """Check that times are seconds.

    Parameters
    ----------
    path : Path
        Where they stand, for the message.
    times : (n,) array
        As they were read.

    Raises
    ------
    OdometryError
        If they are stamps since 1970 in a smaller unit.
    """
    largest = float(np.abs(times).max(initial=0.0))
    unit = next((unit for least, unit in _STAMPS.items() if largest >= least), None)
    if unit is not None:
        raise OdometryError(f"{path}: time_s: {_rounded_down(largest)}: {unit}?")


def in_seconds(rows: Iterable[Row], column: str = "time_s") -> Iterator[Row]:
    """Pass rows on whose times are seconds: of all other units the whole file is, and no single line is wrong."""
    for row in rows:
        time = math.nan
        with suppress(ValueError):  # whoever takes the number out says what is wrong with it
            time = float(row.cells[column])
        if abs(time) < _LARGEST_STAMP:
            check_times(row.path, np.array([time]))
        yield row


def check_odometry(path: Path, columns: OdometryColumns) -> tuple[str, ...]:
    """Check odometry against itself.

    Over windows of half a second the way between the poses is compared with what the speed says, the change of the
    yaw with what its rate says, and the turns of the way with those of the yaw. A factor is told where most of the
    motion has it: standing, jitter, slip and drift have none.

    Parameters
    ----------
    path : Path
        Where it stands, for messages.
    columns : OdometryColumns
        As they were read.

    Returns
    -------
    tuple of str
        What contradicts itself although the poses can be used, such as rates in other units; one line each.

    Raises
    ------
    OdometryError
        If the poses cannot be used: times, places or yaws are in other units, or have another sign.
    """
    check_times(path, columns.time)
    windows = _Windows.of(columns)
    found = [*_of_rates(windows, columns.time), *_of_the_way(windows), *((jump, False) for jump in _jumps(columns))]
    for line, is_unusable in found:
        if is_unusable:
            raise OdometryError(f"{path}: {line}")
    return tuple(f"{path}: {line}" for line, _ in found)


def _of_rates(windows: _Windows, times: FloatArray) -> Iterator[tuple[str, bool]]:
    """Say where poses contradict their rates, and whether it is the poses that cannot be right."""
    way, turn = windows.way_factor(), _first_known(windows.turn_factors(), _YAW_UNITS)
    for said, wrong, strange in (
        (
            f"x_m, y_m go {_shown(way)} times as far as speed_mps says",
            _time_unit(way, turn, times) or _unit(way, _WAY_UNITS),
            _unit(way, _SPEED_UNITS),
        ),
        (
            f"yaw_rad turns {_shown(turn)} times as far as yaw_rate_radps says",
            _unit(turn, _YAW_UNITS),
            _unit(turn, _RATE_UNITS),
        ),
    ):
        if unit := wrong or strange:
            yield f"{said}: {unit}?", bool(wrong)


def _of_the_way(windows: _Windows) -> Iterator[tuple[str, bool]]:
    """Say where the way leads otherwise than the yaw says, and whether nothing small explains that."""
    factor, off = windows.curve()
    if unit := _unit(factor, _CURVE_UNITS, _NEAR_CURVE):
        instead = f", or {abs(off):.1f} degrees off" if abs(off) <= _TURNED_DEG else ""
        yield (
            f"the way of x_m, y_m turns {_shown(factor)} times as far as yaw_rad says: {unit}{instead}?",
            not instead,
        )
    aside = windows.aside_deg()
    if abs(aside) > _LEAST_ASIDE:
        said = f"x_m, y_m go {abs(aside):.0f} degrees to the {'left' if aside > 0 else 'right'} of yaw_rad"
        exchanged = abs(abs(aside) - 90) < _ACROSS
        yield f"{said}: axes exchanged?" if exchanged else f"{said} where speed_mps says forwards", exchanged


def _shown(factor: float) -> str:
    """Return a factor with three digits, large ones without exponent."""
    return f"{float(f'{factor:.3g}'):g}"


def _rounded_down(value: float) -> str:
    """Return a large number with two digits, none of them rounded up."""
    power = math.floor(math.log10(value))
    return f"{math.floor(value / 10.0 ** (power - 1)) / 10:.1f}e{power}"


def _factor(found: FloatArray, said: FloatArray, least: float) -> float:
    """Return how many times what is said was found, if that is the same in most of it; NaN where it is not.

    Parameters
    ----------
    found, said : (n,) array
        Changes.
    least : float
        Those of which less is said tell nothing, nor do those that are small beside the largest.
    """
    weights = np.abs(np.nan_to_num(said))
    counts = weights >= max(least, _LEAST_PART * float(weights.max(initial=0.0)))
    if counts.sum() < _LEAST_WINDOWS:
        return math.nan
    factors, weights = found[counts] / said[counts], weights[counts]
    order = factors.argsort()
    common = float(factors[order][np.searchsorted(weights[order].cumsum(), weights.sum() / 2)])
    alike = np.abs(factors - common) <= _ALIKE * abs(common)
    if weights[alike].sum() < _AGREEING * weights.sum():
        return math.nan
    return float(np.average(factors[alike], weights=weights[alike]))


def _unit(factor: float, units: Mapping[float, str], near: float = _NEAR) -> str:
    """Return the unit that has a factor; nothing where none has."""
    return next((unit for exact, unit in units.items() if abs(factor / exact - 1) <= near), "")


def _misfit(places: ComplexArray, others: ComplexArray, reach: float) -> float:
    """Return how far places are from others, root mean square, relative to a length."""
    return float(np.sqrt(np.mean(np.abs(places - others) ** 2))) / reach


def _first_known(factors: Sequence[float], units: Mapping[float, str]) -> float:
    """Return the first factor that is about 1 or that of a unit; the first of all where none is."""
    known = {1.0: "as it should be", **units}
    return next((factor for factor in factors if _unit(factor, known)), factors[0])


def _time_unit(way: float, turn: float, times: FloatArray) -> str:
    """Return the unit that makes way and turns as much too short; where nothing turns, one that no speed has."""
    unit = _unit(way, _TIME_UNITS)
    if unit and math.isnan(turn):
        alone = way < _LEAST_SPEED_UNIT or float(np.median(np.diff(times))) >= 1
        return f"time_s in {unit}" if alone else ""
    return f"time_s in {unit}" if unit and unit == _unit(turn, _TIME_UNITS) else ""


@dataclass(frozen=True, slots=True, eq=False)
class _Windows:
    """What changes in windows of equal length, one after the other: n windows between n + 1 samples."""

    way: ComplexArray
    """(n,) between the places at both ends, x + iy, in metres."""
    said_way: FloatArray
    """(n,) what the speed says of it; NaN where it does not."""
    yaws: tuple[FloatArray, FloatArray]
    """Twice (n + 1,): the yaw at the ends without its whole turns, were it in radians, and were it in degrees."""
    said_turn: FloatArray
    """(n,) what the yaw rate says of its change; NaN where it does not."""

    @classmethod
    def of(cls, columns: OdometryColumns) -> _Windows:
        times = columns.time
        ends = [0]
        while (end := int(np.searchsorted(times, times[ends[-1]] + _WINDOW_S * (1 - 1e-9)))) < len(times):
            ends.append(end)

        def integral(rates: FloatArray | None) -> FloatArray:
            if rates is None:
                return np.full(len(ends) - 1, np.nan)
            steps = np.diff(times) * (rates[1:] + rates[:-1]) / 2
            return np.diff(np.concatenate([[0.0], steps.cumsum()])[ends])

        yaws = np.unwrap(columns.yaw)[ends], np.unwrap(columns.yaw, period=360.0)[ends]
        way = np.diff((columns.x + 1j * columns.y)[ends])
        return cls(way, integral(columns.speed), yaws, integral(columns.yaw_rate))

    def way_factor(self) -> float:
        """Return how many times as far as the speed says the places move."""
        return _factor(np.abs(self.way), np.abs(self.said_way), _LEAST_WAY)

    def turn_factors(self) -> list[float]:
        """Return how many times as far as its rate says the yaw turns, either unit taken."""
        return [_factor(np.diff(yaw), self.said_turn, _LEAST_TURN) for yaw in self.yaws]

    def curve(self) -> tuple[float, float]:
        """Return how many times as far as the yaw says the way turns, and how much else the yaw would have to be off.

        The way is added up along the yaw, as it is and by every other factor, and the places have to be there. Turns
        from window to window would not tell: a reference point off the axle swings to and fro.

        Returns
        -------
        float
            1 where the way is as the yaw says, otherwise what explains it better; NaN where nothing does.
        float
            Constant angle that explains the places as well, in degrees; infinite where none does.
        """
        lengths = np.abs(self.way) * np.where(self.said_way < 0, -1, 1)
        places, reach = self.way.cumsum(), float(np.abs(lengths.sum()))
        if reach < _LEAST_REACH:
            return math.nan, math.inf
        units = {1.0: 0, -1.0: 0, math.pi / 180: 1, -math.pi / 180: 1}
        middles = [(yaw[1:] + yaw[:-1]) / 2 for yaw in self.yaws]
        added = {factor: (lengths * np.exp(1j * factor * middles[i])).cumsum() for factor, i in units.items()}
        misfits = {factor: _misfit(places, way, reach) for factor, way in added.items()}
        best = min(misfits, key=misfits.__getitem__)
        if misfits[best] > _FAR or misfits[1.0] < max(_CLOSE, misfits[best] / _BETTER):
            return (1.0 if misfits[1.0] <= _FAR else math.nan), math.inf
        aside, turned = added[best].imag, np.vdot(added[1.0], places)
        rotated = _misfit(places, added[1.0] * turned / abs(turned), reach)
        factor = best * float(aside @ places.imag / (aside @ aside))
        return factor, math.degrees(np.angle(turned)) if rotated <= misfits[best] / _BETTER else math.inf

    def aside_deg(self) -> float:
        """Return how far to the left of where yaw and speed say the way leads; 0 where it is not always as far."""
        middle = (self.yaws[0][1:] + self.yaws[0][:-1]) / 2
        counts = np.abs(self.said_way) >= np.maximum(_LEAST_WAY, _LEVER * np.abs(np.diff(self.yaws[0])))
        off = (self.way * np.exp(-1j * middle) * np.sign(self.said_way))[counts]
        if counts.sum() < _LEAST_WINDOWS or abs(off.sum()) < _STRAIGHT * np.abs(off).sum():
            return 0.0
        return math.degrees(np.angle(off.sum()))


def _beyond(steps: FloatArray, least: float) -> float:
    """Return how large a step is that no jitter makes."""
    return max(least, _BEYOND * float(np.percentile(steps, 90))) if len(steps) else least


def _jumps(columns: OdometryColumns) -> Iterator[str]:
    """Say where the pose jumps farther than any forklift drives."""
    durations = np.diff(columns.time)
    steps = np.hypot(np.diff(columns.x), np.diff(columns.y))
    turns = np.abs(wrap_angle(np.diff(columns.yaw)))
    jumped = steps > np.maximum(_beyond(steps, _JUMP_M), _JUMP_MPS * durations)
    jumped |= turns > np.maximum(_beyond(turns, _JUMP_RAD), _JUMP_RADPS * durations)
    for i in np.flatnonzero(jumped)[:1].tolist():
        many = f", the first of {jumped.sum()} times" if jumped.sum() > 1 else ""
        by = f"by {steps[i]:.2f} m and {math.degrees(turns[i]):.0f} degrees within {durations[i]:.3g} s"
        yield f"at {columns.time[i + 1]:.9g} s the pose jumps {by}{many}: a reset?"
