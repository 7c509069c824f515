"""Names beside points of a chart, where they cover neither points nor each other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes

from palletloc.drawing.canvas import DPI, FAINT, INK
from palletloc.geometry import FloatArray

_POINT_PX, _GAP_PX = 10.0, 3.0
_SIDES = ((1, 1), (-1, 1), (1, -1), (-1, -1), (1, 0), (-1, 0), (0, 1), (0, -1))
"""Directions in which a name is tried, the best first."""


@dataclass(frozen=True, slots=True)
class Label:
    """A point and its name."""

    x: float
    """In the chart's unit."""
    y: float
    """In the chart's unit."""
    text: str
    """The name."""
    important: bool = False
    """Whether it is placed first and written large, and stays even where there is no room."""


def write_labels(axes: Axes, labels: Sequence[Label]) -> None:
    """Write names beside their points; one that finds no room is left out.

    Parameters
    ----------
    axes : Axes
        With its final limits and place.
    labels : sequence of Label
        All points of the chart.
    """
    places = axes.transData.transform([(label.x, label.y) for label in labels] or np.zeros((0, 2)))
    taken = [_box(place, (_POINT_PX, _POINT_PX)) for place in places]
    for label, place in sorted(zip(labels, places, strict=True), key=lambda pair: not pair[0].important):
        size, weight, color = (10, "bold", INK) if label.important else (8, "normal", FAINT)
        extent = (0.72 * len(label.text) * size * DPI / 72, 1.15 * size * DPI / 72)
        center = _free_place(axes, place, extent, taken)
        if center is None and not label.important:
            continue
        middle = place + np.array([0.0, 14.0]) if center is None else center
        taken.append(_box(middle, extent))
        x, y = axes.transData.inverted().transform(middle)
        axes.text(x, y, label.text, ha="center", va="center", size=size, weight=weight, color=color)


def _free_place(
    axes: Axes, point: FloatArray, extent: tuple[float, float], taken: Sequence[FloatArray]
) -> FloatArray | None:
    """Return the middle of a name beside a point that covers nothing, None where there is none."""
    reach = np.array(extent) / 2 + _POINT_PX / 2 + _GAP_PX
    window = np.array(axes.bbox.extents)
    for side in _SIDES:
        center = point + np.array(side) * reach
        box = _box(center, extent)
        inside = (box[:2] >= window[:2]).all() and (box[2:] <= window[2:]).all()
        if inside and not any(_overlap(box, other) for other in taken):
            return np.asarray(center)
    return None


def _box(center: FloatArray, extent: tuple[float, float]) -> FloatArray:
    half = np.array(extent) / 2
    return np.concatenate([center - half, center + half])


def _overlap(one: FloatArray, other: FloatArray) -> bool:
    return bool((one[:2] < other[2:]).all() and (other[:2] < one[2:]).all())
