"""A new user in an empty folder: one clear line, the right exit code, nothing written."""

from pathlib import Path

import pytest

from tests.calibration.expecting import Calibrate

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
    ("shelf . --out r.txt", 1, "--out r.txt: expected the name of a .yaml file"),
    ("shelf nowhere --out r.yaml", 1, "nowhere: no such folder; expected a recording"),
    ("board --out b.png", 1, "--out b.png: expected the name of a .pdf file"),
    ("board --out b.pdf --dictionary FOO", 1, "unknown dictionary 'FOO'"),
    ("board --out b.pdf --dictionary DICT_4X4_25", 1, "did you mean 'DICT_4X4_250'?"),
    ("board --out b.pdf --first 240", 1, "the ids 0 to 249; the target needs 240 to 256"),
    ("board --rows 1", 2, "Invalid value for '--rows'"),
    ("shelf . --out r.yaml --side up --distance 2", 2, "--side up: expected left or right"),
    ("shelf . --out r.yaml --side left", 2, "--side and --distance go together"),
    ("shelf . --out r.yaml --front beams", 2, "--front beams: expected uprights or pallets"),
    ("shelf .", 2, "Missing option '--out'"),
    ("extrinsics", 2, "Missing option '--out'"),
    ("extrinsics x", 2, "Missing option '--out'"),
    ("extrinsics x --motion y --out r.yaml", 2, "expected one of FOLDER and --motion RECORDING"),
    ("extrinsics --out r.yaml", 2, "expected one of FOLDER and --motion RECORDING"),
    ("check", 2, "RECORDING"),
    ("intrinsics", 2, "FOLDER"),
    ("plan", 2, "LAYOUT"),
    ("plan a b", 2, "unexpected extra argument"),
    ("nothing", 2, "No such command 'nothing'"),
    ("", 2, ""),
]


@pytest.mark.parametrize(("line", "code", "told"), WRONG)
def test_wrong_input_is_told_in_one_line(
    line: str, code: int, told: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, calibrate: Calibrate
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "150")
    ended = calibrate(*line.split())
    assert ended.code == code
    assert told in ended.err
    assert "Traceback" not in ended.err
    if code == 1:
        ended.refuses(told)
    assert not list(tmp_path.iterdir())
