"""Detection: the view of the shelf's nominal front plane, and where pallets were looked for."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from palletloc.candidate import Fit, Refusal
from palletloc.drawing import canvas
from palletloc.drawing.outline import place_outline, seen_on_plane
from palletloc.explained import Named
from palletloc.geometry import FloatArray
from palletloc.plane import PlaneView
from palletloc.shelf_view import ShelfView

_Outlined = tuple[str, Fit | Refusal, list[FloatArray]]
"""A candidate's name, what became of it, and the lines of its face as a view shows them."""

_HALO = canvas.halo(2.5)
"""Around names on the views."""
_ABOVE, _BELOW, _BESIDE = 0.40, 0.30, 0.5
"""Space around the outlines, in metres."""
_LEAST_WIDTH = 4.0
"""Least width of what is drawn of the shelf, in metres: a lone pallet keeps its surroundings."""
_LEFT, _RIGHT, _HEAD, _CHART, _GAP, _FOOT = 62, 20, 50, 150, 46, 44
"""Borders of the page, height of a chart of scores, gap between axes, in pixels."""
_POINT_PX, _GAP_PX = 10.0, 3.0
"""Side of the square that a point takes, and its distance from a name."""
_SIDES = ((1, 1), (-1, 1), (1, -1), (-1, -1), (1, 0), (-1, 0), (0, 1), (0, -1))
"""Directions in which a name is tried, the best first."""


@dataclass(frozen=True, slots=True)
class _Band:
    """One view with the candidates that lie on it."""

    outlines: list[_Outlined]
    """The candidates."""
    view: PlaneView
    """The view."""
    limits: tuple[float, float, float, float]
    """Left, right, bottom and top of what is drawn, in metres."""

    @property
    def width(self) -> float:
        """Width of what is drawn, in metres."""
        return self.limits[1] - self.limits[0]

    @property
    def height(self) -> float:
        """Height of what is drawn, in metres."""
        return self.limits[3] - self.limits[2]


def shelf_figure(views: Sequence[ShelfView], candidates: Named) -> Figure:
    """Draw what was searched for pallets, with every place that was tried, by name.

    The highest band is on top; below each stand the scores of the places.
    """
    bands = _bands(sorted(views, key=lambda seen: -seen.view.grid.top), candidates)
    width = canvas.WIDTH_PX - _LEFT - _RIGHT
    heights = [band.height * width / band.width for band in bands]
    figure = canvas.new_figure(_HEAD + sum(heights) + len(bands) * (_CHART + 2 * _GAP) + _FOOT)
    found = sum(isinstance(outcome, Fit) for _, outcome in candidates)
    title = f"Nominal front plane of the shelf: {len(candidates)} places tried, {found} pallets found"
    canvas.add_text(figure, _LEFT, 14, title, size=13, bold=True)
    top = float(_HEAD)
    for band, height in zip(bands, heights, strict=True):
        view_axes = canvas.add_axes(figure, _LEFT, top, width, height)
        score_axes = canvas.add_axes(figure, _LEFT, top + height + _GAP, width, _CHART)
        _draw_view(view_axes, band)
        _draw_scores(score_axes, band)
        top += height + _CHART + 2 * _GAP
    score_axes.set_xlabel(
        "place along the shelf's front as seen from the aisle: metres to the right of the point nearest to the camera"
    )
    canvas.add_legend(figure, top + 12, view_axes)
    return figure


def _bands(views: Sequence[ShelfView], candidates: Named) -> list[_Band]:
    """Give each view its candidates, and all views the same stretch of the shelf."""
    drawn: list[list[_Outlined]] = [[] for _ in views]
    for name, outcome in candidates:
        shown = [_on_view(seen, outcome) for seen in views]
        shares = [_share_inside(seen, lines) for seen, lines in zip(views, shown, strict=True)]
        best = int(np.argmax(shares))
        if shares[best] > 0:
            drawn[best].append((name, outcome, shown[best]))
    rights = [line[:, 0] for outlines in drawn for _, _, lines in outlines for line in lines]
    low, high = _extremes(rights, (0.0, 0.0))
    slack = max(_BESIDE, (_LEAST_WIDTH - (high - low)) / 2)
    return [
        _Band(outlines, seen.view, _limits(seen.view, outlines, low - slack, high + slack))
        for seen, outlines in zip(views, drawn, strict=True)
    ]


def _limits(
    view: PlaneView, outlines: Sequence[_Outlined], left: float, right: float
) -> tuple[float, float, float, float]:
    """Return the part of a view to draw: around the outlines, or all of its height where there are none."""
    (first, top), (last, bottom) = view.grid.points(
        np.array([[0.0, 0.0], [view.grid.columns - 1, view.grid.rows - 1]])
    )
    ups = [line[:, 1] for _, _, lines in outlines for line in lines]
    low, high = _extremes(ups, (float(bottom), float(top)))
    return (
        max(left, float(first)),
        min(right, float(last)),
        max(low - _BELOW, float(bottom)),
        min(high + _ABOVE, float(top)),
    )


def _extremes(values: Sequence[FloatArray], otherwise: tuple[float, float]) -> tuple[float, float]:
    if not values:
        return otherwise
    every = np.concatenate(values)
    return float(np.nanmin(every)), float(np.nanmax(every))


def _on_view(seen: ShelfView, outcome: Fit | Refusal) -> list[FloatArray]:
    """Return the lines of a candidate's face as the view shows them."""
    plane_from_forklift = seen.forklift_from_plane.inv()
    plane_from_camera = seen.view.plane_from_camera
    pose = outcome.pose if isinstance(outcome, Fit) else outcome.candidate.start
    return [
        seen_on_plane(plane_from_forklift.apply(line), plane_from_camera)
        for line in place_outline(outcome.candidate.model, pose)
    ]


def _share_inside(seen: ShelfView, lines: Sequence[FloatArray]) -> float:
    """Return how much of a face a view shows, 0 to 1."""
    grid = seen.view.grid
    pixels = grid.pixels(np.concatenate(lines))
    with np.errstate(invalid="ignore"):
        inside = (pixels > -0.5) & (pixels < np.array([grid.columns, grid.rows]) - 0.5)
    return float(inside.all(axis=1).mean())


def _draw_view(axes: Axes, band: _Band) -> None:
    canvas.show_view(axes, band.view)
    left, right, bottom, top = band.limits
    axes.set(xlim=(left, right), ylim=(bottom, top), ylabel="height (m)")
    axes.set_xlabel("along the shelf (m)", labelpad=1)
    axes.plot([], [], color=canvas.MEASURED, linewidth=2.5, label="pallet, as measured")
    axes.plot([], [], color=canvas.REFUSED, linewidth=1.3, linestyle="--", label="given up, as detected")
    for name, outcome, lines in sorted(band.outlines, key=lambda outlined: isinstance(outlined[1], Fit)):
        found = isinstance(outcome, Fit)
        color, width, style = (canvas.MEASURED, 2.0, "-") if found else (canvas.REFUSED, 0.9, "--")
        for line in lines:
            axes.plot(*line.T, color=color, linewidth=width, linestyle=style, clip_on=True)
        if found:
            points = np.concatenate(lines)
            place = (float(np.nanmean(points[:, 0])), float(np.nanmax(points[:, 1])))
            text = axes.annotate(name, place, xytext=(0, 4), textcoords="offset points", ha="center")
            text.set(size=12, weight="bold", color=color, path_effects=[_HALO], clip_on=True)


def _draw_scores(axes: Axes, band: _Band) -> None:
    """Draw the score of each place over its middle."""
    axes.grid(color=canvas.GRID, linewidth=0.6)
    axes.set_axisbelow(True)
    scores = [outcome.candidate.score for _, outcome, _ in band.outlines] or [0.0, 1.0]
    low, high = min(scores) - 0.06, max(scores) + 0.16
    axes.set(xlim=band.limits[:2], ylim=(low, high), ylabel="score of detection")
    labels = []
    for name, outcome, lines in band.outlines:
        place, found = float(np.nanmean(np.concatenate(lines)[:, 0])), isinstance(outcome, Fit)
        mark, color = ("o", canvas.SERIES[2]) if found else ("x", canvas.REFUSED)
        axes.plot(place, outcome.candidate.score, mark, color=color, markersize=6)
        labels.append(Label(place, outcome.candidate.score, name, found))
    write_labels(axes, labels)


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
    """Write names beside all points of a chart with final limits; one that finds no room is left out."""
    places = axes.transData.transform([(label.x, label.y) for label in labels] or np.zeros((0, 2)))
    taken = [_box(place, (_POINT_PX, _POINT_PX)) for place in places]
    for label, place in sorted(zip(labels, places, strict=True), key=lambda pair: not pair[0].important):
        size, weight, color = (10, "bold", canvas.INK) if label.important else (8, "normal", canvas.FAINT)
        extent = (0.72 * len(label.text) * size * canvas.DPI / 72, 1.15 * size * canvas.DPI / 72)
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


def _overlap(first: FloatArray, other: FloatArray) -> bool:
    return bool((first[:2] < other[2:]).all() and (other[:2] < first[2:]).all())
