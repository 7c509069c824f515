"""The methods side by side: errors of yaw and depth over the shots of a recording."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import groupby

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, MaxNLocator

from benchmarks.run_parts import FAR_BELOW, match_recording
from palletloc.drawing.canvas import FAINT, GRID, INK, WIDTH_PX, add_axes, add_text, new_figure
from palletloc.evaluation.pose_error import PoseError, TrueFace
from palletloc.evaluation.run_match import RunMatch
from palletloc.geometry import FloatArray
from palletloc.io.recording import Recording
from palletloc.io.truth import Truth
from palletloc.measurement import PalletMeasurement

_LEFT, _RIGHT, _HEAD, _GAP, _BETWEEN, _FOOT = 74, 20, 72, 78, 16, 16  # in pixels
_HEIGHT, _LINE, _AXIS, _TITLE = 236, 20, 54, 26
_STYLES = (
    ("#0072b2", "o", "-"),
    ("#d55e00", "s", (0, (5, 2))),
    ("#009e73", "^", (0, (1, 1.4))),
    ("#7a4f9a", "D", (0, (6, 2, 1, 2))),
    ("#8a6d00", "v", (0, (3, 1))),
    ("#444444", "P", (0, (8, 3))),
)
"""Colour, mark and line of one method after another: every one differs in all three."""
_PARTS: tuple[tuple[str, Callable[[TrueFace], bool]], ...] = (
    (f"{FAR_BELOW:g} m or more below the camera", lambda face: face.below >= FAR_BELOW),
    ("near the camera's height or above it", lambda face: face.below < FAR_BELOW),
)
_AXES: tuple[tuple[str, float, Callable[[PoseError], float]], ...] = (
    ("yaw error (\N{DEGREE SIGN})", float(np.degrees(1.0)), lambda error: error.yaw),
    ("depth error (mm)", 1000.0, lambda error: error.depth),
)
_LEAST = (0.003, 0.3)
"""Errors that are drawn at the lower border, in degrees and in millimetres."""
_STEP = 0.07
"""How far the methods stand apart at one shot, in shots."""


def method_figure(recording: Recording, truth: Truth, runs: Mapping[str, Sequence[PalletMeasurement]]) -> Figure:
    """Draw the errors of several methods over the shots of a recording.

    Parameters
    ----------
    recording : Recording
        Gives the shots, the mounting and the pallet models.
    truth : Truth
        Of the recording.
    runs : mapping of str to sequence of PalletMeasurement
        What each method measured, in the order of the legend; at least one method.

    Returns
    -------
    Figure
        Absolute errors of yaw and depth on logarithmic scales: a mark for each pallet, a line through the medians
        of the shots; pallets far below the camera and others apart. Below, what each method found.

    Raises
    ------
    PalletLocError
        If the truth does not cover a shot, or has a pallet of another model.
    ValueError
        Without a method.
    """
    if not runs:
        raise ValueError("there is no method to draw")
    compared = {name: match_recording(recording, truth, measured) for name, measured in runs.items()}
    parts = [part for part in _PARTS if any(_views(run, part[1]) for run in compared.values())] or [_PARTS[0]]
    table = _LINE * (len(runs) + 1) + _FOOT
    figure = new_figure(_HEAD + len(_AXES) * _HEIGHT + _BETWEEN + _AXIS + table)
    name = recording.folder.name or "a recording"
    add_text(figure, _LEFT, 14, f"{name}: errors of the methods over the shots", size=13, bold=True)
    explained = "Marks: absolute error of each pallet in view; lines: their median in each shot; logarithmic scales"
    add_text(figure, _LEFT, 40, explained, size=10.5)
    width = (WIDTH_PX - _LEFT - _RIGHT - (len(parts) - 1) * _GAP) / len(parts)
    times = [shot.time for shot in recording.shots]
    for column, (which, belongs) in enumerate(parts):
        left, top = _LEFT + column * (width + _GAP), float(_HEAD)
        for row, (label, scale, value) in enumerate(_AXES):
            axes = add_axes(figure, left, top + _TITLE, width, _HEIGHT - _TITLE)
            _prepare(axes, label, len(times))
            for number, run in enumerate(compared.values()):
                chosen = _chosen(run, belongs, times)
                _draw_method(axes, chosen, value, scale, (number, len(runs)), _LEAST[row])
            axes.set_ylim(bottom=_LEAST[row] * 0.8)
            if row == 0:
                add_text(figure, left, top + 4, f"Pallets {which}", size=10.5, bold=True)
            top += _HEIGHT + (_BETWEEN if row == 0 else 0)
        axes.set_xlabel("number of the shot")
        _write_table(figure, left, top + _AXIS, width, compared, belongs)
    return figure


def _views(run: RunMatch, belongs: Callable[[TrueFace], bool]) -> int:
    """Return how many times a pallet should be found."""
    return len(_found(run, belongs)) + sum(belongs(face) for shot in run.shots for face in shot.missed)


def _found(run: RunMatch, belongs: Callable[[TrueFace], bool]) -> list[PoseError]:
    return [error for error in run.errors if belongs(error.face)]


def _chosen(
    run: RunMatch, belongs: Callable[[TrueFace], bool], times: Sequence[float]
) -> list[tuple[int, PoseError]]:
    """Return the errors of pallets that have to be found, with the numbers of their shots."""
    return [(times.index(error.time), error) for error in run.errors if belongs(error.face)]


def _prepare(axes: Axes, label: str, shots: int) -> None:
    axes.set_yscale("log")
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.grid(color=GRID, linewidth=0.6)
    axes.set_axisbelow(True)
    axes.set(ylabel=label, xlim=(-0.6, max(shots, 1) - 0.4))
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))


def _draw_method(
    axes: Axes,
    chosen: Sequence[tuple[int, PoseError]],
    value: Callable[[PoseError], float],
    scale: float,
    place: tuple[int, int],
    least: float,
) -> None:
    """Draw one method; those of one shot stand side by side."""
    if not chosen:
        return
    number, count = place
    color, mark, line = _STYLES[number % len(_STYLES)]
    shift = (number - (count - 1) / 2) * _STEP
    shots = np.array([shot for shot, _ in chosen])
    sizes = np.maximum(np.abs([value(error) for _, error in chosen]) * scale, least)
    axes.plot(shots + shift, sizes, mark, color=color, markersize=4, alpha=0.45, markeredgewidth=0)
    at, middle = np.array([(shot, np.median(sizes[members])) for shot, members in _members(shots)]).T
    axes.plot(at + shift, middle, marker=mark, color=color, linestyle=line, linewidth=1.8, markersize=6)


def _members(shots: FloatArray) -> list[tuple[int, list[int]]]:
    """Return the indices that belong to each shot."""
    order = sorted(range(len(shots)), key=lambda i: int(shots[i]))
    return [(shot, list(group)) for shot, group in groupby(order, key=lambda i: int(shots[i]))]


def _write_table(
    figure: Figure,
    left: float,
    top: float,
    width: float,
    compared: Mapping[str, RunMatch],
    belongs: Callable[[TrueFace], bool],
) -> None:
    """Write what each method found and how large its errors are; the rows are the keys of the lines."""
    axes = add_axes(figure, left, top, width, _LINE * (len(compared) + 1))
    axes.set(xlim=(0, width), ylim=(len(compared) + 0.5, -0.5))
    axes.set_axis_off()
    columns = ("found", "yaw \N{DEGREE SIGN}: median / 95 %", "depth mm: median / 95 %")
    places = (0.39, 0.68, 0.99)
    for title, place in zip(columns, places, strict=True):
        axes.text(place * width, 0, title, ha="right", va="center", size=8.5, color=FAINT)
    for row, (name, run) in enumerate(compared.items(), start=1):
        color, mark, line = _STYLES[(row - 1) % len(_STYLES)]
        axes.plot([0, 34], [row, row], color=color, linestyle=line, linewidth=1.8)
        axes.plot(17, row, mark, color=color, markersize=6)
        axes.text(44, row, name, va="center", size=9.5, color=INK, parse_math=False)
        errors, views = _found(run, belongs), _views(run, belongs)
        cells = [f"{len(errors)} of {views}"]
        for (_, scale, value), digits in zip(_AXES, (2, 1), strict=True):
            sizes = np.abs([value(error) for error in errors]) * scale
            cells.append(f"{np.median(sizes):.{digits}f} / {np.percentile(sizes, 95):.{digits}f}" if errors else "")
        for cell, place in zip(cells, places, strict=True):
            axes.text(place * width, row, cell, ha="right", va="center", size=9.5, color=INK)
