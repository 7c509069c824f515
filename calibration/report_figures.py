"""The figures of the report: residuals on the sphere and by polar angle, correlations, targets left out."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from calibration.degeneracy import NAMES
from calibration.extrinsics import Extrinsics
from calibration.leave_one_out import LeftOut
from calibration.residuals import CornerResiduals
from palletloc.drawing.canvas import FAINT, GRID, INK, SERIES, WIDTH_PX, add_axes, add_legend, add_text, new_figure
from palletloc.geometry import FloatArray

_LEFT, _RIGHT, _HEAD = 74, 24, 72
_ARROW_DEG = 5.0
_WIDE_LEFT = 104


def sphere_figure(residuals: Sequence[CornerResiduals]) -> Figure:
    """Draw where the corners are on the sphere, and which way each is off."""
    figure = new_figure(640)
    largest = max((float(r.angle[r.used].max()) for r in residuals if r.used.any()), default=1e-9)
    factor = _ARROW_DEG / max(np.degrees(largest), 1e-9)
    add_text(figure, _LEFT, 14, "Residuals on the sphere", size=13, bold=True)
    line = f"Fitted minus measured, drawn {factor:.0f} times as long; crosses were left out. Middle: straight ahead"
    add_text(figure, _LEFT, 40, line, size=10.5)
    axes = add_axes(figure, _LEFT, _HEAD, WIDTH_PX - _LEFT - _RIGHT, 470)
    axes.set(
        xlim=(180, -180),
        ylim=(-90, 90),
        xlabel="longitude (\N{DEGREE SIGN}), left is +",
        ylabel="latitude (\N{DEGREE SIGN})",
    )
    axes.set_xticks(range(-180, 181, 45))
    axes.set_yticks(range(-90, 91, 30))
    axes.grid(color=GRID, linewidth=0.6)
    axes.set_axisbelow(True)
    colors = _colors(residuals)
    for one in residuals:
        _draw_sight(axes, one, factor, colors[one.target])
    return figure


def _colors(residuals: Sequence[CornerResiduals]) -> dict[str, str]:
    """Return a colour for each target, the same in every shot."""
    names = dict.fromkeys(one.target for one in residuals)
    return {name: SERIES[i % len(SERIES)] for i, name in enumerate(names)}


def _draw_sight(axes: Axes, one: CornerResiduals, factor: float, color: str) -> None:
    lon, lat = _angles(one.bearings)
    end_lon, end_lat = _angles(one.bearings + one.offsets)
    # Along a parallel a degree is shorter than on the equator; arrows keep their true direction and length.
    across = ((end_lon - lon + 180) % 360 - 180) * np.cos(np.radians(lat)) * factor
    up = (end_lat - lat) * factor
    axes.quiver(lon, lat, across, up, color=color, angles="xy", scale_units="xy", scale=1, width=0.0016, headwidth=4)
    axes.plot(lon[one.used], lat[one.used], "o", color=color, markersize=2.5, label=one.target)
    axes.plot(lon[~one.used], lat[~one.used], "x", color=FAINT, markersize=6)
    axes.annotate(
        one.target,
        (float(np.median(lon)), float(lat.max()) + 4),
        color=INK,
        size=10,
        ha="center",
        annotation_clip=True,
    )


def _angles(rays: FloatArray) -> tuple[FloatArray, FloatArray]:
    lon = np.degrees(np.arctan2(rays[:, 1], rays[:, 0]))
    return lon, np.degrees(np.arctan2(rays[:, 2], np.hypot(rays[:, 0], rays[:, 1])))


def polar_figure(residuals: Sequence[CornerResiduals]) -> Figure:
    """Draw the residuals over the angle off the camera's x axis, radial and tangential part."""
    figure = new_figure(560)
    add_text(figure, _LEFT, 14, "Residuals by polar angle", size=13, bold=True)
    line = (
        "Angle off the camera's x axis (image centre). A bend or a step here is the lens or the stitching, not noise"
    )
    add_text(figure, _LEFT, 40, line, size=10.5)
    parts = ("away from the axis", "around the axis")
    rows = [add_axes(figure, _WIDE_LEFT, _HEAD + i * 205, WIDTH_PX - _WIDE_LEFT - _RIGHT, 180) for i in range(2)]
    colors = _colors(residuals)
    for one in residuals:
        polar = np.degrees(np.arccos(np.clip(one.bearings[:, 0], -1, 1)))
        around = np.cross([1.0, 0.0, 0.0], one.bearings)
        around /= np.maximum(np.linalg.norm(around, axis=-1, keepdims=True), 1e-9)
        away = np.cross(around, one.bearings)
        for axes, direction in zip(rows, (away, around), strict=True):
            values = np.degrees((one.offsets * direction).sum(-1))[one.used]
            axes.plot(polar[one.used], values, "o", color=colors[one.target], markersize=4, label=one.target)
    for axes, part in zip(rows, parts, strict=True):
        axes.axhline(0.0, color=INK, linewidth=0.8)
        axes.set_xlim(0, 180)
        axes.set_ylabel(f"{part} (\N{DEGREE SIGN})")
        axes.grid(color=GRID, linewidth=0.6)
    rows[0].set_xticklabels([])
    rows[1].set_xlabel("polar angle (\N{DEGREE SIGN})")
    add_legend(figure, 525, rows[0], columns=10)
    return figure


def correlation_figure(solution: Extrinsics) -> Figure:
    """Draw the correlations of the six numbers."""
    figure = new_figure(470)
    add_text(figure, _LEFT, 14, "Correlations of the six numbers", size=13, bold=True)
    line = "Near 1 or -1 two of them cannot be told apart with these targets"
    add_text(figure, _LEFT, 40, line, size=10.5)
    axes = add_axes(figure, _LEFT, _HEAD, WIDTH_PX - _LEFT - _RIGHT, 350)
    axes.imshow(solution.correlation, cmap="RdBu_r", vmin=-1, vmax=1, aspect="auto")
    axes.set_xticks(range(6), NAMES)
    axes.set_yticks(range(6), NAMES)
    for (row, column), value in np.ndenumerate(solution.correlation):
        color = "white" if abs(value) > 0.6 else INK
        axes.text(column, row, f"{round(value, 2) + 0.0:.2f}", ha="center", va="center", size=9.5, color=color)
    return figure


def left_out_figure(left_out: Sequence[LeftOut]) -> Figure:
    """Draw how the pose moves without each target, in standard deviations."""
    figure = new_figure(420)
    add_text(figure, _LEFT, 14, "Without one target", size=13, bold=True)
    line = "How far the pose moves, in standard deviations of the full result; beyond 2 is worth a look"
    add_text(figure, _LEFT, 40, line, size=10.5)
    axes = add_axes(figure, _LEFT, _HEAD, WIDTH_PX - _LEFT - _RIGHT, 260)
    axes.axhspan(-2, 2, color="#eef3f8", zorder=0)
    axes.axhline(0.0, color=INK, linewidth=0.8)
    places = np.arange(len(left_out))
    for i, name in enumerate(NAMES):
        values = [one.shift_in_sigma[i] for one in left_out]
        axes.bar(places + (i - 2.5) * 0.12, values, 0.11, color=SERIES[i], label=name)
    axes.set_xticks(places, [one.target for one in left_out])
    axes.set_ylabel("shift (sigma)")
    limit = max(2.4, *(1.1 * float(np.abs(one.shift_in_sigma).max()) for one in left_out))
    axes.set_ylim(-limit, limit)
    add_legend(figure, 372, axes, columns=6)
    return figure
