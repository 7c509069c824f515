"""What a result consists of: findings, tables, figures and numbers. No part knows how an output shows it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import Flag, auto
from typing import Any

from matplotlib.figure import Figure

from calibration.findings import Finding, exit_code
from palletloc.report.page import Column


class Output(Flag):
    """Where a section is shown. The order of the sections is the same everywhere."""

    TERMINAL = auto()
    """What the command prints."""
    PAGE = auto()
    """The report in HTML."""


@dataclass(frozen=True, slots=True)
class Heading:
    """A heading on the page."""

    text: str
    """Plain text."""


@dataclass(frozen=True, slots=True)
class Paragraph:
    """A few sentences."""

    text: str
    """Plain text."""
    output: Output = Output.PAGE
    """Where they are shown."""


@dataclass(frozen=True, slots=True)
class KeyFigures:
    """The numbers that matter, in large type on the page."""

    figures: tuple[tuple[str, str], ...]
    """Value and meaning of each."""


@dataclass(frozen=True, slots=True)
class Table:
    """Rows of cells."""

    columns: tuple[Column, ...]
    """Their headings; words stand at the left, numbers at the right."""
    rows: tuple[tuple[str, ...], ...]
    """Their cells."""
    output: Output = Output.PAGE
    """Where it is shown."""
    total: tuple[str, ...] = ()
    """A last row of the terminal, below a line; none by default."""


@dataclass(frozen=True, slots=True, eq=False)
class Drawing:
    """A picture on the page. It is drawn only where a page is written."""

    draw: Callable[[], Figure]
    """Draws it."""
    caption: str
    """Plain text below it."""
    keep_wide: bool = True
    """Whether a narrow screen scrolls it instead of making its texts unreadable."""


@dataclass(frozen=True, slots=True)
class Findings:
    """What has to be done next: a table on the page, ``reasons`` in JSON, one line each on standard error."""

    findings: tuple[Finding, ...]
    """In the order in which they were made."""
    nothing: str
    """What the page says where there are none."""
    remarks: tuple[str, ...] = ()
    """More lines for standard error, about what the page says in another section."""


@dataclass(frozen=True, slots=True, eq=False)
class JsonValues:
    """Plain values for JSON, which people do not read."""

    values: Mapping[str, Any]
    """Their keys stand at the top level of the file."""


Section = Heading | Paragraph | KeyFigures | Table | Drawing | Findings | JsonValues
"""A part of a result."""


@dataclass(frozen=True, slots=True, eq=False)
class ResultPage:
    """A result as every output shows it."""

    command: str
    """The title of the page: the command that made it."""
    heading: str
    """What the page is about."""
    verdicts: Mapping[int, str]
    """What each exit code means, in a sentence."""
    sections: tuple[Section, ...]
    """In the order in which they are shown."""
    content: str | None = None
    """Of the file that the calibration writes; None where it gives none."""

    @property
    def findings(self) -> tuple[Finding, ...]:
        """All findings, in the order in which they were made."""
        return tuple(
            finding for section in self.sections if isinstance(section, Findings) for finding in section.findings
        )

    @property
    def exit_code(self) -> int:
        """0 where the result holds, 1 where it fails, 3 where the data cannot give one."""
        return exit_code(self.findings)


def words(*headings: str) -> tuple[Column, ...]:
    """Return columns whose cells are words, which stand at the left."""
    return tuple(Column(heading, is_text=True) for heading in headings)


def numbers(*headings: str) -> tuple[Column, ...]:
    """Return columns whose cells are numbers, which stand at the right."""
    return tuple(Column(heading) for heading in headings)
