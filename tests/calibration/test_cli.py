"""A new user in an empty folder: one clear line, the right exit code, nothing written."""

from pathlib import Path

import pytest

from palletloc.__main__ import COMMANDS
from palletloc.cli.app import run

WRONG = [
    ("plan nowhere.yaml", 1, "nowhere.yaml: no such file; expected a layout"),
    ("plan .", 1, "extrinsics.yaml: no such file; expected a layout"),
    ("extrinsics nowhere --out r.yaml", 1, "nowhere: no such folder; expected one with extrinsics.yaml"),
    ("extrinsics . --out r.yaml", 1, "extrinsics.yaml: no such file; expected the camera"),
    ("extrinsics --motion nowhere --out r.yaml", 1, "nowhere: no such folder; expected a recording"),
    ("extrinsics --motion . --out r.yaml", 1, "recording.yaml: no such file"),
    ("intrinsics . --out c.yaml", 1, "intrinsics.yaml: no such file; expected the size of the shots"),
    ("intrinsics . --model meii --out c.yaml", 1, "--model meii: unknown lens model; did you mean 'mei'?"),
    ("convert nowhere --to ros --out c.yaml", 1, "nowhere: no such file; expected a camera file"),
    ("convert . --to ros --out c.yaml", 1, ".: is not a file"),
    ("check . --out c.html", 1, "recording.yaml: no such file"),
    ("check . --out c.pdf", 1, "--out c.pdf: expected the name of a .html file"),
    ("shelf . --out r.yaml", 1, "recording.yaml: no such file"),
    ("board --out b.pdf --dictionary FOO", 1, "unknown dictionary 'FOO'"),
    ("shelf . --out r.yaml --side up --distance 2", 2, "--side up: expected left or right"),
    ("shelf . --out r.yaml --side left", 2, "--side and --distance go together"),
    ("extrinsics --out r.yaml", 2, "expected one of FOLDER and --motion RECORDING"),
    ("check", 2, "RECORDING"),
]


@pytest.mark.parametrize(("line", "code", "told"), WRONG)
def test_wrong_input_is_told_in_one_line(
    line: str,
    code: int,
    told: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "150")
    assert run(["calibrate", *line.split()], COMMANDS) == code
    said = capfd.readouterr().err
    assert told in said
    assert "Traceback" not in said
    if code == 1:
        assert said.count("\n") == 1
    assert not list(tmp_path.iterdir())
