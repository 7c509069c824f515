"""The hypotheses of a search: their score over yaw and distance, and the face at the best of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse

from palletloc.candidate import Candidate, Fit, Refusal, last_step
from palletloc.drawing import canvas
from palletloc.drawing.outline import face_outline
from palletloc.explained import SearchAxes, given_up
from palletloc.geometry import FloatArray, LevelPose
from palletloc.refinement.patch import FacePatch
from palletloc.refinement.search import Search

_PEAK = "#38d3ff"
"""On photographs: a hypothesis."""
_HALO = canvas.halo(3.2)
"""Around lines and numbers on photographs and maps."""
_COLORS = "cividis"
"""Matplotlib's map of colours, even for people who see few of them."""
_LEFT, _RIGHT, _HEAD, _TITLE, _AXIS, _FOOT = 76, 20, 72, 24, 46, 30
"""Borders of the page, room for a title and an axis, in pixels."""
_MAP, _MAP_HIGH, _FINER_HIGH, _BAR, _GAP = 440, 364, 230, 14, 66
"""Width and height of the map, height of closer maps, width of the bar of colours, gap between axes, in pixels."""
_VIEWS_LEFT = _LEFT + _MAP + _BAR + 146
"""Left border of the views beside the map, in pixels."""
_VIEW_HIGH, _FINER_VIEW_HIGH = 150, 190
"""Most height of a view beside the map, and below closer maps, in pixels."""
_BELOW_VIEW = 46
"""From one view to the title of that below it, in pixels."""
_TOGETHER_PX = 26.0
"""Distance below which marks would cover each other, in pixels."""
_SMALL_PX = 7.0
"""Half axis of an ellipse below which it is lost in the marks, in pixels."""


@dataclass(frozen=True, slots=True)
class _Result:
    """The pose that a candidate came to."""

    pose: LevelPose | None
    covariance: FloatArray | None
    refused: bool

    @property
    def color(self) -> str:
        return canvas.REFUSED if self.refused else canvas.MEASURED

    @property
    def label(self) -> str:
        return "fitted pose, given up" if self.refused else "final pose"


def search_figure(name: str, outcome: Fit | Refusal) -> Figure:
    """Draw the hypotheses that a candidate's pose was found among.

    Parameters
    ----------
    name : str
        Of the candidate.
    outcome : Fit or Refusal
        With a search.

    Returns
    -------
    Figure
        Score over yaw and distance, with the start, the peaks and the final pose; beside it the view that was
        scored, with the face at the best peak and at the final pose. Where all around the start could only be
        viewed coarsely, the searches around the peaks follow below.

    Raises
    ------
    ValueError
        Where no hypotheses were scored.
    """
    candidate, found = outcome.candidate, last_step(outcome, Search)
    if found is None:
        raise ValueError(f"candidate {name} has no hypotheses to draw")
    fit = outcome.fit
    result = _Result(fit.pose, fit.covariance, isinstance(outcome, Refusal)) if fit else _Result(None, None, True)
    finer = _best_first(found)
    rows = [_MAP_HIGH] + ([_FINER_HIGH, _views_height(finer[0])] if finer else [])
    figure = canvas.new_figure(_HEAD + sum(rows) + (_TITLE + _AXIS) * len(rows) + _FOOT)
    title = f"{name}: where {candidate.model.name} may stand, scored in the image{given_up(outcome)}"
    canvas.add_text(figure, _LEFT, 14, title, size=13, bold=True)
    canvas.add_text(figure, _LEFT, 40, _meaning(found), size=10.5)
    scale = Normalize(*_score_range([found, *finer]))
    top = float(_HEAD + _TITLE)
    stage = "Around the start, viewed coarsely" if finer else "Around the start"
    _draw_map(figure, (_LEFT, top, _MAP, _MAP_HIGH), found, candidate.start, result, scale, stage)
    bar = canvas.add_axes(figure, _LEFT + _MAP + 16, top, _BAR, _MAP_HIGH)
    figure.colorbar(ScalarMappable(scale, _COLORS), cax=bar, label="agreement of drawing and image")
    bar.tick_params(labelsize=9)
    _draw_views(figure, *_beside_map(found.patch, top), found, candidate, result)
    if finer:
        _draw_finer(figure, top + _MAP_HIGH + _AXIS + _TITLE, found, candidate, result, scale)
    canvas.add_legend(figure, figure.get_size_inches()[1] * 100 - _FOOT + 2, *figure.axes, columns=6)
    return figure


def _meaning(found: Search) -> str:
    grid = found.found.grid
    count = grid.turns.size * grid.ranges.size * grid.places.size * grid.rises.size
    heights = f" at {len(grid.rises)} heights" if len(grid.rises) > 1 else ""
    kept = f"the best of up to {len(grid.places)} places along the shelf{heights}"
    return f"{count} hypotheses; each cell is {kept}. Distance is over the ground, along the ray to the start"


def _score_range(searches: Sequence[Search]) -> tuple[float, float]:
    tables = [search.found.score for search in searches]
    low, high = min(float(table.min()) for table in tables), max(float(table.max()) for table in tables)
    return low, max(high, low + 1e-3)


def _draw_map(
    figure: Figure,
    place: tuple[float, float, float, float],
    found: Search,
    start: LevelPose | None,
    result: _Result,
    scale: Normalize,
    title: str,
) -> None:
    """Draw the score over distance and yaw, with what stands out in it."""
    axes = canvas.add_axes(figure, *place)
    canvas.add_text(figure, place[0], place[1] - 20, title, size=10.5)
    on, grid = SearchAxes.of(found.patch), found.found.grid
    yaws, ranges = np.degrees(on.yaws(grid.turns)), on.ranges(grid.ranges)
    axes.pcolormesh(ranges, yaws, found.found.score, cmap=_COLORS, norm=scale, shading="nearest")
    axes.set(xlabel="distance from the camera (m)", ylabel=f"yaw ({canvas.DEGREE})", facecolor="#eef0f3")
    peaks = [on.place(peak.pose) for peak in found.found.peaks]
    points = [*peaks, *([] if result.pose is None else [on.place(result.pose)])]
    if start is not None:
        points.append(on.place(start))
    _set_limits(axes, ranges, yaws, np.array(points))
    if start is not None:
        yaw, away = on.place(start)
        axes.plot(
            away, np.degrees(yaw), "s", color=canvas.STARTED, markersize=9, markeredgecolor=canvas.INK, label="start"
        )
    _mark_peaks(axes, np.array(peaks))
    if result.pose is not None:
        _mark_result(axes, on, result, is_keyed=start is not None)


def _mark_peaks(axes: Axes, peaks: FloatArray) -> None:
    """Mark the peaks with their numbers; those that differ only along the shelf share them."""
    places = np.column_stack([peaks[:, 1], np.degrees(peaks[:, 0])])
    pixels = axes.transData.transform(places)
    groups: list[list[int]] = []
    for i, pixel in enumerate(pixels):
        near = [group for group in groups if np.hypot(*(pixels[group[0]] - pixel)) < _TOGETHER_PX]
        if near:
            near[0].append(i)
        else:
            groups.append([i])
    for group in reversed(groups):
        at, numbers = places[group[0]], " ".join(str(i + 1) for i in group)
        text = axes.annotate(numbers, at, xytext=(0, 15), textcoords="offset points", ha="center", va="center")
        text.set(size=10, weight="bold", color="white", path_effects=[_HALO], zorder=5)
    (marks,) = axes.plot(*places.T, "o", label="peaks, the best is 1", zorder=4)
    marks.set(color="white", markersize=6.5, markeredgecolor=canvas.INK)


def _set_limits(axes: Axes, ranges: FloatArray, yaws: FloatArray, points: FloatArray) -> None:
    """Show all cells, and points beside them unless they are far away, with some space around."""
    axes.set_xlim(_limits(ranges, points[:, 1]))
    axes.set_ylim(_limits(yaws, np.degrees(points[:, 0])))


def _limits(cells: FloatArray, marks: FloatArray) -> tuple[float, float]:
    half = (cells[1] - cells[0]) / 2
    low, high = cells[0] - half, cells[-1] + half
    size = high - low
    near = marks[(marks > low - size) & (marks < high + size)]
    slack = 0.06 * size
    return float(np.min([low, *(near - slack)])), float(np.max([high, *(near + slack)]))


def _mark_result(axes: Axes, on: SearchAxes, result: _Result, *, is_keyed: bool) -> None:
    """Mark the pose with two standard deviations; a ring stands for an ellipse that is too small."""
    if result.pose is None:
        return
    yaw, away = on.place(result.pose)
    at = (float(away), float(np.degrees(yaw)))
    label, ring = result.label, True
    if result.covariance is not None:
        unit = np.diag([180 / np.pi, 1.0])
        covariance = (unit @ on.covariance(result.covariance) @ unit)[::-1, ::-1]
        reach = 2 * np.sqrt(np.diag(covariance))
        mm, degrees = f"{1000 * reach[0]:.0f} mm", f"{reach[1]:.2f}{canvas.DEGREE}"
        label += f" {canvas.PLUS_MINUS} {mm}, {canvas.PLUS_MINUS} {degrees} (two standard deviations)"
        pixels = np.abs(axes.transData.transform(at + reach) - axes.transData.transform(at))
        ring = bool(pixels.max() < 2 * _SMALL_PX)
        if not ring:
            _draw_ellipse(axes, at, covariance, result.color)
    for ink, line in ((canvas.INK, 4.6), (result.color, 2.4)):
        (mark,) = axes.plot(*at, "o", markerfacecolor="none", markeredgecolor=ink, markeredgewidth=line)
        mark.set_markersize(20.0 if ring else 7.0)
    if is_keyed:
        mark.set_label(label)


def _draw_ellipse(axes: Axes, at: tuple[float, float], covariance: FloatArray, color: str) -> None:
    """Draw two standard deviations of (distance, yaw); axes of an ellipse in mixed units are those of its matrix."""
    values, vectors = np.linalg.eigh(covariance)
    angle = float(np.degrees(np.arctan2(vectors[1, 1], vectors[0, 1])))
    minor, major = 4 * np.sqrt(np.maximum(values, 0.0))
    for ink, line in ((canvas.INK, 4.2), (color, 2.0)):
        axes.add_patch(Ellipse(at, major, minor, angle=angle, fill=False, edgecolor=ink, linewidth=line, zorder=2.5))


def _best_first(found: Search) -> list[Search]:
    """Return the searches around the peaks, that with the best peak first."""
    return sorted(found.finer, key=lambda search: -search.found.peaks[0].score)


def _draw_finer(
    figure: Figure, top: float, found: Search, candidate: Candidate, result: _Result, scale: Normalize
) -> None:
    finer = _best_first(found)
    width = (canvas.WIDTH_PX - _LEFT - _RIGHT - (len(finer) - 1) * _GAP) / max(len(finer), 2)
    order = {id(search): i for i, search in enumerate(found.finer, start=1)}
    for i, search in enumerate(finer):
        place = (_LEFT + i * (width + _GAP), top, width, _FINER_HIGH)
        _draw_map(figure, place, search, None, result, scale, f"Closer view {order[id(search)]}, around a peak")
    below = top + _FINER_HIGH + _AXIS + _TITLE
    half = (canvas.WIDTH_PX - _LEFT - _RIGHT - _GAP) / 2
    size = _size(finer[0].patch, half, _FINER_VIEW_HIGH)
    _draw_views(figure, [(_LEFT, below), (_LEFT + half + _GAP, below)], size, finer[0], candidate, result)


def _beside_map(patch: FacePatch, top: float) -> tuple[list[tuple[float, float]], tuple[float, float]]:
    """Return the places of two views beside the map and their size: one above the other or side by side."""
    width = canvas.WIDTH_PX - _RIGHT - _VIEWS_LEFT
    above = _size(patch, width, _VIEW_HIGH)
    aside = _size(patch, (width - _GAP) / 2, _MAP_HIGH)
    if aside[0] > above[0]:
        return [(_VIEWS_LEFT, top), (_VIEWS_LEFT + aside[0] + _GAP, top)], aside
    return [(_VIEWS_LEFT, top), (_VIEWS_LEFT, top + above[1] + _BELOW_VIEW)], above


def _views_height(found: Search) -> float:
    width = (canvas.WIDTH_PX - _LEFT - _RIGHT - _GAP) / 2
    return _size(found.patch, width, _FINER_VIEW_HIGH)[1]


def _size(patch: FacePatch, width: float, height: float) -> tuple[float, float]:
    """Return width and height of a view on the page, in pixels, at most those given."""
    aspect = patch.view.grid.columns / patch.view.grid.rows
    wide = min(width, height * aspect)
    return wide, wide / aspect


def _draw_views(
    figure: Figure,
    places: Sequence[tuple[float, float]],
    size: tuple[float, float],
    found: Search,
    candidate: Candidate,
    result: _Result,
) -> None:
    """Draw the scored view twice: with the face at the best peak, and where the fit put it."""
    best = found.found.peaks[0]
    poses = [(best.pose, _PEAK, f"At the best peak, score {best.score:.2f}")]
    if result.pose is None:
        poses.append((candidate.start, canvas.STARTED, "At the start: no pose was fitted"))
    else:
        poses.append((result.pose, result.color, f"At the {result.label}"))
    for (left, top), (pose, color, title) in zip(places, poses, strict=True):
        axes = canvas.add_axes(figure, left, top, *size)
        canvas.add_text(figure, left, top - 20, title, size=10.5)
        canvas.show_view(axes, found.patch.view)
        axes.set(xlim=axes.get_xlim(), ylim=axes.get_ylim())
        if left == places[0][0]:
            axes.set_ylabel("up (m)")
        if top == places[-1][1]:  # one above the other, they share the axis
            axes.set_xlabel("to the right (m)")
        for line in face_outline(candidate.model):
            axes.plot(*found.patch.appearing(pose, line).T, color=color, linewidth=1.4, path_effects=[_HALO])
