from pathlib import Path

import pytest

from palletloc.geometry import LevelPose
from palletloc.io.csv_table import TableError
from palletloc.io.recording import ShotFile
from palletloc.io.starts import read_starts
from palletloc.localizer import Start

SHOTS = (ShotFile(0.0, "0.jpg"), ShotFile(0.336842, "1.jpg"), ShotFile(0.673684, "2.jpg"))
HEADER = "time_s,model,x_m,y_m,z_m,yaw_rad\n"


def starts_file(folder: Path, *rows: str) -> Path:
    path = folder / "initial.csv"
    path.write_text(HEADER + "".join(f"{row}\n" for row in rows))
    return path


def test_starts_of_one_shot_come_together_and_in_order(tmp_path: Path) -> None:
    path = starts_file(tmp_path, "0.3368,b,1,2,0,0.5", "0.336842,a,1.5,2,0,0.5", "0,a,1,1,0,0")
    groups = read_starts(path, SHOTS)
    assert [group.shot.file for group in groups] == ["1.jpg", "0.jpg"]
    assert groups[0].starts == (Start("b", LevelPose(1.0, 2.0, 0.0, 0.5)), Start("a", LevelPose(1.5, 2.0, 0.0, 0.5)))


def test_a_file_that_comes_back_to_a_shot_keeps_its_order(tmp_path: Path) -> None:
    path = starts_file(tmp_path, "0,a,1,1,0,0", "0.673684,a,1,1,0,0", "0,b,1,1,0,0")
    assert [group.shot.file for group in read_starts(path, SHOTS)] == ["0.jpg", "2.jpg", "0.jpg"]


def test_no_rows_are_no_starts(tmp_path: Path) -> None:
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
