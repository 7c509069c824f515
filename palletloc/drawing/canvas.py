"""What all figures share: paper, ink, and images of planes on metric axes."""

from __future__ import annotations

import io

import cv2
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from PIL import Image as PillowImage

from palletloc.drawing.overlay import MEASURED as MEASURED
from palletloc.drawing.overlay import REFUSED as REFUSED
from palletloc.drawing.overlay import STARTED as STARTED
from palletloc.geometry import Image
from palletloc.plane import PlaneView

INK, FAINT, GRID = "#22262b", "#6b7280", "#d9dde3"
"""Texts and axes, what is less important, and lines behind the data."""
SERIES = ("#0b6bcb", "#c2410c", "#15803d", "#7e22ce", "#a16207", "#0e7490")
"""On paper: one colour after another."""
SIGMA, DEGREE, PLUS_MINUS, TIMES, MINUS = (
    "\N{GREEK SMALL LETTER SIGMA}",
    "\N{DEGREE SIGN}",
    "\N{PLUS-MINUS SIGN}",
    "\N{MULTIPLICATION SIGN}",
    "\N{MINUS SIGN}",
)
"""Signs that pages and tables write."""
WIDTH_PX, DPI = 1280, 100
"""Every figure is as wide as a page on a screen."""
LEGEND_ROW_PX = 22
"""Height of one row of keys."""
_DARK, _BRIGHT, _MOST_GAIN = 120.0, 220.0, 6.0
"""Gray level of the brightest parts below which a view is shown brighter, what they become, and the most gain."""


def halo(linewidth: float) -> withStroke:
    """Return a dark border around what is drawn on photographs, so many points wide."""
    return withStroke(linewidth=linewidth, foreground="#101214")


def new_figure(height_px: float) -> Figure:
    """Return an empty figure of the common width, with an Agg canvas; it belongs to no window."""
    figure = Figure(figsize=(WIDTH_PX / DPI, round(height_px) / DPI), dpi=DPI, facecolor="white")
    FigureCanvasAgg(figure)
    return figure


def add_axes(figure: Figure, left: float, top: float, width: float, height: float) -> Axes:
    """Add axes at a place that is given in pixels from the figure's upper left corner."""
    wide, high = figure.get_size_inches() * DPI
    axes = figure.add_axes((left / wide, 1 - (top + height) / high, width / wide, height / high))
    axes.tick_params(labelsize=9, colors=FAINT, length=3)
    axes.xaxis.label.set(color=INK, size=10)
    axes.yaxis.label.set(color=INK, size=10)
    for side in axes.spines.values():
        side.set(color=GRID, linewidth=0.8)
    return axes


def add_text(figure: Figure, left: float, top: float, text: str, *, size: float = 10, bold: bool = False) -> None:
    """Write a line whose upper left corner is given in pixels from the figure's upper left corner."""
    wide, high = figure.get_size_inches() * DPI
    color, weight = (INK, "bold") if bold else (FAINT, "normal")
    figure.text(left / wide, 1 - top / high, text, size=size, color=color, weight=weight, va="top", parse_math=False)


def png(figure: Figure) -> bytes:
    """Return a figure as the content of a PNG file."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", pil_kwargs={"compress_level": 4})
    return buffer.getvalue()


def small_png(figure: Figure, colors: int = 128) -> bytes:
    """Return a figure without photographs as a small PNG file with a palette of `colors`, 256 at most."""
    drawn = PillowImage.open(io.BytesIO(png(figure))).convert("RGB")
    buffer = io.BytesIO()
    drawn.quantize(colors, dither=PillowImage.Dither.NONE).save(buffer, format="png", optimize=True)
    return buffer.getvalue()


def as_jpeg(content: bytes, quality: int = 80) -> bytes:
    """Return the content of a PNG file as a JPEG of some quality, 95 at most: smaller where it holds photographs."""
    buffer = io.BytesIO()
    PillowImage.open(io.BytesIO(content)).convert("RGB").save(buffer, format="jpeg", quality=quality, optimize=True)
    return buffer.getvalue()


def show_view(axes: Axes, view: PlaneView) -> None:
    """Show the image of a plane on metric axes; what the camera does not see is white, what is dark brightened."""
    grid, half = view.grid, view.grid.resolution / 2
    right = grid.left + (grid.columns - 1) * grid.resolution
    bottom = grid.top - (grid.rows - 1) * grid.resolution
    extent = (grid.left - half, right + half, bottom - half, grid.top + half)
    image = rgb(view.image)
    gain = _gain(image[view.valid])
    if gain > 1:
        image = np.minimum(image * gain, 255.0).astype(np.uint8)
        text = axes.text(0.995, 0.98, f"shown {gain:.1f} times as bright", ha="right", va="top", size=8.5)
        text.set(transform=axes.transAxes, color="white", path_effects=[withStroke(linewidth=2.5, foreground=INK)])
    shown = np.where(view.valid[..., None], image, np.uint8(255))
    axes.imshow(shown, extent=extent, interpolation="bilinear", interpolation_stage="rgba")
    axes.set_xlim(extent[:2])
    axes.set_ylim(extent[2:])


def _gain(seen: Image) -> float:
    """Return how many times brighter to show what a view holds: once unless even its bright parts are dark."""
    bright = float(np.percentile(seen, 98)) if seen.size else _BRIGHT
    return 1.0 if bright >= _DARK else min(_BRIGHT / max(bright, 1.0), _MOST_GAIN)


def rgb(image: Image) -> Image:
    """Return a gray or blue-green-red image with red first, (height, width, 3)."""
    code = cv2.COLOR_GRAY2RGB if image.ndim == 2 else cv2.COLOR_BGR2RGB
    return np.asarray(cv2.cvtColor(image, code), dtype=np.uint8)


def add_legend(figure: Figure, top: float, *axes: Axes, columns: int = 5) -> None:
    """Put keys in the middle of the page, one for each label in any of the axes.

    Parameters
    ----------
    figure : Figure
        The page.
    top : float
        Where the first row begins, in pixels from the upper border; a row takes `LEGEND_ROW_PX`.
    axes : Axes
        Whose labels to list.
    columns : int
        Most keys side by side.
    """
    keys = [panel.get_legend_handles_labels() for panel in axes]
    unique = {label: handle for key in keys for handle, label in zip(*key, strict=True)}
    if not unique:
        return
    legend = figure.legend(
        list(unique.values()),
        list(unique),
        loc="upper center",
        bbox_to_anchor=(0.5, 1 - top / (figure.get_size_inches()[1] * DPI)),
        ncols=min(columns, len(unique)),
        frameon=False,
        fontsize=9.5,
        labelcolor=INK,
        borderaxespad=0.0,
        borderpad=0.2,
    )
    for text in legend.get_texts():
        text.set_parse_math(False)
