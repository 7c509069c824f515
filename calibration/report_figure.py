"""The frame of the figures in reports: a title, what is shown, and axes of the full width below."""

from __future__ import annotations

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from palletloc.drawing.canvas import WIDTH_PX, add_axes, add_text, new_figure

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
