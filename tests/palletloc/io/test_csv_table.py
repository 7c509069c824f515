import math
from enum import StrEnum
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
from hypothesis import given
from hypothesis import strategies as st

from palletloc.io.csv_table import TableError, format_number, in_order_of_time, read_rows, write_rows
from palletloc.io.reading import InputError

COLUMNS = ("time_s", "x_m", "file")
GOOD = "time_s,x_m,file\n0.0,1.5,a.jpg\n0.5,-2e-3,b.jpg\n"


class Side(StrEnum):
    LEFT = "left"
    RIGHT = "right"


def table(folder: Path, text: str | bytes) -> Path:
    path = folder / "table.csv"
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return path


def values(path: Path) -> list[tuple[float, float, str]]:
    rows = in_order_of_time(read_rows(path, COLUMNS))
    return [(row.number("time_s"), row.number("x_m"), row.text("file")) for row in rows]


@pytest.mark.parametrize(
    "text",
    [
        GOOD,
        "\ufeff" + GOOD,
        GOOD.replace("\n", "\r\n"),
        GOOD.replace("\n", "\r"),
        GOOD.rstrip("\n"),
        GOOD + "\n\n  \n,,\n",
        GOOD.replace(",", " , "),
        "file,time_s,x_m\na.jpg,0.0,1.5\nb.jpg,0.5,-2e-3\n",
        'time_s,x_m,file\n"0.0",1.5,"a.jpg"\n0.5,-2e-3,b.jpg\n',
    ],
    ids=["plain", "bom", "crlf", "cr", "no-end", "empty-end", "blanks", "order", "quotes"],
)
def test_what_programs_write_is_read(tmp_path: Path, text: str) -> None:
    assert values(table(tmp_path, text)) == [(0.0, 1.5, "a.jpg"), (0.5, -0.002, "b.jpg")]


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("x_m", "x_mm", r"line 1: unknown column 'x_mm'; did you mean 'x_m'\?"),
        ("x_m", "lon", r"line 1: unknown column 'lon'; known are file, time_s, x_m"),
        (",file", "", r"line 1: column 'file' is missing; expected time_s,x_m,file"),
        ("x_m,file", "x_m,file,file", r"line 1: column 'file' stands there twice"),
        ("x_m,file", "x_m,file,speed", r"line 1: unknown column 'speed'"),
        (GOOD, GOOD.replace(",", ";"), r"line 1: the cells are not separated by commas"),
        (GOOD, "", r"line 1: no header; expected time_s,x_m,file"),
        (GOOD, "\n" + GOOD, r"line 1: no header"),
        ("b.jpg\n", "b.jpg,1\n", r"line 3: expected 3 cells, got 4"),
        ("b.jpg\n", "b.jpg\n0.7,1", r"line 4: expected 3 cells, got 2"),
        ("-2e-3", "abc", r"line 3: x_m: expected a finite number, got 'abc'"),
        ("-2e-3", "", r"line 3: x_m: expected a finite number, got ''"),
        ("-2e-3", "NaN", r"line 3: x_m: expected a finite number, got 'NaN'"),
        ("-2e-3", "-inf", r"line 3: x_m: expected a finite number, got '-inf'"),
        ("-2e-3", "1e999", r"line 3: x_m: expected a finite number, got '1e999'"),
        ("-2e-3", "1_000", r"line 3: x_m: expected a finite number, got '1_000'"),
        ("-2e-3", "0x10", r"line 3: x_m: expected a finite number, got '0x10'"),
        ("-2e-3", "9" * 999 + "x", r"line 3: x_m: expected a finite number, got '9+ \.\.\.$"),
        ("b.jpg", "", r"line 3: file: expected a text, got nothing"),
        ("0.5,", "0.0,", r"line 3: time_s: 0.0 repeats 0.0 of line 2; expected strictly increasing"),
        ("0.5,", "-0.5,", r"line 3: time_s: -0.5 is earlier than 0.0 of line 2"),
        ("\n0.5", "\n\n0.5", r"line 3: is empty, but rows follow"),
        ("b.jpg", '"b.jpg', r"line 3: is not csv: "),
        ("a.jpg\n0.5", '"a\nb.jpg"\n0.5x', r"line 4: time_s: expected a finite number, got '0.5x'"),
    ],
)
def test_a_bad_table_is_an_error_with_file_and_line(tmp_path: Path, old: str, new: str, said: str) -> None:
    assert old in GOOD
    with pytest.raises(TableError, match=rf"table\.csv, {said}") as caught:
        values(table(tmp_path, GOOD.replace(old, new)))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("content", "said"),
    [(b"time_s\xff\n", "not UTF-8"), (GOOD.encode("utf-16"), "not UTF-8"), (b"time_s,\0\n", "zero bytes")],
)
def test_a_file_that_is_no_text_is_an_error(tmp_path: Path, content: bytes, said: str) -> None:
    with pytest.raises(InputError, match=rf"table\.csv: .*{said}"):
        values(table(tmp_path, content))


def test_a_missing_file_and_a_folder_are_errors(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"none\.csv: no such file"):
        values(tmp_path / "none.csv")
    with pytest.raises(InputError, match="is not a file"):
        values(tmp_path)


def test_an_unknown_word_names_the_nearest(tmp_path: Path) -> None:
    row = next(read_rows(table(tmp_path, "side\nrigth\n"), ["side"]))
    with pytest.raises(TableError, match=r"line 2: side: unknown word 'rigth'; did you mean 'right'\?"):
        row.choice("side", Side)


cells = st.text(st.characters(exclude_categories=["Cc", "Cs", "Co", "Cn", "Cf"]), max_size=20).map(str.strip)


@given(st.lists(st.tuples(st.sampled_from(["a", "b,", '"']), cells, cells), max_size=5))
def test_rows_written_are_rows_read(rows: list[tuple[str, str, str]]) -> None:
    with TemporaryDirectory() as folder:
        path = Path(folder) / "table.csv"
        write_rows(path, COLUMNS, rows)
        assert [tuple(row.cells.values()) for row in read_rows(path, COLUMNS)] == rows


@given(st.floats(-1e6, 1e6))
def test_a_formatted_number_is_near_and_has_no_negative_zero(value: float) -> None:
    text = format_number(value)
    assert abs(float(text) - value) <= 0.51e-6
    assert float(text) != 0 or not text.startswith("-")


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_a_number_that_is_not_finite_is_never_written(value: float) -> None:
    with pytest.raises(ValueError, match="finite"):
        format_number(value)
