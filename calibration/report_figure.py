"""The frame of the figures in reports: a title, what is shown, and axes of the full width below."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from palletloc.drawing.canvas import INK, WIDTH_PX, add_axes, add_text, new_figure
from palletloc.geometry import FloatArray

_MOST_NAMES = 12
"""Most names of a correlation matrix that have room beside each other, and for the numbers in its cells."""
LEFT, RIGHT, HEAD = 74, 24, 72
"""Margins of the axes, in pixels of the figure."""


def titled_figure(height: float, title: str, line: str, left: float = LEFT) -> Figure:
    """Return a figure with its title and one line about what it shows.

    Parameters
    ----------
    height : float
        In pixels.
    title, line : str
        Plain text.
    left : float
        Where they begin, in pixels.
    """
    figure = new_figure(height)
    add_text(figure, left, 14, title, size=13, bold=True)
    add_text(figure, left, 40, line, size=10.5)
    return figure


def wide_axes(figure: Figure, height: float, top: float = HEAD, left: float = LEFT) -> Axes:
    """Return axes of the full width; height and borders in pixels."""
    return add_axes(figure, left, top, WIDTH_PX - left - RIGHT, height)


def draw_correlations(axes: Axes, correlation: FloatArray, names: Sequence[str], size: float) -> None:
    """Draw a correlation matrix, (n, n), with its numbers in a size of text, in points, where they have room."""
    has_room = len(names) <= _MOST_NAMES
    axes.imshow(correlation, cmap="RdBu_r", vmin=-1, vmax=1, aspect="auto")
    axes.set_xticks(range(len(names)), names, rotation=0 if has_room else 90)
    axes.set_yticks(range(len(names)), names)
    for (row, column), value in np.ndenumerate(correlation) if has_room else ():
        color = "white" if abs(value) > 0.6 else INK
        axes.text(column, row, f"{round(value, 2) + 0.0:.2f}", ha="center", va="center", size=size, color=color)
