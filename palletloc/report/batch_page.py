"""The page index.html of many recordings: all of them at a glance, each with a link to its own report."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from urllib.parse import quote

from palletloc.drawing.canvas import small_png
from palletloc.evaluation.batch import BatchResult, SourceTotals, pooled
from palletloc.evaluation.requirement import Requirement, Verdict, check_requirement
from palletloc.report.error_figures import batch_figure
from palletloc.report.evaluation_page import REPORT
from palletloc.report.page import (
    Cell,
    Column,
    Link,
    embedded,
    heading,
    key_figures,
    page,
    paragraph,
    picture,
    table,
)
from palletloc.report.source_style import NONE, QUANTITIES, STYLES

INDEX = "index.html"
"""Name of the file."""
_COLUMNS = (
    Column("recording", is_text=True),
    Column("run", is_text=True),
    Column("source", is_text=True),
    Column("found"),
    *(Column(f"{quantity.label} {quantity.unit}") for quantity in QUANTITIES),
    Column("inside"),
    Column("verdict", is_text=True),
)
"""Columns of the table of recordings."""


def batch_page(folder: Path, results: Sequence[BatchResult], requirement: Requirement) -> str:
    """Return the page.

    Parameters
    ----------
    folder : Path
        The recordings' folder, for the title.
    results : sequence of BatchResult
        One for each recording, in the order to list them; the reports lie in folders of their names.
    requirement : Requirement
        What the errors are held against.
    """
    failed = [result for result in results if result.problem]
    overall = pooled(results)
    title = f"{folder.resolve().name}: {len(results)} recordings against the truth"
    parts = [heading(title, level=1)]
    for totals in overall:
        parts += _overall(totals, requirement)
    if failed:
        parts.append(heading("Not evaluated"))
        parts += [paragraph(f"{result.name}: {result.problem}") for result in failed]
    parts += [heading("Recordings"), paragraph("Median and 95 % of the absolute errors.")]
    rows = [row for result in results for row in _rows(Link(result.name, _report(result)), result, requirement)]
    parts.append(table(_COLUMNS, [*rows, *_rows("all", BatchResult("", overall), requirement)]))
    caption = "Median and 95 % of the absolute errors of each recording."
    parts.append(picture(embedded(small_png(batch_figure(results, requirement))), caption, keep_wide=True))
    return page(title, parts)


def _report(result: BatchResult) -> str:
    return f"{quote(result.name)}/{REPORT}"


def _overall(totals: SourceTotals, requirement: Requirement) -> Iterator[str]:
    check = check_requirement(totals.offsets, requirement).together
    inside = check.proportion
    verdict = {Verdict.MET: "met", Verdict.NOT_MET: "not met"}.get(check.verdict, "undecided")
    yield paragraph(f"{totals.run}, {STYLES[totals.source].label}: requirement {verdict}.", "lead")
    yield key_figures(
        [
            (inside.counted, f"errors inside, {100 * requirement.share:g} % required"),
            (f"{len(totals.offsets)} of {totals.visible}", "pallets found that had to be"),
            (str(totals.false), "estimates where no pallet stands"),
            (str(totals.shots), "shots"),
        ]
    )


def _rows(name: Cell, result: BatchResult, requirement: Requirement) -> Iterator[list[Cell]]:
    for number, totals in enumerate(result.totals):
        check = check_requirement(totals.offsets, requirement).together
        inside = check.proportion
        yield [
            "" if number else name,
            totals.run,
            STYLES[totals.source].label,
            f"{len(totals.offsets)} of {totals.visible}",
            *(quantity.sizes_text(totals.offsets) or NONE for quantity in QUANTITIES),
            inside.counted,
            str(check.verdict).replace("_", " "),
        ]
    if result.problem:
        yield [result.name, "", "not evaluated", *[""] * (len(_COLUMNS) - 3)]
