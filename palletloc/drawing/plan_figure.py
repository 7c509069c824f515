"""The aisle from above: camera, shelf, and the pallets with what is not known of them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse, Polygon

from palletloc.drawing.canvas import (
    FAINT,
    GRID,
    INK,
    SERIES,
    WIDTH_PX,
    add_axes,
    add_legend,
    add_text,
    new_figure,
)
from palletloc.geometry import FloatArray, LevelPose
from palletloc.mounting import Mounting
from palletloc.pallet import PalletModel
from palletloc.shelf import ShelfPlane

Placed = tuple[str, PalletModel, LevelPose, FloatArray]
"""A pallet's name, model, ``forklift_from_pallet`` and (4, 4) covariance."""

_LEFT, _RIGHT, _HEAD, _FOOT = 70, 20, 72, 84  # in pixels
_LEAST_PX, _MOST_PX = 380, 640
_AROUND = 0.6  # metres
_WHISKER = 0.9  # metres
_MAGNIFICATIONS = (1, 2, 5, 10, 20, 50, 100)
_LARGEST, _WIDEST = 0.6, 0.3
"""How far ellipses and fans are magnified: half axis in metres, half angle in radians."""
_NAME_DEPTHS = (0.82, 0.52)
"""Where the names stand, in parts of the pallet's depth: neighbours may overlap."""


def plan_figure(pallets: Sequence[Placed], mounting: Mounting, shelf: ShelfPlane | None) -> Figure:
    """Draw measured pallets on a map in the forklift frame.

    Parameters
    ----------
    pallets : sequence of (str, PalletModel, LevelPose, (4, 4) array)
        What was measured.
    mounting : Mounting
        Where the camera is.
    shelf : ShelfPlane or None
        Nominal front plane in the forklift frame.

    Returns
    -------
    Figure
        Ahead is to the right, the forklift's left is up. Ellipses and fans show two standard deviations of
        position and yaw, magnified by a factor that the figure tells.
    """
    corners = [_corners(model, pose) for _, model, pose, _ in pallets]
    x, y, _ = mounting.center
    places = np.concatenate([[[0.0, 0.0], [x, y]], *corners])
    low, high = places.min(axis=0) - _AROUND, places.max(axis=0) + _AROUND
    width, height, scale = _page(low, high)
    spare = (width / scale - (high - low)[0]) / 2, (height / scale - (high - low)[1]) / 2
    figure = new_figure(_HEAD + height + _FOOT)
    axes = add_axes(figure, _LEFT, _HEAD, width, height)
    axes.set(
        xlim=(low[0] - spare[0], high[0] + spare[0]),
        ylim=(low[1] - spare[1], high[1] + spare[1]),
        xlabel="ahead of the forklift's reference point (m)",
        ylabel="to its left (m)",
    )
    axes.grid(color=GRID, linewidth=0.6)
    axes.set_axisbelow(True)
    factor = _magnification([covariance for *_, covariance in pallets])
    if shelf is not None:
        _draw_shelf(axes, shelf)
    _draw_forklift(axes, mounting)
    for i, pallet in enumerate(sorted(pallets, key=lambda one: one[2].x)):
        _draw_pallet(axes, pallet, SERIES[i % len(SERIES)], factor)
        _write_name(axes, pallet, SERIES[i % len(SERIES)], _NAME_DEPTHS[i % 2])
    add_text(figure, _LEFT, 14, "The aisle from above, in the forklift's frame", size=13, bold=True)
    times = f"{factor} times as large as they are" if factor > 1 else "at their true size"
    line = f"Ellipses: position, fans: yaw; both two standard deviations, drawn {times}"
    add_text(figure, _LEFT, 40, line, size=10.5)
    add_legend(figure, _HEAD + height + 50, axes)
    return figure


def _page(low: FloatArray, high: FloatArray) -> tuple[float, float, float]:
    """Return width and height of the map in pixels, and pixels per metre."""
    width = float(WIDTH_PX - _LEFT - _RIGHT)
    size = high - low
    scale = min(width / size[0], _MOST_PX / size[1])
    return width, max(float(size[1] * scale), _LEAST_PX), float(scale)


def _magnification(covariances: Sequence[FloatArray]) -> int:
    """Return the largest factor at which no ellipse and no fan gets out of hand."""
    if not covariances:
        return 1
    largest = max(2 * float(np.sqrt(np.linalg.eigvalsh(c[:2, :2])[-1])) for c in covariances)
    widest = max(2 * float(np.sqrt(c[3, 3])) for c in covariances)
    fitting = [m for m in _MAGNIFICATIONS if m * largest <= _LARGEST and m * widest <= _WIDEST]
    return fitting[-1] if fitting else 1


def _corners(model: PalletModel, pose: LevelPose) -> FloatArray:
    """Return the four corners from above, the front's left one first, (4, 2)."""
    half = model.width / 2
    corners = np.array([[0, half, 0], [0, -half, 0], [model.depth, -half, 0], [model.depth, half, 0]])
    return np.asarray(pose.transform().apply(corners)[:, :2])


def _draw_pallet(axes: Axes, pallet: Placed, color: str, factor: int) -> None:
    _, model, pose, covariance = pallet
    corners = _corners(model, pose)
    axes.add_patch(Polygon(corners, facecolor=color, alpha=0.10, edgecolor="none"))
    axes.add_patch(Polygon(corners, fill=False, edgecolor=color, linewidth=0.9, alpha=0.7))
    axes.plot(*corners[:2].T, color=color, linewidth=3.2, solid_capstyle="butt")
    axes.add_patch(_fan(pose, 2 * factor * float(np.sqrt(covariance[3, 3])), color))
    axes.add_patch(_ellipse(pose, covariance, factor, color))
    axes.plot(pose.x, pose.y, "o", color=color, markersize=3)


def _write_name(axes: Axes, pallet: Placed, color: str, depth: float) -> None:
    name, model, pose, _ = pallet
    x, y, _ = pose.transform().apply([depth * model.depth, 0.0, 0.0])
    text = axes.text(x, y, f"{name}\n{round(pose.z, 2) + 0.0:.2f} m up", ha="center", va="center")
    text.set(size=10, color=color, weight="bold", parse_math=False)


def _fan(pose: LevelPose, reach: float, color: str) -> Polygon:
    """Return the sector in which the pallet's axis lies, drawn into the aisle."""
    angles = pose.yaw + np.pi + np.linspace(-min(reach, np.pi), min(reach, np.pi), 31)
    rim = np.stack([pose.x + _WHISKER * np.cos(angles), pose.y + _WHISKER * np.sin(angles)], axis=-1)
    points = np.vstack([[pose.x, pose.y], rim])
    return Polygon(points, facecolor=color, alpha=0.28, edgecolor=color, linewidth=0.8)


def _ellipse(pose: LevelPose, covariance: FloatArray, factor: int, color: str) -> Ellipse:
    values, vectors = np.linalg.eigh(covariance[:2, :2])
    minor, major = 4 * factor * np.sqrt(np.maximum(values, 0.0))
    angle = float(np.degrees(np.arctan2(vectors[1, 1], vectors[0, 1])))
    return Ellipse((pose.x, pose.y), major, minor, angle=angle, fill=False, edgecolor=color, linewidth=1.8)


def _draw_shelf(axes: Axes, shelf: ShelfPlane) -> None:
    along = np.array([-np.sin(shelf.facing), np.cos(shelf.facing)])
    ends = np.array([shelf.x, shelf.y]) + np.array([[-30.0], [30.0]]) * along
    axes.plot(*ends.T, color=FAINT, linewidth=1.2, linestyle=(0, (8, 4)), label="nominal front of the shelf")


def _draw_forklift(axes: Axes, mounting: Mounting) -> None:
    x, y, _ = mounting.center
    arrow = {"arrowstyle": "-|>", "color": INK, "linewidth": 1.4}
    axes.annotate("", xy=(0.42, 0.0), xytext=(0.0, 0.0), arrowprops=arrow)
    axes.plot(0.0, 0.0, "s", color=INK, markersize=6, label="forklift's reference point, facing ahead")
    axes.plot(x, y, "o", color="white", markeredgecolor=INK, markersize=8, label="camera")
