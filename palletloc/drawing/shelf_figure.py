"""Detection: the view of the shelf's nominal front plane, and where pallets were looked for."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke

from palletloc.candidate import Candidate
from palletloc.detection import ShelfView
from palletloc.drawing.canvas import MEASURED, REFUSED, WIDTH_PX, legend_below, new_figure, show_view
from palletloc.drawing.outline import place_outline, seen_on_plane
from palletloc.geometry import FloatArray, LevelPose
from palletloc.pallet import PalletModel

Named = Sequence[tuple[str, Candidate]]
"""Candidates with the short names that all pictures of a shot give them."""

_HALO = withStroke(linewidth=2.5, foreground="#101214")


def shelf_figure(views: Sequence[ShelfView], candidates: Named) -> Figure:
    """Draw what was searched for pallets, with every place that was tried.

    Parameters
    ----------
    views : sequence of ShelfView
        A band for each known level, or the whole plane.
    candidates : sequence of (str, Candidate)
        With their names.

    Returns
    -------
    Figure
        The highest band on top.
    """
    ordered = sorted(views, key=lambda seen: -seen.view.grid.top)
    heights = [seen.view.grid.rows / seen.view.grid.columns * (WIDTH_PX - 110) for seen in ordered]
    figure = new_figure(round(sum(heights)) + 95 * len(ordered) + 60)
    all_axes = figure.subplots(len(ordered), 1, squeeze=False, height_ratios=heights)[:, 0]
    for axes, seen in zip(all_axes, ordered, strict=True):
        _draw_band(axes, seen, candidates)
    all_axes[-1].set_xlabel("along the shelf, from the camera to the right (m)")
    found = sum(candidate.refusal is None for _, candidate in candidates)
    figure.suptitle(
        f"Nominal front plane of the shelf: {len(candidates)} places tried, {found} pallets found",
        size=13,
        weight="bold",
    )
    legend_below(figure, all_axes[0])
    return figure


def _draw_band(axes: Axes, seen: ShelfView, candidates: Named) -> None:
    show_view(axes, seen.view)
    axes.set_ylabel("height (m)")
    axes.plot([], [], color=MEASURED, linewidth=2.5, label="pallet, as measured")
    axes.plot([], [], color=REFUSED, linewidth=1.3, linestyle="--", label="given up, as detected")
    for refused in (True, False):  # what was found lies on top
        for name, candidate in candidates:
            if (candidate.refusal is not None) is refused:
                _draw_candidate(axes, seen, name, candidate)


def _draw_candidate(axes: Axes, seen: ShelfView, name: str, candidate: Candidate) -> None:
    pose = candidate.start if candidate.refusal or candidate.pose is None else candidate.pose
    lines = _on_view(seen, candidate.model, pose)
    low, high = (extreme(np.concatenate(lines), axis=0) for extreme in (np.nanmin, np.nanmax))
    middle = (low + high) / 2
    inside = axes.viewLim.contains(float(middle[0]), float(middle[1]))
    if not inside or not np.isfinite(middle).all():
        return
    found = candidate.refusal is None
    color, width, style = (MEASURED, 2.0, "-") if found else (REFUSED, 1.0, "--")
    for line in lines:
        axes.plot(*line.T, color=color, linewidth=width, linestyle=style)
    text = f"{name}  {candidate.score:.2f}" if found else name
    place = (middle[0], high[1]) if found else (low[0], low[1])
    axes.annotate(
        text,
        (float(place[0]), float(place[1])),
        xytext=(0, 4) if found else (1, -3),
        textcoords="offset points",
        ha="center" if found else "left",
        va="bottom" if found else "top",
        size=11 if found else 8,
        weight="bold" if found else "normal",
        color=color,
        path_effects=[_HALO],
        annotation_clip=True,
    )


def _on_view(seen: ShelfView, model: PalletModel, pose: LevelPose) -> list[FloatArray]:
    plane_from_forklift = seen.forklift_from_plane.inv()
    plane_from_camera = np.asarray(seen.view.camera_from_plane.inv().translation)
    return [
        seen_on_plane(plane_from_forklift.apply(line), plane_from_camera)
        for line in place_outline(model, pose)
    ]
