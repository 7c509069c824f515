"""The aisle from above: camera, shelf, and the pallets with what is not known of them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse, Polygon

from palletloc.drawing import canvas
from palletloc.geometry import FloatArray, LevelPose
from palletloc.mounting import Mounting
from palletloc.pallet import PalletModel
from palletloc.shelf import ShelfPlane

Placed = tuple[str, PalletModel, LevelPose, FloatArray]
"""A pallet's name, model, ``forklift_from_pallet`` and (4, 4) covariance."""

_LEFT, _RIGHT, _HEAD, _FOOT = 70, 20, 72, 84
"""Borders of the map, in pixels."""
_LEAST_PX, _MOST_PX = 380, 640
"""Least and most height of the map, in pixels."""
_AROUND = 0.6
"""Room around what is drawn, in metres."""
_WHISKER = 0.9
"""Length of a fan, in metres: to be seen beside its pallet, and short of the next."""
_MAGNIFICATIONS = (1, 2, 5, 10, 20, 50, 100)
"""Factors by which ellipses and fans may be drawn larger: those that people read easily."""
_CLEAR, _LARGEST = 0.12, 0.5
"""Half axis of three standard deviations that is easy to see, and the most that magnifying makes of it, in metres."""
_LARGEST_FAN = 1.4
"""The most for half the angle of a fan, in radians: less than a right angle."""
_ROW, _TABLE_HEAD = 22, 30
"""Height of a row of the table and of its head, in pixels."""
_COLUMNS = (
    ("pallet", 10, "left"),
    ("height m", 200, "right"),
    ("ahead m", 320, "right"),
    ("left m", 440, "right"),
    ("long half axis mm", 610, "right"),
    ("short half axis mm", 780, "right"),
    (f"height {canvas.SIGMA} mm", 920, "right"),
    (f"yaw {canvas.DEGREE}", 1040, "right"),
    (f"yaw {canvas.SIGMA} {canvas.DEGREE}", 1170, "right"),
)
"""Title, place in pixels, alignment."""
_NAME_PLACES = [(depth, side) for side in (0.0, 0.28, -0.28) for depth in (0.75, 0.5, 0.3)]
"""Where a name may stand, in parts of the pallet's depth and width, the best first."""
_NAME_ROOM = (0.30, 0.16)
"""Width and height that a name takes, in metres at 150 pixels per metre."""


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
        Ahead is to the right, the forklift's left is up. Ellipses and fans show one and three standard deviations
        of position and yaw, all of them magnified by one factor that the figure states: sizes can be compared.
    """
    corners = [_corners(model, pose) for _, model, pose, _ in pallets]
    x, y, _ = mounting.center
    places = np.concatenate([[[0.0, 0.0], [x, y]], *corners])
    low, high = places.min(axis=0) - _AROUND, places.max(axis=0) + _AROUND
    width, height, scale = _page(low, high)
    spare = (width / scale - (high - low)[0]) / 2, (height / scale - (high - low)[1]) / 2
    table = _TABLE_HEAD + _ROW * len(pallets) if pallets else 0
    figure = canvas.new_figure(_HEAD + height + _FOOT + table)
    axes = canvas.add_axes(figure, _LEFT, _HEAD, width, height)
    axes.set(
        xlim=(low[0] - spare[0], high[0] + spare[0]),
        ylim=(low[1] - spare[1], high[1] + spare[1]),
        xlabel="ahead of the forklift's reference point (m)",
        ylabel="to its left (m)",
    )
    axes.grid(color=canvas.GRID, linewidth=0.6)
    axes.set_axisbelow(True)
    if shelf is not None:
        _draw_shelf(axes, shelf)
    _draw_forklift(axes, mounting)
    larger, names = _magnification([covariance for *_, covariance in pallets]), list[FloatArray]()
    for i, pallet in enumerate(sorted(pallets, key=lambda pallet: pallet[2].x)):
        _draw_pallet(axes, pallet, canvas.SERIES[i % len(canvas.SERIES)], larger)
        names.append(_write_name(axes, pallet, canvas.SERIES[i % len(canvas.SERIES)], names, 150 / scale))
    canvas.add_text(figure, _LEFT, 14, "The aisle from above, in the forklift's frame", size=13, bold=True)
    drawn = f"all drawn {larger} times as large" if larger > 1 else "to scale"
    line = f"Ellipses: position, fans: yaw; one and three standard deviations, {drawn}"
    canvas.add_text(figure, _LEFT, 40, line, size=10.5)
    canvas.add_legend(figure, _HEAD + height + 50, axes)
    if pallets:
        _draw_table(figure, _HEAD + height + _FOOT, pallets)
    return figure


def _page(low: FloatArray, high: FloatArray) -> tuple[float, float, float]:
    """Return width and height of the map in pixels, and pixels per metre."""
    width = float(canvas.WIDTH_PX - _LEFT - _RIGHT)
    size = high - low
    scale = min(width / size[0], _MOST_PX / size[1])
    return width, max(float(size[1] * scale), _LEAST_PX), float(scale)


def _magnification(covariances: Sequence[FloatArray]) -> int:
    """Return how many times as large ellipses and fans are drawn: as little as makes the smallest easy to see.

    Where the largest would become too large by that, it is the most that this one allows.
    """
    if not covariances:
        return 1
    axes = [3 * float(_half_axes(covariance)[0]) for covariance in covariances]
    angle = max(3 * float(np.sqrt(covariance[3, 3])) for covariance in covariances)
    fitting = [times for times in _MAGNIFICATIONS if times * max(axes) <= _LARGEST and times * angle <= _LARGEST_FAN]
    return next((times for times in fitting if times * min(axes) >= _CLEAR), (fitting or [1])[-1])


def _half_axes(covariance: FloatArray) -> FloatArray:
    """Return the half axes of the ellipse of one standard deviation on the floor, (2,), longer first, in metres."""
    return np.asarray(np.sqrt(np.maximum(np.linalg.eigvalsh(covariance[:2, :2])[::-1], 0.0)))


def _corners(model: PalletModel, pose: LevelPose) -> FloatArray:
    """Return the four corners from above, the front's left one first, (4, 2)."""
    half = model.width / 2
    corners = np.array([[0, half, 0], [0, -half, 0], [model.depth, -half, 0], [model.depth, half, 0]])
    return np.asarray(pose.transform().apply(corners)[:, :2])


def _draw_pallet(axes: Axes, pallet: Placed, color: str, larger: int) -> None:
    _, model, pose, covariance = pallet
    corners = _corners(model, pose)
    axes.add_patch(Polygon(corners, facecolor=color, alpha=0.10, edgecolor="none"))
    axes.add_patch(Polygon(corners, fill=False, edgecolor=color, linewidth=0.9, alpha=0.7))
    axes.plot(*corners[:2].T, color=color, linewidth=3.2, solid_capstyle="butt")
    for count, alpha in ((3, 0.16), (1, 0.34)):
        axes.add_patch(_fan(pose, count * larger * float(np.sqrt(covariance[3, 3])), color, alpha))
        axes.add_patch(_ellipse(pose, covariance, count * larger, color))
    axes.plot(pose.x, pose.y, "o", color=color, markersize=3)


def _write_name(axes: Axes, pallet: Placed, color: str, others: Sequence[FloatArray], size: float) -> FloatArray:
    """Write a name into its pallet where none of the others stands, and return where."""
    name, model, pose, _ = pallet
    inside = [[depth * model.depth, side * model.width, 0.0] for depth, side in _NAME_PLACES]
    places = pose.transform().apply(inside)[:, :2]
    room = size * np.array(_NAME_ROOM)
    free = [place for place in places if not any((np.abs(place - other) < room).all() for other in others)]
    place = np.asarray(free[0] if free else places[0])
    text = axes.text(float(place[0]), float(place[1]), name, ha="center", va="center", size=12)
    text.set(color=color, weight="bold", parse_math=False)
    return place


def _fan(pose: LevelPose, reach: float, color: str, alpha: float) -> Polygon:
    """Return the sector in which the pallet's axis lies, drawn into the aisle."""
    angles = pose.yaw + np.pi + np.linspace(-min(reach, np.pi), min(reach, np.pi), 31)
    rim = np.stack([pose.x + _WHISKER * np.cos(angles), pose.y + _WHISKER * np.sin(angles)], axis=-1)
    points = np.vstack([[pose.x, pose.y], rim])
    return Polygon(points, facecolor=(color, alpha), edgecolor=color, linewidth=0.7)


def _ellipse(pose: LevelPose, covariance: FloatArray, times: int, color: str) -> Ellipse:
    """Return the ellipse of one standard deviation, so many times as large."""
    vectors = np.linalg.eigh(covariance[:2, :2])[1]
    major, minor = 2 * times * _half_axes(covariance)
    angle = float(np.degrees(np.arctan2(vectors[1, 1], vectors[0, 1])))
    return Ellipse((pose.x, pose.y), major, minor, angle=angle, fill=False, edgecolor=color, linewidth=1.6)


def _draw_table(figure: Figure, top: float, pallets: Sequence[Placed]) -> None:
    """Write the numbers behind the map."""
    width = canvas.WIDTH_PX - _LEFT - _RIGHT
    axes = canvas.add_axes(figure, _LEFT, top, width, _ROW * (len(pallets) + 1))
    axes.set(xlim=(0, width), ylim=(len(pallets) + 0.5, -0.5))
    axes.set_axis_off()
    axes.axhline(0.5, color=canvas.GRID, linewidth=1.2)
    colors = {
        pallet[0]: canvas.SERIES[i % len(canvas.SERIES)]
        for i, pallet in enumerate(sorted(pallets, key=lambda pallet: pallet[2].x))
    }
    for title, at, align in _COLUMNS:
        axes.text(at, 0, title, ha=align, va="center", size=9.5, color=canvas.FAINT)
    for row, (name, _, pose, covariance) in enumerate(pallets, start=1):
        long, short = 1000 * _half_axes(covariance)
        rise, turn = 1000 * np.sqrt(covariance[2, 2]), np.degrees(np.sqrt(covariance[3, 3]))
        values = (round(value, 3) + 0.0 for value in (pose.z, pose.x, pose.y))
        cells = [name, *(f"{value:.3f}" for value in values), f"{long:.1f}", f"{short:.1f}", f"{rise:.1f}"]
        cells += [f"{np.degrees(pose.yaw):.2f}", f"{turn:.3f}"]
        for cell, (_, at, align) in zip(cells, _COLUMNS, strict=True):
            text = axes.text(
                at,
                row,
                cell.replace("-", canvas.MINUS),
                ha=align,
                va="center",
                size=9.5,
                color=canvas.INK,
                parse_math=False,
            )
            if at == _COLUMNS[0][1]:
                text.set(color=colors[name], weight="bold")


def _draw_shelf(axes: Axes, shelf: ShelfPlane) -> None:
    along = np.array([-np.sin(shelf.facing), np.cos(shelf.facing)])
    ends = np.array([shelf.x, shelf.y]) + np.array([[-30.0], [30.0]]) * along
    axes.plot(*ends.T, color=canvas.FAINT, linewidth=1.2, linestyle=(0, (8, 4)), label="nominal front of the shelf")


def _draw_forklift(axes: Axes, mounting: Mounting) -> None:
    x, y, _ = mounting.center
    arrow = {"arrowstyle": "-|>", "color": canvas.INK, "linewidth": 1.4}
    axes.annotate("", xy=(0.42, 0.0), xytext=(0.0, 0.0), arrowprops=arrow)
    axes.plot(0.0, 0.0, "s", color=canvas.INK, markersize=6, label="forklift's reference point, facing ahead")
    axes.plot(x, y, "o", color="white", markeredgecolor=canvas.INK, markersize=8, label="camera")
