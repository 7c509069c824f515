"""The page index.html of many recordings: all of them at a glance, each with a link to its own report."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from urllib.parse import quote

from palletloc.drawing.canvas import small_png
from palletloc.evaluation.batch import BatchResult, SourceTotals, pooled
from palletloc.evaluation.requirement import Requirement, Verdict, check_requirement
from palletloc.report import page as html
from palletloc.report.error_figures import batch_figure
from palletloc.report.evaluation_page import REPORT
from palletloc.report.source_style import NONE, QUANTITIES, STYLES

INDEX = "index.html"
"""Name of the file."""
_COLUMNS = (
    html.Column("recording", is_text=True),
    html.Column("run", is_text=True),
    html.Column("source", is_text=True),
    html.Column("found"),
    *(html.Column(f"{quantity.label} {quantity.unit}") for quantity in QUANTITIES),
    html.Column("inside"),
    html.Column("verdict", is_text=True),
)
"""Columns of the table of recordings."""


def batch_page(folder: Path, results: Sequence[BatchResult], requirement: Requirement) -> str:
    """Return the page of the recordings of a folder, in the order of the results, held against a requirement.

    Their reports lie in folders of their names.
    """
    failed = [result for result in results if result.problem]
    overall = pooled(results)
    title = f"{folder.resolve().name}: {len(results)} recordings against the truth"
    parts = [html.heading(title, level=1)]
    for totals in overall:
        parts += _overall(totals, requirement)
    if failed:
        parts.append(html.heading("Not evaluated"))
        parts += [html.paragraph(f"{result.name}: {result.problem}") for result in failed]
    parts += [html.heading("Recordings"), html.paragraph("Median and 95 % of the absolute errors.")]
    rows = [row for result in results for row in _rows(html.Link(result.name, _report(result)), result, requirement)]
    parts.append(html.table(_COLUMNS, [*rows, *_rows("all", BatchResult("", overall), requirement)]))
    caption = "Median and 95 % of the absolute errors of each recording."
    parts.append(html.picture(html.embedded(small_png(batch_figure(results, requirement))), caption, keep_wide=True))
    return html.page(title, parts)


def _report(result: BatchResult) -> str:
    return f"{quote(result.name)}/{REPORT}"


def _overall(totals: SourceTotals, requirement: Requirement) -> Iterator[str]:
    check = check_requirement(totals.offsets, requirement).together
    inside = check.proportion
    verdict = {Verdict.MET: "met", Verdict.NOT_MET: "not met"}.get(check.verdict, "undecided")
    missing = f": {check.decision}" if check.decision else ""
    yield html.paragraph(f"{totals.run}, {STYLES[totals.source].label}: requirement {verdict}{missing}.", "lead")
    yield html.key_figures(
        [
            (inside.counted, f"errors inside, {100 * requirement.share:g} % required"),
            (f"{len(totals.offsets)} of {totals.visible}", "pallets found that had to be"),
            (str(totals.false), "estimates where no pallet stands"),
            (str(totals.shots), "shots"),
        ]
    )


def _rows(name: html.Cell, result: BatchResult, requirement: Requirement) -> Iterator[list[html.Cell]]:
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
