"""The frames of forklift, camera and pallet, from above and from the side."""

import matplotlib.pyplot as plt
from matplotlib.axes import Axes
from matplotlib.patches import Polygon

AXIS_COLORS = {"x": "tab:red", "y": "tab:green", "z": "tab:blue"}
Point = tuple[float, float]


def draw_axes(axes: Axes, origin: Point, name: str, **directions: Point) -> None:
    for label, (dx, dy) in directions.items():
        tip = (origin[0] + dx, origin[1] + dy)
        arrow = {"arrowstyle": "-|>", "color": AXIS_COLORS[label], "linewidth": 2, "shrinkA": 0, "shrinkB": 0}
        axes.annotate("", xy=tip, xytext=origin, arrowprops=arrow)
        where = (origin[0] + 1.2 * dx, origin[1] + 1.2 * dy)
        axes.text(*where, label, color=AXIS_COLORS[label], ha="center", va="center", weight="bold")
    axes.plot(*origin, "ko", markersize=4)
    axes.annotate(name, origin, xytext=(-4, -14), textcoords="offset points", ha="right", family="monospace")


def draw_outline(axes: Axes, *corners: Point) -> None:
    axes.add_patch(Polygon(corners, closed=True, facecolor="0.92", edgecolor="0.6"))


figure, (top, side) = plt.subplots(2, 1, figsize=(8, 7.5), layout="constrained")

# From above: forward is to the right, left is up.
draw_outline(top, (-1.2, -0.6), (0.9, -0.6), (0.9, 0.6), (-1.2, 0.6))
draw_outline(top, (3.4, 0.45), (4.5, 0.65), (4.3, 1.75), (3.2, 1.55))
draw_axes(top, (0.0, 0.0), "forklift", x=(0.7, 0.0), y=(0.0, 0.7))
draw_axes(top, (0.6, -0.25), "camera", x=(0.7, 0.0), y=(0.0, 0.7))
draw_axes(top, (3.3, 1.0), "pallet", x=(0.69, 0.125), y=(-0.125, 0.69))
top.set(title="from above", xlim=(-1.6, 5.0), ylim=(-1.0, 2.1), aspect="equal")

# From the side: forward is to the right, up is up.
draw_outline(side, (-1.2, 0.1), (0.9, 0.1), (0.9, 1.7), (-1.2, 1.7))
draw_outline(side, (3.3, 0.6), (4.4, 0.6), (4.4, 0.744), (3.3, 0.744))
side.axhline(0.0, color="0.3")
side.text(1.5, 0.05, "floor", color="0.3")
side.plot([3.25, 4.5], [0.58, 0.58], color="0.3")
side.text(3.7, 0.4, "beam", color="0.3")
draw_axes(side, (0.0, 0.0), "forklift", x=(0.7, 0.0), z=(0.0, 0.7))
draw_axes(side, (0.6, 1.9), "camera", x=(0.7, 0.0), z=(0.0, 0.7))
draw_axes(side, (3.3, 0.6), "pallet", x=(0.7, 0.0), z=(0.0, 0.7))
side.set(title="from the side", xlim=(-1.6, 5.0), ylim=(-0.4, 2.9), aspect="equal")

for view in (top, side):
    view.set_xticks([])
    view.set_yticks([])
    view.spines[:].set_visible(False)
plt.show()
