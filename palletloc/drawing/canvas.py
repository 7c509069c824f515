"""What all figures share: paper, ink, and images of planes on metric axes."""

from __future__ import annotations

import io

import cv2
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.legend import Legend

from palletloc.geometry import Image
from palletloc.plane import PlaneView

INK, FAINT, GRID = "#22262b", "#6b7280", "#d9dde3"
"""Texts and axes, what is less important, and lines behind the data."""
MEASURED, STARTED, REFUSED = "#29e35b", "#ffd21f", "#ff4d7d"
"""On photographs: what was measured, what it began with, and what was given up."""
SERIES = ("#0b6bcb", "#c2410c", "#15803d", "#7e22ce", "#a16207", "#0e7490")
"""On paper: one colour after another."""
WIDTH_PX, DPI = 1280, 100
"""Every figure is as wide as a page on a screen."""


def new_figure(height_px: int) -> Figure:
    """Return an empty figure of the common width, with an Agg canvas; it belongs to no window.

    Parameters
    ----------
    height_px : int
        Height in pixels.
    """
    figure = Figure(
        figsize=(WIDTH_PX / DPI, height_px / DPI), dpi=DPI, facecolor="white", layout="constrained"
    )
    figure.set_layout_engine("constrained", w_pad=0.1, h_pad=0.08, hspace=0.04)
    FigureCanvasAgg(figure)
    return figure


def png(figure: Figure) -> bytes:
    """Return a figure as the content of a PNG file."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png")
    return buffer.getvalue()


def show_view(axes: Axes, view: PlaneView) -> None:
    """Show the image of a plane on metric axes; what the camera does not see is white.

    Parameters
    ----------
    axes : Axes
        Gets the image, equal scales and the plane's limits.
    view : PlaneView
        The image.
    """
    grid, half = view.grid, view.grid.resolution / 2
    right = grid.left + (grid.columns - 1) * grid.resolution
    bottom = grid.top - (grid.rows - 1) * grid.resolution
    extent = (grid.left - half, right + half, bottom - half, grid.top + half)
    shown = np.where(view.valid[..., None], rgb(view.image), np.uint8(255))
    axes.imshow(shown, extent=extent, interpolation="bilinear", interpolation_stage="rgba")
    axes.set_xlim(extent[:2])
    axes.set_ylim(extent[2:])
    plain(axes)


def rgb(image: Image) -> Image:
    """Return a gray or blue-green-red image with red first, (height, width, 3)."""
    code = cv2.COLOR_GRAY2RGB if image.ndim == 2 else cv2.COLOR_BGR2RGB
    return np.asarray(cv2.cvtColor(image, code), dtype=np.uint8)


def plain(axes: Axes) -> None:
    """Give axes the common look."""
    axes.tick_params(labelsize=9, colors=FAINT, length=3)
    axes.xaxis.label.set(color=INK, size=10)
    axes.yaxis.label.set(color=INK, size=10)
    axes.title.set(color=INK, size=11)
    for side in axes.spines.values():
        side.set(color=GRID, linewidth=0.8)


def legend_below(figure: Figure, axes: Axes, columns: int = 5) -> Legend | None:
    """Put one legend below all axes, from the labels of one of them; none where nothing has a label."""
    handles, labels = axes.get_legend_handles_labels()
    unique = dict(zip(labels, handles, strict=True))
    if not unique:
        return None
    legend = figure.legend(
        list(unique.values()),
        list(unique),
        loc="outside lower center",
        ncols=min(columns, len(unique)),
        frameon=False,
        fontsize=9.5,
        labelcolor=INK,
    )
    for handle in legend.get_patches():
        handle.set_alpha(1.0)
    return legend
