"""Tables on terminals of every width."""

from contextlib import redirect_stdout
from io import StringIO

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.text import Text

from palletloc.cli.tables import CUT, new_table, plain_table, print_parts

NAMES = st.text("abcdefg-_0123456789[]/", min_size=1, max_size=30)
ROWS = st.lists(st.tuples(NAMES, NAMES, st.floats(-1e6, 1e6), NAMES), min_size=1, max_size=4)


@given(rows=ROWS, width=st.integers(20, 140))
def test_no_name_and_no_number_is_cut_at_any_width(rows: list[tuple[str, str, float, str]], width: int) -> None:
    table = new_table(["name", "run"], ["depth mm"], ["verdict"], title="errors: measured minus true")
    for name, run, number, verdict in rows:
        table.add_row(Text(name), Text(run), f"{number:.3f}", Text(f"{verdict} {name}"))
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(StringIO()) as printed:
        patch.setenv("COLUMNS", str(width))
        print_parts(["before", table, "after"])
    words = printed.getvalue().split()
    for name, run, number, verdict in rows:
        assert {name, run, f"{number:.3f}", verdict} <= set(words)
    assert words.index("before") < words.index(rows[0][0]) < len(words) - 1 - words[::-1].index("after")


def test_only_a_column_of_explanations_is_cut(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    table = new_table(["name"], ["mm"])
    table.add_column("from", no_wrap=True, overflow=CUT)
    table.add_row("t11-plastic", "12.5", "measured on five pallets of three makers")
    monkeypatch.setenv("COLUMNS", "30")
    print_parts([table])
    printed = capsys.readouterr().out
    assert "t11-plastic" in printed
    assert "12.5" in printed
    assert "measured" in printed
    assert "makers" not in printed
    assert all(len(line) <= 30 for line in printed.splitlines())


def test_what_is_no_terminal_gets_whole_lines(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.delenv("COLUMNS", raising=False)
    table = new_table(["name"], (), ["why"])
    table.add_row("x" * 60, "some reason " * 20)
    print_parts([table])
    (line,) = [line for line in capsys.readouterr().out.splitlines() if "x" * 60 in line]
    assert line.count("some reason") == 20


def test_rows_without_headings_become_lines(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", "20")
    table = plain_table()
    table.add_row("recording", "a-name-that-is-longer-than-that", "7")
    print_parts([table])
    assert capsys.readouterr().out.split() == ["recording", "a-name-that-is-longer-than-that", "7"]
