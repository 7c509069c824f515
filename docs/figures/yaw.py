"""Yaw of pallets, and the facing of the shelf plane."""

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.patches import Arc, Polygon

from palletloc.geometry import FloatArray

FACING_DEG = -100.0
TURNS_DEG = (0.0, 12.0)
WIDTH, DEPTH = 1.1, 1.1


def at(point: FloatArray) -> tuple[float, float]:
    return float(point[0]), float(point[1])


figure, axes = plt.subplots(figsize=(8, 5.5), layout="constrained")
facing = np.radians(FACING_DEG)
normal = np.array([np.cos(facing), np.sin(facing)])
along = np.array([-normal[1], normal[0]])
shelf = np.array([3.0, 2.0])

ends = np.stack([shelf - 2.4 * along, shelf + 2.4 * along])
axes.plot(*ends.T, color="0.3", linewidth=1.5)
axes.text(*at(ends[0] + np.array([0.02, 0.12])), "shelf plane", color="0.3", ha="left")
axes.annotate(
    "", xy=at(shelf + 0.9 * normal), xytext=at(shelf), arrowprops={"arrowstyle": "-|>", "color": "tab:purple"}
)
axes.text(*at(shelf + 1.02 * normal), "facing", color="tab:purple", ha="center", va="top")

for place, turn in zip((-1.2, 1.2), TURNS_DEG, strict=True):
    origin = shelf + place * along
    yaw = facing + np.pi + np.radians(turn)
    into, left = np.array([np.cos(yaw), np.sin(yaw)]), np.array([-np.sin(yaw), np.cos(yaw)])
    corners = [origin + s * WIDTH / 2 * left + d * DEPTH * into for s, d in ((1, 0), (-1, 0), (-1, 1), (1, 1))]
    axes.add_patch(Polygon(corners, closed=True, facecolor="0.92", edgecolor="0.6"))
    axes.annotate(
        "", xy=at(origin + 0.8 * into), xytext=at(origin), arrowprops={"arrowstyle": "-|>", "color": "tab:red"}
    )
    axes.plot([origin[0], origin[0] + 0.9], [origin[1], origin[1]], ":", color="0.5")
    axes.add_patch(Arc(at(origin), 0.9, 0.9, theta1=0, theta2=np.degrees(yaw), color="tab:red"))
    label = f"yaw {np.degrees(yaw):.0f} deg" + (f"\n= facing + 180 {turn:+.0f}" if turn else "\n= facing + 180")
    axes.text(*at(origin + np.array([0.5, 0.16])), label, color="tab:red")
    axes.plot(*origin, "ko", markersize=4)

for direction, name, color in (((0.8, 0.0), "x", "tab:red"), ((0.0, 0.8), "y", "tab:green")):
    axes.annotate("", xy=direction, xytext=(0, 0), arrowprops={"arrowstyle": "-|>", "color": color})
    axes.text(direction[0] * 1.1, direction[1] * 1.1, name, color=color, ha="center", va="center", weight="bold")
axes.text(-0.08, -0.08, "forklift", ha="right", va="top", family="monospace")
axes.plot(0, 0, "ko", markersize=4)
axes.set(xlim=(-0.8, 5.9), ylim=(-0.4, 3.9), aspect="equal")
axes.set_axis_off()
plt.show()
