"""Results as a table for people, as Markdown, and as plain values."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from rich import box
from rich.table import Table

Value = str | int | float | tuple[float, ...] | None
"""A cell: text, a count, numbers with the digits that its column gives, or nothing."""


@dataclass(frozen=True, slots=True)
class Column:
    """A column of a table."""

    name: str
    """Key in JSON, and the title."""
    digits: int = 0
    """Decimals of its numbers."""


@dataclass(frozen=True, slots=True)
class Section:
    """A titled table."""

    title: str
    """What it holds."""
    columns: tuple[Column, ...]
    """From left to right."""
    rows: tuple[tuple[Value, ...], ...]
    """Each as long as the columns."""
    note: str = ""
    """What to know for reading it."""

    def plain(self) -> dict[str, Any]:
        """Return title, note and rows as values that JSON knows."""
        rows = [
            {column.name: _plain(value) for column, value in zip(self.columns, row, strict=True)} for row in self.rows
        ]
        return {"title": self.title, "note": self.note, "rows": rows}

    def texts(self) -> list[list[str]]:
        """Return the rows as text."""
        return [
            [_text(value, column.digits) for column, value in zip(self.columns, row, strict=True)]
            for row in self.rows
        ]

    def numeric(self) -> list[bool]:
        """Tell which columns hold numbers."""
        columns = range(len(self.columns))
        return [not any(isinstance(row[place], str) for row in self.rows) for place in columns]


def _plain(value: Value) -> Value:
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _text(value: Value, digits: int) -> str:
    if isinstance(value, tuple):
        return " / ".join(_text(number, digits) for number in value)
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return "-"
    return f"{value:.{digits}f}" if isinstance(value, float) else str(value)


def as_table(section: Section) -> Table:
    """Return a table for the terminal."""
    table = Table(title=section.title, caption=section.note or None, box=box.SIMPLE, title_justify="left")
    for column, numeric in zip(section.columns, section.numeric(), strict=True):
        table.add_column(column.name, justify="right" if numeric else "left", no_wrap=True)
    for row in section.texts():
        table.add_row(*row)
    return table


def as_markdown(section: Section) -> str:
    """Return a table in Markdown, with its title as a line above it and its note below."""
    rules = ["--:" if numeric else "---" for numeric in section.numeric()]
    lines = [_line([column.name for column in section.columns]), _line(rules), *map(_line, section.texts())]
    parts = [section.title, "\n".join(lines), section.note]
    return "\n\n".join(part for part in parts if part) + "\n"


def _line(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |"
