import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from palletloc.cli.app import run
from palletloc.config import LocalizerConfig
from palletloc.io.config_file import read_config


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


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("yaw: {serach: 0.1}\n", "mine.yaml: yaw: unknown key 'serach'; did you mean 'search'?"),
        ("yaw: {search: .nan}\n", "mine.yaml: yaw.search: expected a finite number, got nan"),
        (None, "mine.yaml: no such file"),
    ],
)
def test_a_bad_file_is_one_line_and_nothing_is_printed(
    text: str | None,
    problem: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    if text is not None:
        Path("mine.yaml").write_text(text)
    assert run(["config", "--file", "mine.yaml"]) == 1
    assert capsys.readouterr() == ("", f"palletloc: {problem}\n")


def test_meanings_do_not_depend_on_docstrings_being_kept() -> None:
    command = [sys.executable, "-OO", "-m", "palletloc", "config"]
    ended = subprocess.run(command, capture_output=True, text=True, check=True)
    assert "# Farthest pallet from the camera" in ended.stdout
