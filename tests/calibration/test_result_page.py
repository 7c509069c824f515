"""A result is said once: every output shows the same sections in the same order."""

import io
import json
from dataclasses import replace
from pathlib import Path

import pytest
from matplotlib.figure import Figure
from rich.console import Console

from calibration.findings import Finding, Severity
from calibration.result_page import (
    Drawing,
    Findings,
    Heading,
    JsonValues,
    KeyFigures,
    Output,
    Paragraph,
    ResultPage,
    Section,
    Table,
    html_text,
    json_text,
    numbers,
    reason_lines,
    terminal_parts,
    words,
    write_report,
    write_result,
)

NOTE = Finding(Severity.NOTE, "upside_down", "a board is turned", "nothing")
FAIL = Finding(Severity.FAIL, "units", "corners are in mm", "write metres")
VERDICTS = {0: "It holds.", 1: "It fails.", 3: "It is open."}
COLUMNS = (*words("target"), *numbers("rms px"))


def result(*findings: Finding, content: str | None = "format: 1\n", more: tuple[Section, ...] = ()) -> ResultPage:
    sections = (JsonValues({"first": 1}), Findings(findings, "Nothing is left."), JsonValues({"last": [2.5]}))
    return ResultPage("palletloc calibrate", "Where it is", VERDICTS, (*sections, *more), content)


def printed(page: ResultPage) -> str:
    console = Console(file=io.StringIO(), width=80)
    for part in terminal_parts(page):
        console.print(part)
    assert isinstance(console.file, io.StringIO)
    return console.file.getvalue()


def test_each_output_shows_what_is_meant_for_it() -> None:
    both = Output.TERMINAL | Output.PAGE
    page = result(
        more=(
            Heading("<Targets>"),
            Table(COLUMNS, (("[B1]", "0.12"),), both, total=("all", "0.20")),
            Paragraph("on the page"),
            Paragraph("on the terminal", Output.TERMINAL),
            Table(numbers("only here"), (("1",),), Output.TERMINAL),
            KeyFigures((("3 mm", "x"),)),
            Drawing(Figure, "A picture."),
        )
    )
    shown, html = printed(page), html_text(page)
    assert "[B1]" in shown
    assert "all" in shown
    assert shown.index("[B1]") < shown.index("on the terminal") < shown.index("only here")
    assert "on the page" not in shown
    assert "&lt;Targets&gt;" in html
    assert html.index("It holds.") < html.index("Nothing is left.") < html.index("[B1]") < html.index("on the page")
    assert html.count("<img ") == html.count('src="data:image/png;base64,') == 1
    for absent in ("on the terminal", "only here", "0.20"):
        assert absent not in html


def test_findings_decide_the_verdict_and_the_worst_stands_first_on_the_page() -> None:
    page = result(NOTE, FAIL)
    assert page.exit_code == 1
    html = html_text(page)
    assert "It fails." in html
    assert html.index("units") < html.index("upside_down")
    assert reason_lines(page)[1] == "fail: units: corners are in mm; write metres"
    assert [reason["code"] for reason in json.loads(json_text(page))["reasons"]] == ["upside_down", "units"]


@pytest.mark.parametrize(
    ("severities", "code", "judgement", "sentence"),
    [
        ([Severity.NOTE], 0, "holds", "It holds."),
        ([Severity.NOTE, Severity.WARNING], 0, "restricted", "It can be used, with a restriction: c1."),
        ([Severity.WARNING, Severity.WARNING], 0, "restricted", "It can be used, with restrictions: c0, c1."),
        ([Severity.WARNING, Severity.FAIL], 1, "fails", "It fails."),
        ([Severity.FAIL, Severity.DEGENERATE, Severity.WARNING], 3, "degenerate", "It is open."),
    ],
)
def test_there_is_one_verdict_on_the_page_in_json_and_as_exit_code(
    severities: list[Severity], code: int, judgement: str, sentence: str
) -> None:
    findings = [Finding(severity, f"c{number}", "x", "y") for number, severity in enumerate(severities)]
    page = replace(result(*findings), restricted="It can be used")
    data, html = json.loads(json_text(page)), html_text(page)
    assert (page.exit_code, page.verdict) == (code, sentence)
    assert (data["exit_code"], data["judgement"], data["verdict"]) == (code, judgement, sentence)
    assert sentence in html
    assert [other for other in VERDICTS.values() if other in html] == (
        [sentence] if sentence in VERDICTS.values() else []
    )


def test_keys_of_the_json_file_keep_their_order() -> None:
    assert list(json.loads(json_text(result()))) == ["format", "exit_code", "first", "reasons", "last"]
    with pytest.raises(ValueError, match="JSON"):
        json_text(result(more=(JsonValues({"open": float("inf")}),)))


def test_a_result_that_fails_overwrites_nothing(tmp_path: Path) -> None:
    out = tmp_path / "rig.yaml"
    assert [path.name for path in write_result(result(), out)] == ["rig.yaml", "rig.html", "rig.json"]
    kept = {path: path.read_text() for path in tmp_path.iterdir()}
    for _ in range(2):
        write_result(result(FAIL), out)
    names = {path.name for path in tmp_path.iterdir()}
    assert {"rig.failed.html", "rig.failed.json", "rig.failed-2.html", "rig.failed-2.json"} < names
    assert {path: path.read_text() for path in kept} == kept


def test_a_plan_has_only_a_report(tmp_path: Path) -> None:
    assert [path.name for path in write_result(result(content=None), tmp_path / "p.html")] == ["p.html", "p.json"]


def test_a_report_has_the_name_that_it_was_given(tmp_path: Path) -> None:
    assert [path.name for path in write_report(result(FAIL), tmp_path / "a.b.HTML")] == ["a.b.HTML", "a.b.json"]
