"""Pallet models drawn to scale, with their dimensions and whether these are confirmed."""

from __future__ import annotations

import io
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import FancyBboxPatch, Rectangle

from palletloc.drawing.canvas import TIMES
from palletloc.pallet import Opening, PalletModel

_INK, _FAINT, _DARK = "#2b2b2b", "#7a7a7a", "#3b4048"
"""Texts and outlines, what is less important, and openings."""
_FILL = {True: "#dcb98a", False: "#eee8dc"}
"""Of a face, by whether its dimensions are confirmed."""
_MARK = {True: ("confirmed", "#2e7d32"), False: ("unconfirmed", "#c0561a")}
"""Word and colour for the same."""
_MAX_SCALE, _MAX_WIDTH = 3.4, 18.0
"""Largest scale in inches per metre, and largest width of the page in inches."""
_DPI = 130
"""Pixels per inch: the smallest texts can be read."""
_NAME_PT, _TEXT_PT, _DIMENSION_PT = 10.0, 7.5, 6.5
"""Sizes of names, texts and dimensions, in points."""


@dataclass(frozen=True, slots=True)
class _Sheet:
    """How cells lie on the page; lengths in inches unless stated."""

    columns: int
    """Number of columns."""
    rows: int
    """Number of rows."""
    scale: float
    """Inches per metre."""
    width: float
    """Of a cell."""
    height: float
    """Of a cell."""

    head = 0.75
    """Height of the page's heading."""
    left = 0.55
    """From a cell's left side to its face."""
    right = 0.55
    """From the widest face to a cell's right side."""
    above = 0.62
    """From a face to its cell's top."""
    below = 0.78
    """From the floor to its cell's bottom."""

    @classmethod
    def fitting(cls, models: Sequence[PalletModel], columns: int) -> _Sheet:
        """Return the sheet that has room for all models at one scale."""
        columns = min(columns, len(models))
        widest = max(model.width for model in models)
        room = _MAX_WIDTH / columns - cls.left - cls.right
        scale = min(_MAX_SCALE, room / widest)
        width = max(widest * scale, 4.4) + cls.left + cls.right  # room for the texts
        height = max(model.height for model in models) * scale + cls.above + cls.below
        return cls(columns, -(-len(models) // columns), scale, width, height)

    def origin(self, index: int) -> tuple[float, float]:
        """Return the place of a model's origin on the page: its lower left corner."""
        row, column = divmod(index, self.columns)
        return column * self.width + self.left, (self.rows - 1 - row) * self.height + self.below


def pallets_figure(models: Sequence[PalletModel], columns: int = 3) -> Figure:
    """Draw front faces at one scale, with their dimensions in millimetres.

    Parameters
    ----------
    models : sequence of PalletModel
        What to draw, row by row.
    columns : int
        Most faces side by side.

    Returns
    -------
    Figure
        With an Agg canvas; it belongs to no window and to no list of open figures.

    Raises
    ------
    ValueError
        Where there is no model, or no column.
    """
    if not models or columns < 1:
        raise ValueError(f"expected models and at least one column, got {len(models)} and {columns}")
    sheet = _Sheet.fitting(models, columns)
    size = (sheet.columns * sheet.width, sheet.rows * sheet.height + sheet.head)
    figure = Figure(figsize=size, dpi=_DPI, facecolor="white")
    FigureCanvasAgg(figure)
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0), xlim=(0.0, size[0]), ylim=(0.0, size[1]))
    axes.set_axis_off()
    _draw_heading(axes, size[1])
    for index, model in enumerate(models):
        _FaceDrawing(axes, model, *sheet.origin(index), sheet.scale, sheet.width - sheet.left).draw()
    return figure


def pallets_png(models: Sequence[PalletModel], columns: int = 3) -> bytes:
    """Return the drawing of `pallets_figure`, by the same arguments, as the content of a PNG file."""
    buffer = io.BytesIO()
    pallets_figure(models, columns).savefig(buffer, format="png")
    return buffer.getvalue()


def _draw_heading(axes: Axes, top: float) -> None:
    axes.text(0.2, top - 0.3, "Pallet models", size=14, weight="bold", color=_INK, va="center")
    line = "front faces as the forks see them, at one scale, in mm; dashed: something is assumed"
    axes.text(0.2, top - 0.55, line, size=8, color=_FAINT, va="center")


@dataclass(frozen=True, slots=True)
class _FaceDrawing:
    """One model on the page; the page's unit is the inch."""

    axes: Axes
    """The whole page."""
    model: PalletModel
    """What is drawn."""
    x: float
    """Place of the face's lower left corner on the page."""
    y: float
    """The same point's second coordinate."""
    scale: float
    """Inches per metre."""
    text_width: float
    """Room for lines of text, in inches."""

    def draw(self) -> None:
        """Draw the face, its dimensions and its texts."""
        self._draw_face()
        self._draw_widths()
        self._draw_heights()
        self._draw_texts()

    def _right(self, right: float) -> float:
        return self.x + (right + self.model.width / 2) * self.scale

    def _up(self, up: float) -> float:
        return self.y + up * self.scale

    def _draw_face(self) -> None:
        model = self.model
        half, reach = model.width / 2, model.width / 2 + 0.03
        self._line((self._right(-reach), self._right(reach)), (self.y, self.y), color=_FAINT, linewidth=0.6)
        style = "solid" if model.confirmed else (0, (4, 2))
        self._box(
            (-half, 0.0, model.width, model.height),
            model.corner_radius,
            facecolor=_FILL[model.confirmed],
            edgecolor=_INK,
            linewidth=0.9,
            linestyle=style,
        )
        for opening in model.openings:
            self._draw_opening(opening)

    def _draw_opening(self, opening: Opening) -> None:
        below = opening.radius if opening.open_below else 0.0  # its lower corners lie under the floor
        patch = self._box(
            (opening.left, opening.bottom - below, opening.width, opening.height + below),
            opening.radius,
            facecolor=_DARK,
            edgecolor="none",
        )
        if opening.open_below:
            corner = (self._right(opening.left), self.y)
            floor = Rectangle(corner, opening.width * self.scale, self.scale, transform=self.axes.transData)
            patch.set_clip_path(floor)

    def _box(self, metres: tuple[float, float, float, float], radius: float, **style: Any) -> FancyBboxPatch:
        left, bottom, width, height = metres
        patch = FancyBboxPatch(
            (self._right(left), self._up(bottom)),
            width * self.scale,
            height * self.scale,
            boxstyle=f"round,pad=0,rounding_size={max(radius * self.scale, 1e-6)}",
            **style,
        )
        self.axes.add_patch(patch)
        return patch

    def _line(self, x: tuple[float, float], y: tuple[float, float], color: str, linewidth: float) -> None:
        self.axes.plot(x, y, color=color, linewidth=linewidth, solid_capstyle="butt")

    def _draw_widths(self) -> None:
        """Draw the chain of blocks and openings below the face."""
        cuts = [side for block in self.model.blocks for side in block]
        level = self.y - 0.13
        for cut in cuts:
            self._tick((self._right(cut), level), (0.0, 0.035))
        self._line((self._right(cuts[0]), self._right(cuts[-1])), (level, level), _FAINT, 0.5)
        for left, right in pairwise(cuts):
            self._dimension(self._right((left + right) / 2), level - 0.085, right - left, "center")

    def _draw_heights(self) -> None:
        """Draw the chain of levels right of the face and the whole height left of it."""
        model = self.model
        levels = {0.0, model.height}
        for opening in model.openings:
            levels |= {opening.bottom, opening.top}
        self._draw_levels(sorted(levels), self._right(model.width / 2) + 0.13, 0.06, "left")
        self._draw_levels([0.0, model.height], self._right(-model.width / 2) - 0.13, -0.06, "right")

    def _draw_levels(self, levels: Sequence[float], x: float, offset: float, align: str) -> None:
        for level in levels:
            self._tick((x, self._up(level)), (0.035, 0.0))
        self._line((x, x), (self._up(levels[0]), self._up(levels[-1])), _FAINT, 0.5)
        for low, high in pairwise(levels):
            self._dimension(x + offset, self._up((low + high) / 2), high - low, align)

    def _tick(self, place: tuple[float, float], reach: tuple[float, float]) -> None:
        (x, y), (dx, dy) = place, reach
        self._line((x - dx, x + dx), (y - dy, y + dy), _FAINT, 0.5)

    def _dimension(self, x: float, y: float, length: float, align: str) -> None:
        millimetres = f"{round(length * 1000, 1):g}"
        self.axes.text(x, y, millimetres, size=_DIMENSION_PT, color=_INK, ha=align, va="center_baseline")

    def _draw_texts(self) -> None:
        model, left = self.model, self._right(-self.model.width / 2)
        word, color = _MARK[model.confirmed]
        top = self._up(model.height)
        name = self.axes.annotate(
            model.name, (left, top + 0.33), size=_NAME_PT, weight="bold", color=_INK, parse_math=False
        )
        self.axes.annotate(
            word, (1, 0), xytext=(8, 2.5), xycoords=name, textcoords="offset points", size=_TEXT_PT, color=color
        )
        size = f"{model.width * 1000:g} {TIMES} {model.height * 1000:g}, {model.depth * 1000:g} deep"
        line = f"{size} · edge radius {model.edge_radius * 1000:g} · tolerance {model.tolerance * 1000:g}"
        self.axes.text(left, top + 0.14, line, size=_TEXT_PT, color=_FAINT)
        characters = max(int(self.text_width * 72 / (0.56 * _DIMENSION_PT)), 20)
        note = textwrap.wrap(model.note, characters, max_lines=2, placeholder=" ...")
        self.axes.text(
            left, self.y - 0.34, "\n".join(note), size=_DIMENSION_PT, color=_FAINT, va="top", parse_math=False
        )
