"""What is left of each corner after the fit: in degrees, in pixels, in millimetres at two metres, and drawn."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from calibration.bearings import tangent_axes
from calibration.mounting.fit import MountingFit
from calibration.report_figure import HEAD, titled_figure, wide_axes
from calibration.targets.observations import TargetObservation
from palletloc.drawing.canvas import FAINT, GRID, INK, SERIES, add_legend
from palletloc.geometry import BoolArray, FloatArray

_REFERENCE_RANGE = 2.0
"""Where angles are told as lengths, in metres: about as far as pallets are measured."""
_ARROW_DEG = 5.0
"""Length of the longest arrow on the sphere, in degrees."""
_POLAR_LEFT = 104
"""Left margin where the axis has long names, in pixels."""


@dataclass(frozen=True, slots=True, eq=False)
class CornerResiduals:
    """Of one target in one shot."""

    target: str
    """Its name."""
    shot: str
    """The shot's file."""
    bearings: FloatArray
    """(n, 3) of its corners in the camera frame."""
    offsets: FloatArray
    """(n, 3) fitted minus measured unit vector, in radians."""
    pixel_angle: FloatArray
    """(n,) radians per pixel."""
    pixels: FloatArray
    """(n, 2) where the corners are seen."""
    used: BoolArray
    """(n,) whether the fit rests on it."""

    @property
    def angle(self) -> FloatArray:
        """(n,) angles between fitted and measured bearings, in radians."""
        return np.asarray(np.linalg.norm(self.offsets, axis=-1))

    @property
    def rms(self) -> float:
        """Root mean square of one component over the corners used, in radians."""
        return float(np.sqrt((self.angle[self.used] ** 2).mean() / 2)) if self.used.any() else float("nan")

    @property
    def rms_px(self) -> float:
        """The same in pixels."""
        scaled = (self.angle / self.pixel_angle)[self.used]
        return float(np.sqrt((scaled**2).mean() / 2)) if self.used.any() else float("nan")


def corner_residuals(
    solution: MountingFit, observations: Sequence[TargetObservation], names: Sequence[str]
) -> tuple[CornerResiduals, ...]:
    """Return the residuals of all corners, those that the fit refused included.

    The observations are those that it rests on, in the same order; the names are the targets', in its order.
    """
    residuals = []
    for observation, used in zip(observations, solution.kept, strict=True):
        corners, board = observation.corners, solution.poses.boards[names.index(observation.target)]
        points = np.column_stack([corners.points, np.zeros(len(corners.points))])
        rays = solution.poses.camera.inv().apply(board.apply(points)) - corners.origins
        rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
        across = tangent_axes(corners.bearings)
        offsets = np.einsum("nij,nik,nk->nj", across, across, rays)
        residuals.append(
            CornerResiduals(
                observation.target,
                observation.shot,
                corners.bearings,
                offsets,
                corners.pixel_angle,
                corners.pixels,
                used,
            )
        )
    return tuple(residuals)


def at_reference(angle: float) -> float:
    """Return an angle in radians as a length at two metres, in millimetres."""
    return 1000 * _REFERENCE_RANGE * angle


def sphere_figure(residuals: Sequence[CornerResiduals]) -> Figure:
    """Draw where the corners are on the sphere, and which way each is off."""
    largest = max((float(part.angle[part.used].max()) for part in residuals if part.used.any()), default=1e-9)
    factor = _ARROW_DEG / max(np.degrees(largest), 1e-9)
    line = f"Fitted minus measured, drawn {factor:.0f} times as long; crosses were left out. Middle: straight ahead"
    figure = titled_figure(640, "Residuals on the sphere", line)
    axes = wide_axes(figure, 470)
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
    for part in residuals:
        _draw_arrows(axes, part, factor, colors[part.target])
    return figure


def _colors(residuals: Sequence[CornerResiduals]) -> dict[str, str]:
    """Return a colour for each target, the same in every shot."""
    names = dict.fromkeys(part.target for part in residuals)
    return {name: SERIES[i % len(SERIES)] for i, name in enumerate(names)}


def _draw_arrows(axes: Axes, part: CornerResiduals, factor: float, color: str) -> None:
    lon, lat = _angles(part.bearings)
    end_lon, end_lat = _angles(part.bearings + part.offsets)
    # Along a parallel a degree is shorter than on the equator; arrows keep their true direction and length.
    across = ((end_lon - lon + 180) % 360 - 180) * np.cos(np.radians(lat)) * factor
    up = (end_lat - lat) * factor
    axes.quiver(lon, lat, across, up, color=color, angles="xy", scale_units="xy", scale=1, width=0.0016, headwidth=4)
    axes.plot(lon[part.used], lat[part.used], "o", color=color, markersize=2.5, label=part.target)
    axes.plot(lon[~part.used], lat[~part.used], "x", color=FAINT, markersize=6)
    place = float(np.median(lon)), float(lat.max()) + 4
    axes.annotate(part.target, place, color=INK, size=10, ha="center", annotation_clip=True)


def _angles(rays: FloatArray) -> tuple[FloatArray, FloatArray]:
    lon = np.degrees(np.arctan2(rays[:, 1], rays[:, 0]))
    return lon, np.degrees(np.arctan2(rays[:, 2], np.hypot(rays[:, 0], rays[:, 1])))


def polar_figure(residuals: Sequence[CornerResiduals]) -> Figure:
    """Draw the residuals over the angle off the camera's x axis, radial and tangential part."""
    line = (
        "Angle off the camera's x axis (image centre). A bend or a step here is the lens or the stitching, not noise"
    )
    figure = titled_figure(560, "Residuals by polar angle", line)
    rows = [wide_axes(figure, 180, HEAD + i * 205, _POLAR_LEFT) for i in range(2)]
    colors = _colors(residuals)
    for part in residuals:
        polar = np.degrees(np.arccos(np.clip(part.bearings[:, 0], -1, 1)))
        around = np.cross([1.0, 0.0, 0.0], part.bearings)
        around /= np.maximum(np.linalg.norm(around, axis=-1, keepdims=True), 1e-9)
        away = np.cross(around, part.bearings)
        for axes, direction in zip(rows, (away, around), strict=True):
            values = np.degrees((part.offsets * direction).sum(-1))[part.used]
            axes.plot(polar[part.used], values, "o", color=colors[part.target], markersize=4, label=part.target)
    for axes, name in zip(rows, ("away from the axis", "around the axis"), strict=True):
        axes.axhline(0.0, color=INK, linewidth=0.8)
        axes.set_xlim(0, 180)
        axes.set_ylabel(f"{name} (\N{DEGREE SIGN})")
        axes.grid(color=GRID, linewidth=0.6)
    rows[0].set_xticklabels([])
    rows[1].set_xlabel("polar angle (\N{DEGREE SIGN})")
    add_legend(figure, 525, rows[0], columns=10)
    return figure
