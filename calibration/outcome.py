"""The files of a result: what a calibration gives, and its report as HTML and JSON beside it."""

from __future__ import annotations

from pathlib import Path

from calibration.findings import PASS
from calibration.result_page import html_text, json_text
from calibration.sections import ResultPage
from palletloc.io.atomic import write_text


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
