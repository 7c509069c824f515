import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
import yaml

from palletloc.cli.app import run
from palletloc.config import LocalizerConfig
from palletloc.io.config_file import read_config
from palletloc.pallet_library import format_pallets, load_library

LIBRARY = load_library()
Refused = Callable[..., str]
MINE = """\
mine:
  width_m: 1.05
  height_m: 0.14
  depth_m: 0.7
  openings:
  - {center_m: -0.25, bottom_m: 0, width_m: 0.3, height_m: 0.09}
  - {center_m: 0.25, bottom_m: 0.02, width_m: 0.3, height_m: 0.09}
  source: measured on [five] pallets
  confirmed: true
"""


@pytest.fixture(autouse=True)
def wide_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "220")


@pytest.fixture
def pallet_file(tmp_path: Path) -> Path:
    path = tmp_path / "pallets.yaml"
    path.write_text(MINE)
    return path


def rows(printed: str) -> dict[str, str]:
    """Return the table's rows by their first word."""
    lines = printed.splitlines()
    return {line.split()[0]: line for line in reversed(lines) if line.strip()}


def test_every_model_has_a_row_that_says_what_its_face_is_like(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["pallets"]) == 0
    found = rows(capsys.readouterr().out.replace("\N{MULTIPLICATION SIGN}", "x"))
    assert set(LIBRARY) <= set(found)
    for name, model in LIBRARY.items():
        assert f" {'yes' if model.confirmed else 'no'} " in found[name]
        assert model.source[:20] in found[name]
    assert " 1200 x 144 " in found["epal1-1200"]
    assert " 2 of 382.5 x 100 at 22 " in found["epal1-1200"]
    assert " 2 of 227.5 x 100 open " in found["epal1-800"]
    assert found["t11-plastic"].split(" at 24 ")[1].split()[0] == "10"  # the edge radius


def test_named_models_are_shown_alone_with_their_notes(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["pallets", "t11", "epal1-800"]) == 0
    printed = capsys.readouterr().out
    assert "cp9" not in printed
    for name in ("t11", "epal1-800"):
        assert f"source: {LIBRARY[name].source}" in printed
        assert f"note: {LIBRARY[name].note}" in printed


def test_the_users_models_come_first(pallet_file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["pallets", "--file", str(pallet_file)]) == 0
    printed = capsys.readouterr().out
    assert printed.index(" mine ") < printed.index(" epal1-1200 ")
    assert "measured on [five] pallets" in printed  # brackets are no mark-up


def test_unequal_openings_stand_apart(pallet_file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["pallets", "mine", "--file", str(pallet_file)]) == 0
    printed = capsys.readouterr().out.replace("\N{MULTIPLICATION SIGN}", "x")
    assert "1 of 300 x 90 open" in printed
    assert "1 of 300 x 90 at 20" in printed


def test_a_users_model_hides_one_of_the_same_name(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "pallets.yaml"
    path.write_text(MINE.replace("mine", "t11"))
    assert run(["pallets", "t11", "--file", str(path)]) == 0
    assert "measured on [five] pallets" in capsys.readouterr().out


def test_the_drawing_is_a_png_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "new folder" / "faces.PNG"
    assert run(["pallets", "t11", "--draw", str(path)]) == 0
    assert path.read_bytes().startswith(b"\x89PNG\r\n\x1a\n")
    assert [p.name for p in path.parent.iterdir()] == [path.name]
    assert f"drawn: {path}" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "problem"),
    [
        (["t1"], "unknown pallet model 't1'; did you mean 't11'?"),
        (["--file", "none.yaml"], "none.yaml: No such file or directory; expected a file of pallet models"),
        (["--draw", "faces.jpg"], "--draw faces.jpg: expected the name of a .png file"),
        (["t11", "--draw", "pallets.yaml/faces.png"], "pallets.yaml/faces.png: cannot be written: "),
        (["--file", "pallets.yaml"], "pallets.yaml: mine.edge_radius_m: expected a number, got 'round'"),
    ],
)
def test_bad_input_is_one_line_and_nothing_is_drawn(
    arguments: list[str],
    problem: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("pallets.yaml").write_text(MINE + "  edge_radius_m: round\n")
    assert run(["pallets", *arguments]) == 1
    error = capsys.readouterr().err
    assert error.startswith(f"palletloc: {problem}")
    assert error.count("\n") == 1
    assert [path.name for path in tmp_path.iterdir()] == ["pallets.yaml"]


def test_what_the_library_writes_can_be_listed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "pallets.yaml"
    path.write_text(format_pallets(LIBRARY.values()), encoding="utf-8")
    assert run(["pallets"]) == 0
    listed = capsys.readouterr().out
    assert run(["pallets", "--file", str(path)]) == 0
    assert capsys.readouterr().out == listed


def test_what_is_printed_can_be_fed_back(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "all.yaml"
    assert run(["config"]) == 0
    printed = capsys.readouterr().out
    path.write_text(printed)
    assert read_config(path) == LocalizerConfig()
    assert run(["config", "--file", str(path)]) == 0
    assert capsys.readouterr().out == printed


def test_a_files_values_take_the_place_of_the_defaults(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text("detection: {max_range: 4.5}\n")
    assert run(["config"]) == 0
    default = yaml.safe_load(capsys.readouterr().out)
    assert run(["config", "--file", str(path)]) == 0
    mine = yaml.safe_load(capsys.readouterr().out)
    assert mine["detection"].pop("max_range") == 4.5
    assert default["detection"].pop("max_range") != 4.5
    assert mine == default


def test_a_bad_file_is_one_line_and_nothing_is_printed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, refused: Refused
) -> None:
    monkeypatch.chdir(tmp_path)
    assert refused("config", "--file", "mine.yaml") == "mine.yaml: no such file"
    for text, problem in (
        ("yaw: {serach: 0.1}\n", "yaw: unknown key 'serach'; did you mean 'search'?"),
        ("yaw: {search: .nan}\n", "yaw.search: expected a finite number, got nan"),
    ):
        Path("mine.yaml").write_text(text)
        assert refused("config", "--file", "mine.yaml") == f"mine.yaml: {problem}"


def test_meanings_do_not_depend_on_docstrings_being_kept() -> None:
    command = [sys.executable, "-OO", "-m", "palletloc", "config"]
    ended = subprocess.run(command, capture_output=True, text=True, check=True)
    assert "# Farthest pallet from the camera" in ended.stdout
