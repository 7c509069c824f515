"""Strict reading of csv files: every bad row is an error that names its file and line."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import TypeVar

from palletloc.errors import nearest_name
from palletloc.io.atomic import cannot_write, written_beside
from palletloc.io.reading import InputError, read_text
from palletloc.ranges import range_of

_Choice = TypeVar("_Choice", bound=StrEnum)


class TableError(InputError):
    """A csv file that does not hold what it should; names file and line."""


@dataclass(frozen=True, slots=True)
class Row:
    """One row of a csv file, whose cells are checked as they are taken out: `TableError` says what is wrong."""

    path: Path
    """The file."""
    line: int
    """Line in the file where the row starts; the header is line 1."""
    cells: dict[str, str]
    """Cell by column, without surrounding blanks."""

    def fault(self, problem: str) -> TableError:
        """Return the error about this row, to be raised by the caller."""
        return TableError(f"{self.path}, line {self.line}: {problem}")

    def number(self, column: str, quantity: str = "") -> float:
        """Return a finite number in the range of its column, or of the quantity that is named."""
        cell = self.cells[column]
        try:
            # Python reads "1_000" as a number; no program that writes csv means that.
            value = float(cell) if "_" not in cell else math.nan
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            raise self.fault(f"{column}: expected a finite number, got {shortened(cell)}")
        if problem := range_of(quantity or column).fault(value):
            raise self.fault(f"{column}: {problem}")
        return value

    def numbers(self, columns: Iterable[str]) -> list[float]:
        """Return several finite numbers."""
        return [self.number(column) for column in columns]

    def text(self, column: str) -> str:
        """Return a text that is not empty."""
        if not self.cells[column]:
            raise self.fault(f"{column}: expected a text, got nothing")
        return self.cells[column]

    def choice(self, column: str, choices: type[_Choice]) -> _Choice:
        """Return one of the words of an enumeration."""
        cell = self.cells[column]
        try:
            return choices(cell)
        except ValueError:
            hint = nearest_name(cell, [str(choice) for choice in choices])
            raise self.fault(f"{column}: unknown word {shortened(cell)}{hint}") from None

    def is_empty(self, columns: Iterable[str]) -> bool:
        """Return whether all of these cells are empty."""
        return not any(self.cells[column] for column in columns)


def shortened(value: object) -> str:
    """Return a value as an error shows it: on one line, and not longer than is helpful."""
    shown = repr(value)
    return shown if len(shown) <= 60 else f"{shown[:56]} ..."


def read_rows(path: Path, columns: Sequence[str], optional: Sequence[str] = ()) -> Iterator[Row]:
    """Read a csv file with a header, row by row.

    A byte-order mark, any line ending, any order of the columns, blanks around cells and empty
    lines at the end are accepted; nothing else is.

    Parameters
    ----------
    path : Path
        The file.
    columns : sequence of str
        The columns that it must have, all of them and no others.
    optional : sequence of str
        Others that it may have.

    Yields
    ------
    Row
        The rows in the file's order.

    Raises
    ------
    InputError
        If the file cannot be read.
    TableError
        If the header has another column (names the nearest) or a row another number of cells.
    """
    lines = _split(path)
    _, header = next(lines, (1, []))
    _check_header(path, header, columns, optional)
    empty_line = 0
    for line, cells in lines:
        if not any(cells):
            empty_line = empty_line or line
            continue
        if empty_line:
            raise TableError(f"{path}, line {empty_line}: is empty, but rows follow; expected a row")
        if len(cells) != len(header):
            raise TableError(f"{path}, line {line}: expected {len(header)} cells, got {len(cells)}")
        yield Row(path, line, dict(zip(header, cells, strict=True)))


def _split(path: Path) -> Iterator[tuple[int, list[str]]]:
    """Yield the line where each row starts, and its cells."""
    reader = csv.reader(io.StringIO(read_text(path), newline=""), strict=True)
    line = 1
    while True:
        try:
            cells = next(reader)
        except StopIteration:
            return
        except csv.Error as error:
            raise TableError(f"{path}, line {line}: is not csv: {error}") from None
        yield line, [cell.strip() for cell in cells]
        line = reader.line_num + 1


def _check_header(path: Path, header: Sequence[str], columns: Sequence[str], optional: Sequence[str]) -> None:
    where, expected = f"{path}, line 1", f"expected {','.join(columns)}"
    if not any(header):
        raise TableError(f"{where}: no header; {expected}")
    if len(header) == 1 and len(columns) > 1 and any(mark in header[0] for mark in ";\t"):
        raise TableError(f"{where}: the cells are not separated by commas; {expected}")
    for position, column in enumerate(header):
        if column not in columns and column not in optional:
            hint = nearest_name(column, [name for name in (*columns, *optional) if name])
            raise TableError(f"{where}: unknown column {shortened(column)}{hint}")
        if column in header[:position]:
            raise TableError(f"{where}: column '{column}' stands there twice")
    for column in columns:
        if column not in header:
            raise TableError(f"{where}: column '{column}' is missing; {expected}")


def in_order_of_time(rows: Iterable[Row], column: str = "time_s", notes: list[str] | None = None) -> Iterator[Row]:
    """Pass rows on as long as their times strictly increase; a row that is the one before again is dropped.

    Parameters
    ----------
    rows : iterable of Row
        The rows in the file's order.
    column : str
        The column of the times.
    notes : list of str, optional
        Takes a line for each row that is dropped.

    Raises
    ------
    TableError
        If a row's time precedes that of the row before, or repeats it with other values; names both lines.
    """
    previous: Row | None = None
    for row in rows:
        time = row.number(column)
        if previous is not None and time <= previous.number(column):
            if row.cells == previous.cells:
                if notes is not None:
                    notes.append(f"{row.path}, line {row.line}: is line {previous.line} again; dropped")
                continue
            how = "repeats" if time == previous.number(column) else "is earlier than"
            raise row.fault(
                f"{column}: {row.cells[column]} {how} {previous.cells[column]} of line {previous.line};"
                " expected strictly increasing times"
            )
        previous = row
        yield row


def format_number(value: float, decimals: int = 6) -> str:
    """Return a number with fixed decimals, zero without a sign.

    Raises
    ------
    ValueError
        If it is not finite: no file of ours holds such a value.
    """
    if not math.isfinite(value):
        raise ValueError(f"expected a finite number to write, got {value}")
    return f"{round(value, decimals) + 0.0:.{decimals}f}"


def write_rows(path: Path, columns: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
    """Write a csv file, whole or not at all.

    Parameters
    ----------
    path : Path
        The file.
    columns : sequence of str
        Its header.
    rows : iterable of sequences of str
        The cells of each row, in the columns' order.

    Raises
    ------
    OutputError
        If it cannot be written.
    """
    with written_beside(path) as partial:
        try:
            with partial.open("w", encoding="utf-8", newline="") as file:
                writer = csv.writer(file, lineterminator="\n")
                writer.writerow(columns)
                writer.writerows(rows)
        except OSError as error:
            raise cannot_write(path, error) from error
