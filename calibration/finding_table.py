"""Findings as a part of a page and as plain values."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from calibration.findings import Finding, Severity
from palletloc.report.page import Column, heading, paragraph, table


def finding_data(finding: Finding) -> dict[str, str]:
    """Return a finding as plain values for JSON."""
    return {"severity": str(finding.severity), "code": finding.code, "what": finding.what, "how": finding.how}


def finding_line(finding: Finding) -> str:
    """Return a finding as one line of text."""
    return f"{finding.severity}: {finding.code}: {finding.what}; {finding.how}"


def finding_parts(findings: Sequence[Finding], nothing: str) -> Iterator[str]:
    """Yield the part of a page that says what to do next, the worst first."""
    yield heading("What to do next")
    if not findings:
        yield paragraph(nothing)
        return
    order = list(Severity)
    columns = (Column("", is_text=True), Column("code", is_text=True), Column("what, and what to do", is_text=True))
    rows = []
    for one in sorted(findings, key=lambda finding: order.index(finding.severity)):
        rows += [[str(one.severity), one.code, one.what], ["", "", f"do: {one.how}"]]
    yield table(columns, rows)
