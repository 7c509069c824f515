"""An aisle from above as a drawing of lines, which takes its colours from the page around it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import RigidTransform

from palletloc.geometry import FloatArray, LevelPose
from palletloc.pallet import PalletModel
from palletloc.shelf import ShelfPlane

_AROUND = 0.6
"""Room around what is drawn, in metres."""
_DOT = 0.05
"""Radius of a shot's dot, in metres."""
_LEAST_SIDE = 3.0
"""Least height and width of the drawing, in metres."""


@dataclass(frozen=True, slots=True, eq=False)
class Footprint:
    """A pallet to draw."""

    model: PalletModel
    """What it is."""
    odom_from_pallet: RigidTransform
    """Where it is."""

    def corners(self) -> FloatArray:
        """Return its corners on the floor, (4, 2), the two of its front first."""
        half, depth = self.model.width / 2, self.model.depth
        points = np.array([[0, half, 0], [0, -half, 0], [depth, -half, 0], [depth, half, 0]])
        return np.asarray(self.odom_from_pallet.apply(points)[:, :2])


def plan_svg(path: Sequence[LevelPose], pallets: Sequence[Footprint], shelf: ShelfPlane) -> str:
    """Draw a drive along a shelf.

    Parameters
    ----------
    path : sequence of LevelPose
        ``odom_from_forklift`` at the shots, at least one.
    pallets : sequence of Footprint
        What was measured.
    shelf : ShelfPlane
        Its nominal front plane, in odom.

    Returns
    -------
    str
        An ``svg`` element as wide as what is around it, one metre alike in both directions, x to the right.
    """
    corners = [pallet.corners() for pallet in pallets]
    dots = np.array([[pose.x, pose.y] for pose in path])
    low, high = (reach(np.concatenate([dots, *corners]), axis=0) for reach in (np.min, np.max))
    slack = np.maximum(_AROUND, (_LEAST_SIDE - (high - low)) / 2)
    low, high = low - slack, high + slack
    size = high - low
    along = np.array([-np.sin(shelf.facing), np.cos(shelf.facing)])
    front = np.array([shelf.x, shelf.y]) + np.outer([-1e3, 1e3], along)
    lines = [
        f'<path class="grid" d="{_grid(low, high)}"/>',
        f'<path class="shelf" d="{_d(front)}"/>',
        f'<path class="path" d="{_d(dots)}"/>',
        *(f'<path class="pallet" d="{_d(points)}Z"/>' for points in corners),
        f'<path class="front" d="{"".join(_d(points[:2]) for points in corners)}"/>',
        *(f'<circle cx="{x:.3f}" cy="{-y:.3f}" r="{_DOT}"/>' for x, y in dots),
    ]
    box = f"{low[0]:.3f} {-high[1]:.3f} {size[0]:.3f} {size[1]:.3f}"
    return f'<svg class="plan" viewBox="{box}" role="img">\n' + "\n".join(lines) + "\n</svg>"


def _d(points: FloatArray) -> str:
    """Return a line through points, y up."""
    return "M" + "L".join(f"{x:.3f} {-y:.3f}" for x, y in points)


def _grid(low: FloatArray, high: FloatArray) -> str:
    columns = np.arange(np.ceil(low[0]), high[0])
    rows = np.arange(np.ceil(low[1]), high[1])
    return "".join(
        [
            *(_d(np.array([[x, low[1]], [x, high[1]]])) for x in columns),
            *(_d(np.array([[low[0], y], [high[0], y]])) for y in rows),
        ]
    )
