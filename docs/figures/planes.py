"""A vertical and a horizontal plane view with their axes, and the pixels of a grid."""

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Rectangle

from palletloc.plane import PlaneGrid

WIDTH, HEIGHT, DEPTH = 1.1, 0.144, 0.6


def draw_axes(axes: Axes, right: str, up: str, toward: str) -> None:
    for direction, label in (((0.35, 0.0), f"right = {right}"), ((0.0, 0.35), f"up = {up}")):
        axes.annotate("", xy=direction, xytext=(0, 0), arrowprops={"arrowstyle": "-|>", "linewidth": 2})
        axes.text(direction[0] + 0.03, direction[1] + 0.02, label)
    axes.plot(0, 0, "ko", markersize=4)
    axes.text(0.0, -0.07, f"towards the viewer = {toward}", ha="center", va="top", color="0.4")
    axes.set_aspect("equal")
    axes.set_axis_off()


figure, (face, floor, pixels) = plt.subplots(1, 3, figsize=(9.5, 3.4), layout="constrained")

face.add_patch(Rectangle((-WIDTH / 2, 0), WIDTH, HEIGHT, facecolor="0.85", edgecolor="0.5"))
for center in (-0.265, 0.265):
    face.add_patch(Rectangle((center - 0.145, 0.024), 0.29, 0.092, facecolor="white", edgecolor="0.5"))
draw_axes(face, "-y", "z", "-x")
face.set(title="vertical: from the aisle", xlim=(-0.65, 0.75), ylim=(-0.3, 0.8))

floor.add_patch(Rectangle((-WIDTH / 2, 0), WIDTH, DEPTH, facecolor="0.85", edgecolor="0.5"))
draw_axes(floor, "-y", "x", "z")
floor.set(title="horizontal: from above", xlim=(-0.65, 0.75), ylim=(-0.3, 0.8))

grid = PlaneGrid(left=-0.2, top=0.1, resolution=0.1, columns=5, rows=3)
columns, rows = np.meshgrid(np.arange(grid.columns), np.arange(grid.rows))
centers = grid.points(np.stack([columns, rows], -1).astype(float)).reshape(-1, 2)
pixels.plot(*centers.T, "k+")
for right, up in centers:
    corner = (right - grid.resolution / 2, up - grid.resolution / 2)
    pixels.add_patch(Rectangle(corner, grid.resolution, grid.resolution, fill=False, edgecolor="0.7"))
for column, row in ((0, 0), (grid.columns - 1, 0), (0, grid.rows - 1)):
    right, up = grid.points(np.array([float(column), float(row)]))
    pixels.text(right, up + 0.01, f"({column}, {row})", ha="center", va="bottom", fontsize=7)
pixels.set(title="a grid: (column, row) at metres", xlabel="right / m", ylabel="up / m", aspect="equal")
pixels.set(xlim=(-0.28, 0.28), ylim=(-0.18, 0.18))
plt.show()
