"""A result said once, as sections, and its outputs: terminal, HTML and JSON, and their files.

A section is a value: findings, a table, a figure, numbers. A calibration's report lists them; how each output shows
them is said here alone.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from enum import Flag, auto
from pathlib import Path
from typing import Any

import rich.table
from matplotlib.figure import Figure
from rich import box
from rich.text import Text

from calibration.findings import PASS, Finding, Judgement, Severity, exit_code, judgement
from palletloc.drawing.canvas import small_png
from palletloc.io.atomic import write_text
from palletloc.report import page as html
from palletloc.report.page import Column

_RESTRICTIONS = ("a restriction", "restrictions")
"""One, and more."""
_FORMAT = 1
"""Version of the reports in JSON. Programs read it; it changes when a key changes its meaning."""


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
    restricted: str = ""
    """What a result that warnings restrict is, in a sentence to which they are added; as of exit code 0 if empty."""

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

    @property
    def judgement(self) -> Judgement:
        """The verdict in a word."""
        return judgement(self.findings)

    @property
    def verdict(self) -> str:
        """The verdict in a sentence: the same on the terminal, on the page and in JSON."""
        if self.judgement is not Judgement.RESTRICTED:
            return self.verdicts[self.exit_code]
        sentence = self.restricted or self.verdicts[self.exit_code]
        codes = dict.fromkeys(finding.code for finding in self.findings if finding.severity is Severity.WARNING)
        return f"{sentence.rstrip('.')}, with {_RESTRICTIONS[len(codes) > 1]}: {', '.join(codes)}."


def words(*headings: str) -> tuple[Column, ...]:
    """Return columns whose cells are words, which stand at the left."""
    return tuple(Column(heading, is_text=True) for heading in headings)


def numbers(*headings: str) -> tuple[Column, ...]:
    """Return columns whose cells are numbers, which stand at the right."""
    return tuple(Column(heading) for heading in headings)


def finite(value: float) -> float | None:
    """Return a number as JSON can hold it: None where it is not finite."""
    return value if math.isfinite(value) else None


def terminal_parts(result: ResultPage) -> tuple[str | rich.table.Table, ...]:
    """Return what a command prints of a result."""
    return tuple(part for section in result.sections for part in _on_terminal(section))


def _on_terminal(section: Section) -> Iterator[str | rich.table.Table]:
    match section:
        case Paragraph() if Output.TERMINAL in section.output:
            yield section.text
        case Table() if Output.TERMINAL in section.output:
            yield _terminal_table(section)


def _terminal_table(section: Table) -> rich.table.Table:
    table = rich.table.Table(box=box.SIMPLE_HEAD)
    for column in section.columns:
        table.add_column(column.heading, justify="left" if column.is_text else "right")
    for row in section.rows:
        table.add_row(*(Text(cell) for cell in row))
    if section.total:
        table.add_section()
        table.add_row(*(Text(cell) for cell in section.total))
    return table


def reason_lines(result: ResultPage) -> tuple[str, ...]:
    """Return what a command says on standard error: why a result fails, and what restricts it, one line each."""
    return tuple(
        line
        for section in result.sections
        if isinstance(section, Findings)
        for line in (*(_finding_line(finding) for finding in section.findings), *section.remarks)
    )


def _finding_line(finding: Finding) -> str:
    return f"{finding.severity}: {finding.code}: {finding.what}; {finding.how}"


def json_values(result: ResultPage) -> dict[str, Any]:
    """Return a result in plain values."""
    data: dict[str, Any] = {"format": _FORMAT, "exit_code": result.exit_code}
    if result.findings:
        data |= {"judgement": str(result.judgement), "verdict": result.verdict}
    for section in result.sections:
        if isinstance(section, Findings):
            data["reasons"] = [_finding_data(finding) for finding in section.findings]
        if isinstance(section, JsonValues):
            data |= section.values
    return data


def json_text(result: ResultPage) -> str:
    """Return a result as the content of a file in JSON."""
    return json.dumps(json_values(result), indent=1, allow_nan=False) + "\n"


def _finding_data(finding: Finding) -> dict[str, str]:
    return {"severity": str(finding.severity), "code": finding.code, "what": finding.what, "how": finding.how}


def html_text(result: ResultPage) -> str:
    """Return a result as a page of HTML that needs nothing but itself."""
    start = (html.heading(result.heading, level=1), html.paragraph(result.verdict, "lead"))
    parts = (part for section in result.sections for part in _on_page(section))
    return html.page(result.command, (*start, *parts))


def _on_page(section: Section) -> Iterator[str]:
    match section:
        case Heading():
            yield html.heading(section.text)
        case Paragraph() if Output.PAGE in section.output:
            yield html.paragraph(section.text)
        case KeyFigures():
            yield html.key_figures(section.figures)
        case Table() if Output.PAGE in section.output:
            yield html.table(section.columns, section.rows)
        case Drawing():
            source = html.embedded(small_png(section.draw()))
            yield html.picture(source, section.caption, keep_wide=section.keep_wide)
        case Findings():
            yield html.heading("What to do next")
            yield _findings_on_page(section)


def _findings_on_page(section: Findings) -> str:
    """Return the table of findings, the worst first."""
    if not section.findings:
        return html.paragraph(section.nothing)
    order = list(Severity)
    rows = []
    for finding in sorted(section.findings, key=lambda finding: order.index(finding.severity)):
        rows += [[str(finding.severity), finding.code, finding.what], ["", "", f"do: {finding.how}"]]
    return html.table((*words("", "code"), Column("what, and what to do", is_text=True, wraps=True)), rows)


def write_result(result: ResultPage, out: Path) -> tuple[Path, ...]:
    """Write the file that a calibration gives, and its report beside it.

    A result that fails writes its report only, under a name that does not exist yet: what an earlier run gave stays.

    Parameters
    ----------
    result : ResultPage
        The result.
    out : Path
        The file to write; the report gets its name with other endings.

    Returns
    -------
    tuple of Path
        What was written.

    Raises
    ------
    OutputError
        If a file cannot be written.
    """
    passed = result.exit_code == PASS
    stem = out.with_suffix("") if passed else _free_stem(out)
    report = write_report(result, stem.with_name(stem.name + ".html"))
    if not passed or result.content is None:
        return report
    write_text(out, result.content)
    return out, *report


def write_report(result: ResultPage, page: Path) -> tuple[Path, Path]:
    """Write the report of a result as HTML, and the same as JSON beside it.

    Parameters
    ----------
    result : ResultPage
        The result.
    page : Path
        The file for the HTML.

    Returns
    -------
    page, numbers : Path
        The files.

    Raises
    ------
    OutputError
        If a file cannot be written.
    """
    numbers, text = page.with_suffix(".json"), json_text(result)
    write_text(page, html_text(result))
    write_text(numbers, text)
    return page, numbers


def _free_stem(out: Path) -> Path:
    """Return a name without an ending, beside a file, under which there is no report yet."""
    stem = out.with_suffix("")
    for number in range(1, 10_000):
        free = stem.with_name(f"{stem.name}.failed" + (f"-{number}" if number > 1 else ""))
        if not any(free.with_name(free.name + end).exists() for end in (".html", ".json")):
            return free
    return stem.with_name(f"{stem.name}.failed")
