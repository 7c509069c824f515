"""What a calibration command did: its exit code, what is printed, and where it wrote."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from rich.console import RenderableType


@dataclass(frozen=True, slots=True)
class Outcome:
    """What a run did."""

    exit_code: int
    """Of the program."""
    summary: tuple[RenderableType, ...]
    """To be printed."""
    files: tuple[Path, ...]
    """What was written."""
    reasons: tuple[str, ...]
    """Why it failed, and what is restricted: one line each."""


def free_stem(out: Path) -> Path:
    """Return a name for the reports of a failed run under which there is nothing yet."""
    stem = out.with_suffix("")
    for number in range(1, 10_000):
        free = stem.with_name(f"{stem.name}.failed" + (f"-{number}" if number > 1 else ""))
        if not any(free.with_name(free.name + end).exists() for end in (".html", ".json")):
            return free
    return stem.with_name(f"{stem.name}.failed")
