"""Tables on a terminal: no name and no number is ever cut, however narrow it is."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, Final

from rich import box
from rich.console import Console, RenderableType
from rich.measure import Measurement
from rich.table import Column, Table
from rich.text import Text

if TYPE_CHECKING:
    from palletloc.geometry import FloatArray, LevelPose

PLUS_MINUS, DEGREE = "\N{PLUS-MINUS SIGN}", "\N{DEGREE SIGN}"
"""Signs that headings write."""
POSE_HEADINGS = (f"x m {PLUS_MINUS}mm", "y", "z", f"yaw {DEGREE}")
"""Of the columns of a pose."""
CUT: Final = "crop"
"""Overflow of a column of explanations, which a narrow terminal may cut; names and numbers never are."""
_LEAST_CUT = 4
"""Least width of such a column, in characters."""
_UNBOUNDED = 100_000
"""Width in which every table fits, in characters."""


def new_table(words: Sequence[str], numbers: Sequence[str] = (), last: Sequence[str] = (), title: str = "") -> Table:
    """Return an empty table.

    Parameters
    ----------
    words, numbers, last : sequence of str
        Headings of columns of words, of numbers, and of words again.
    title : str
        A line above it.
    """
    table = Table(box=box.SIMPLE_HEAD, padding=0, title=title or None)
    for heading in words:
        table.add_column(heading)
    for heading in numbers:
        table.add_column(heading, justify="right", no_wrap=True)
    for heading in last:
        table.add_column(heading)
    return table


def pose_cells(pose: LevelPose, covariance: FloatArray) -> list[str]:
    """Return the cells below `POSE_HEADINGS`, each with its standard deviation."""
    import numpy as np  # tables of commands that need no numbers appear at once

    sigma = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    places = zip((pose.x, pose.y, pose.z), 1000 * sigma[:3], strict=True)
    cells = [f"{round(value, 3) + 0.0:.3f} {PLUS_MINUS}{size:.{1 if size < 10 else 0}f}" for value, size in places]
    return [*cells, f"{np.degrees(pose.yaw):.2f} {PLUS_MINUS}{np.degrees(sigma[3]):.2f}"]


def plain_table() -> Table:
    """Return an empty table without headings, for names and values."""
    return Table(show_header=False, show_edge=False, box=box.SIMPLE)


def print_parts(parts: Iterable[str | Table]) -> None:
    """Print lines and tables to standard output.

    Lines are left to the terminal to wrap. A table that is too wide gets its texts wrapped between words; where that
    is not enough, its rows become lists. What is no terminal takes every width, unless COLUMNS says how wide it is.
    """
    shown = Console()
    bounded = shown.is_terminal or os.environ.get("COLUMNS", "").isdigit()
    width = shown.width if bounded else _UNBOUNDED
    console = Console(width=width)
    for part in parts:
        for piece, wide in _fitted(part, width, console):
            console.print(piece, width=wide, soft_wrap=isinstance(piece, Text), highlight=False)


def _fitted(part: str | Table, width: int, console: Console) -> Iterator[tuple[RenderableType, int | None]]:
    """Yield the pieces to print of a part, and how wide each is printed."""
    if isinstance(part, str):
        yield Text(part), None
        return
    if part.title:
        yield Text(str(part.title), style="italic"), None
        part.title = None
    needed = _natural(part, console)
    if needed <= width or _wrapped(part, width - needed, console):
        yield part, min(needed, width)
    else:
        yield from ((Text(line), None) for line in _listed(part))


def _natural(renderable: RenderableType, console: Console) -> int:
    return Measurement.get(console, console.options.update(width=_UNBOUNDED), renderable).maximum


def _wrapped(table: Table, spare: int, console: Console) -> bool:
    """Narrow the columns that may wrap, the widest first, until the table has room; say whether it has."""
    options = console.options.update(width=_UNBOUNDED)
    for column in sorted(table.columns, key=lambda column: -_widest(column, console)):
        if spare >= 0:
            break
        sizes = [Measurement.get(console, options, cell) for cell in (column.header, *column.cells)]
        least, most = max(size.minimum for size in sizes), max(size.maximum for size in sizes)
        if column.overflow == CUT:
            least, column.overflow = min(_LEAST_CUT, most), "ellipsis"
        elif column.no_wrap:
            continue
        column.width = max(least, most + spare)
        spare += most - column.width
    return spare >= 0


def _widest(column: Column, console: Console) -> int:
    return max((_natural(cell, console) for cell in column.cells), default=0)


def _listed(table: Table) -> Iterator[str]:
    """Yield the rows of a table as lists of what stands in their columns."""
    for number, row in enumerate(zip(*(column.cells for column in table.columns), strict=True)):
        texts = [" ".join(str(cell).split()) for cell in row]
        if not table.show_header:
            yield "  ".join(text for text in texts if text)
            continue
        yield from [""] * (number > 0)
        for column, text in zip(table.columns, texts, strict=True):
            heading = " ".join(str(column.header).split())
            if text:
                yield f"{heading}: {text}" if heading else text
