import math
from enum import StrEnum
from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from palletloc import LevelPose, PalletMeasurement, RefusedCandidate, Start
from palletloc.io.csv_table import TableError, format_number, in_order_of_time, read_rows, write_rows
from palletloc.io.measurements import NoPose, read_measurements, read_refusals, write_measurements, write_refusals
from palletloc.io.reading import InputError
from palletloc.io.recording import ShotFile
from palletloc.io.starts import read_starts
from palletloc.measurement import Reason, Stage, YawSource

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


def test_a_file_that_is_no_text_missing_or_a_folder_is_an_error(tmp_path: Path) -> None:
    for content, said in ((b"time_s\xff\n", "not UTF-8"), (GOOD.encode("utf-16"), "not UTF-8"), (b"a,\0\n", "zero")):
        with pytest.raises(InputError, match=rf"table\.csv: .*{said}"):
            values(table(tmp_path, content))
    for path, said in ((tmp_path / "none.csv", r"none\.csv: no such file"), (tmp_path, "is not a file")):
        with pytest.raises(InputError, match=said):
            values(path)


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


def test_a_number_that_is_not_finite_is_never_written() -> None:
    for value in (math.nan, math.inf):
        with pytest.raises(ValueError, match="finite"):
            format_number(value)


SHOTS = (ShotFile(0.0, "0.jpg"), ShotFile(0.336842, "1.jpg"), ShotFile(0.673684, "2.jpg"))
STARTS_HEADER = "time_s,model,x_m,y_m,z_m,yaw_rad\n"


def starts_file(folder: Path, *rows: str) -> Path:
    path = folder / "initial.csv"
    path.write_text(STARTS_HEADER + "".join(f"{row}\n" for row in rows))
    return path


def test_starts_of_one_shot_come_together_and_in_order(tmp_path: Path) -> None:
    path = starts_file(tmp_path, "0.3368,b,1,2,0,0.5", "0.336842,a,1.5,2,0,0.5", "0,a,1,1,0,0")
    groups = read_starts(path, SHOTS)
    assert [group.shot.file for group in groups] == ["1.jpg", "0.jpg"]
    assert groups[0].starts == (Start("b", LevelPose(1.0, 2.0, 0.0, 0.5)), Start("a", LevelPose(1.5, 2.0, 0.0, 0.5)))
    back = starts_file(tmp_path, "0,a,1,1,0,0", "0.673684,a,1,1,0,0", "0,b,1,1,0,0")
    assert [group.shot.file for group in read_starts(back, SHOTS)] == ["0.jpg", "2.jpg", "0.jpg"]
    assert read_starts(starts_file(tmp_path), SHOTS) == ()


@pytest.mark.parametrize(
    ("row", "said"),
    [
        ("0.3,a,1,1,0,0", r"line 3: time_s: no shot at 0\.3 s; the nearest is at 0\.336842 s"),
        ("9,a,1,1,0,0", r"line 3: time_s: no shot at 9 s; the nearest is at 0\.673684 s"),
        ("-1,a,1,1,0,0", r"line 3: time_s: no shot at -1 s; the nearest is at 0 s"),
        ("0,a,1,nan,0,0", r"line 3: y_m: expected a finite number, got 'nan'"),
        ("nan,a,1,1,0,0", r"line 3: time_s: expected a finite number"),
        ("0,,1,1,0,0", r"line 3: model: expected a text"),
        ("0,a,1,1,0", r"line 3: expected 6 cells, got 5"),
    ],
)
def test_a_bad_start_is_an_error_with_file_and_line(tmp_path: Path, row: str, said: str) -> None:
    with pytest.raises(TableError, match=rf"initial\.csv, {said}"):
        read_starts(starts_file(tmp_path, "0,a,1,1,0,0", row), SHOTS)


MEASUREMENTS_HEADER = (
    "time_s,file,model,x_m,y_m,z_m,yaw_rad,cov_xx,cov_xy,cov_xz,cov_xw,cov_yy,cov_yz,cov_yw,cov_zz,cov_zw,cov_ww"
    ",score,yaw_from"
)
SPREAD = np.diag([4e-6, 9e-6, 1e-6, 1e-6]) + np.diag([1e-6, 0.0, 0.0], 1) + np.diag([1e-6, 0.0, 0.0], -1)
POSE = LevelPose(2.0271234, -1.521, 0.0, -0.25)


def measured(time: float = 0.336842, pose: LevelPose = POSE, covariance: object = None) -> PalletMeasurement:
    matrix = SPREAD if covariance is None else np.array(covariance)
    return PalletMeasurement(time, "t11", pose, matrix, 0.8125, YawSource.BOTTOM, "images/1.jpg")


def test_the_file_is_what_the_documentation_says(tmp_path: Path) -> None:
    covariance = np.array([[20, 1, 2, 3], [1, 15, 6, 7], [2, 6, 30, 11], [3, 7, 11, 40.0]])
    write_measurements(tmp_path / "m.csv", [measured(covariance=covariance), NoPose(1.5, "epal", "b,c.jpg")])
    header, row, empty = (tmp_path / "m.csv").read_text().splitlines()
    assert header == MEASUREMENTS_HEADER
    assert row == (
        "0.336842,images/1.jpg,t11,2.027123,-1.521000,0.000000,-0.250000,"
        "2.000000e+01,1.000000e+00,2.000000e+00,3.000000e+00,1.500000e+01,6.000000e+00,7.000000e+00,"
        "3.000000e+01,1.100000e+01,4.000000e+01,0.8125,bottom"
    )
    assert empty == '1.5,"b,c.jpg",epal' + "," * 16


coordinates = st.floats(-100, 100)
poses = st.builds(LevelPose, coordinates, coordinates, coordinates, st.floats(-np.pi, np.pi))


@given(st.lists(st.tuples(st.floats(0, 2e9), poses, st.integers(0, 10**6)), max_size=4))
def test_measurements_written_are_measurements_read(values: list[tuple[float, LevelPose, int]]) -> None:
    written: list[PalletMeasurement | NoPose] = [NoPose(3.25, "t11", "images/0.jpg")]
    for time, pose, seed in values:
        root = np.random.default_rng(seed).normal(size=(4, 4))
        written.append(measured(time, pose, root @ root.T))
    with TemporaryDirectory() as folder:
        write_measurements(Path(folder) / "m.csv", written)
        read = read_measurements(Path(folder) / "m.csv")
    assert read[0] == written[0]
    assert len(read) == len(written)
    for before, after in zip(written[1:], read[1:], strict=True):
        assert isinstance(before, PalletMeasurement)
        assert isinstance(after, PalletMeasurement)
        assert (after.time, after.file, after.model) == (before.time, before.file, before.model)
        assert (after.score, after.yaw_from) == (before.score, before.yaw_from)
        difference = after.forklift_from_pallet.as_array() - before.forklift_from_pallet.as_array()
        assert np.abs(difference).max() <= 0.51e-6
        assert_allclose(after.covariance, before.covariance, rtol=1e-6)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("-1.521000", "", r"line 2: y_m: expected a finite number, got ''"),
        ("-1.521000", "nan", r"line 2: y_m: expected a finite number, got 'nan'"),
        ("4.000000e-06", "-4.000000e-06", r"line 2: cov_xx, .*expected variances"),
        ("4.000000e-06", "0", r"line 2: cov_xx to cov_ww: expected a positive semidefinite matrix"),
        ("4.000000e-06", "1e-320", r"line 2: cov_xx to cov_ww: expected a positive semidefinite matrix"),
        ("4.000000e-06", "1e7", r"line 2: cov_xx: expected square metres and radians from -1e\+06 to 1e\+06"),
        ("0.8125", "1.5", r"line 2: score: expected a rank from 0 to 1, .*; got 1\.5"),
        ("-1.521000", "-1.5e300", r"line 2: y_m: expected metres from -1e\+08 to 1e\+08"),
        ("-0.250000", "-90", r"line 2: yaw_rad: expected radians .*; got -90; are these degrees\?"),
        ("bottom", "botom", r"line 2: yaw_from: unknown word 'botom'; did you mean 'bottom'\?"),
        ("t11", "", r"line 2: model: expected a text"),
        ("0.336842", "", r"line 2: time_s: expected a finite number"),
        ("cov_ww", "cov_w", r"line 1: unknown column 'cov_w'"),
    ],
)
def test_a_bad_row_is_an_error_with_file_and_line(tmp_path: Path, old: str, new: str, said: str) -> None:
    path = tmp_path / "measurements.csv"
    write_measurements(path, [measured()])
    path.write_text(path.read_text().replace(old, new))
    with pytest.raises(TableError, match=rf"measurements\.csv, {said}"):
        read_measurements(path)


@pytest.mark.parametrize(
    "row",
    [
        measured(pose=LevelPose(1.0, float("nan"), 0.0, 0.0)),
        measured(time=float("nan")),
        NoPose(float("inf"), "t11"),
    ],
)
def test_what_is_not_finite_is_never_written(tmp_path: Path, row: PalletMeasurement | NoPose) -> None:
    with pytest.raises(ValueError, match="finite"):
        write_measurements(tmp_path / "measurements.csv", [row])
    assert list(tmp_path.iterdir()) == []


def test_refusals_written_are_refusals_read_and_an_unknown_reason_names_the_nearest(tmp_path: Path) -> None:
    path = tmp_path / "refusals.csv"
    refusals = tuple(
        RefusedCandidate(0.1 * number, "t11", stage, reason, f"images/{number}.jpg")
        for number, (stage, reason) in enumerate(product(Stage, Reason))
    )
    write_refusals(path, refusals)
    assert read_refusals(path) == refusals
    assert path.read_text().startswith("time_s,file,model,stage,reason\n0.0,images/0.jpg,t11,")
    path.write_text("time_s,file,model,stage,reason\n0.0,a.jpg,t11,yaw,no_lines\n")
    with pytest.raises(TableError, match=r"line 2: reason: unknown word 'no_lines'; did you mean 'no_line'\?"):
        read_refusals(path)
