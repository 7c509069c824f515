"""What a calibration has to say about itself: one code, what is the case, and what to do."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from enum import StrEnum

PASS, FAIL, DEGENERATE = 0, 1, 3
"""Exit codes of a calibration; 2 is wrong usage."""


class Severity(StrEnum):
    """What follows from a finding."""

    DEGENERATE = "degenerate"
    """The data cannot give the result, however good they are: exit code 3."""
    FAIL = "fail"
    """The data contradict themselves or are too uncertain: exit code 1."""
    WARNING = "warning"
    """The result holds, with a restriction."""
    NOTE = "note"
    """Something was decided that the user should know."""


@dataclass(frozen=True, slots=True)
class Finding:
    """What a calibration has to say about its result or its input, and what follows from it."""

    severity: Severity
    """What follows."""
    code: str
    """Stable name, for programs."""
    what: str
    """One sentence: what is the case, and where."""
    how: str
    """One sentence: what to do."""


class Judgement(StrEnum):
    """The one verdict on a result that follows from all of its findings."""

    HOLDS = "holds"
    """Nothing restricts it."""
    RESTRICTED = "restricted"
    """It can be used, but warnings restrict it."""
    FAILS = "fails"
    """It contradicts itself or is too uncertain."""
    DEGENERATE = "degenerate"
    """The data cannot give it."""


def judgement(findings: Iterable[Finding]) -> Judgement:
    """Return the verdict that the worst of some findings demands.

    Examples
    --------
    >>> str(judgement([Finding(Severity.WARNING, "uncertain", "...", "...")]))
    'restricted'
    """
    severities = {finding.severity for finding in findings}
    demands = {
        Severity.DEGENERATE: Judgement.DEGENERATE,
        Severity.FAIL: Judgement.FAILS,
        Severity.WARNING: Judgement.RESTRICTED,
    }
    return next((verdict for severity, verdict in demands.items() if severity in severities), Judgement.HOLDS)


def notes_on_input(notes: Iterable[str]) -> Iterator[Finding]:
    """Yield what was strange when the files of a recording were read."""
    for note in notes:
        yield Finding(Severity.WARNING, "strange_input", note, "check the file and what it was made from")


def exit_code(findings: Iterable[Finding]) -> int:
    """Return the exit code that the findings demand.

    Examples
    --------
    >>> exit_code([Finding(Severity.WARNING, "one_lens_side", "...", "...")])
    0
    """
    codes = {Judgement.FAILS: FAIL, Judgement.DEGENERATE: DEGENERATE}
    return codes.get(judgement(findings), PASS)
