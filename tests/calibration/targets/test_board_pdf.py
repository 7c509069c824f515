import re
import zlib
from pathlib import Path

import numpy as np
import pytest

from calibration.targets.board_pdf import board_pdf
from calibration.targets.targets import CharucoBoard, SingleTag, Target, board_pattern, patterns
from palletloc.__main__ import COMMANDS
from palletloc.cli.app import run

POINT = 0.0254 / 72
BOARD = CharucoBoard(7, 5, 0.1, 0.075, "DICT_4X4_250", 17)


def drawn(content: bytes) -> str:
    """Return the page's drawing operators."""
    streams = re.findall(rb"stream\r?\n(.*?)\r?\nendstream", content, re.DOTALL)
    for stream in streams:
        text = zlib.decompress(stream).decode("latin-1") if stream[:1] == b"x" else ""
        if " re" in text or " l\n" in text:
            return text
    return ""


def page_size(content: bytes) -> tuple[float, float]:
    box = re.search(rb"/MediaBox \[ *0 0 ([\d.]+) ([\d.]+) *\]", content)
    assert box is not None
    return float(box[1]) * POINT, float(box[2]) * POINT


@pytest.mark.parametrize("target", [BOARD, SingleTag(0.15, "DICT_APRILTAG_36h11", 3)])
def test_the_page_is_as_large_as_the_print_and_its_margin(target: Target) -> None:
    width, height = page_size(board_pdf(target))
    pattern = patterns(target)[0]
    assert 0.02 < width - pattern.width < 0.06
    assert 0.04 < height - pattern.height < 0.1


def test_all_black_is_drawn_at_true_scale() -> None:
    pattern = board_pattern(BOARD)
    path = max(re.split(r"^f$", drawn(board_pdf(BOARD)), flags=re.MULTILINE), key=len)
    corners = np.array(re.findall(r"^([\d.-]+) ([\d.-]+) [ml]$", path, re.MULTILINE), dtype=np.float64) * POINT
    sides = np.ptp(corners, axis=0)
    np.testing.assert_allclose(sides, [0.7, 0.5], atol=2e-5)
    boxes = corners.reshape(-1, 4, 2) if len(corners) % 5 else corners.reshape(-1, 5, 2)
    areas = np.ptp(boxes, axis=1).prod(axis=1)
    expected = (pattern.black[:, 2:] - pattern.black[:, :2]).prod(axis=1)
    np.testing.assert_allclose(np.sort(areas), np.sort(expected), rtol=1e-3)


def test_the_same_board_gives_the_same_file() -> None:
    assert board_pdf(BOARD) == board_pdf(BOARD)


def test_the_command_writes_the_page_and_says_what_it_is(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "board.pdf"
    assert run(["calibrate", "board", "--out", str(path), "--columns", "6", "--first", "8"], COMMANDS) == 0
    assert path.read_bytes().startswith(b"%PDF")
    assert "charuco: {columns: 6, rows: 5, square_m: 0.1, marker_m: 0.075" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--out", "b.png"], "expected the name of a .pdf file"),
        (["--out", "b.pdf", "--dictionary", "DICT_4X4_25"], "did you mean 'DICT_4X4_250'?"),
        (["--out", "b.pdf", "--first", "240"], "the ids 0 to 249; the target needs 240 to 256"),
    ],
)
def test_a_board_that_cannot_be_is_one_line(
    options: list[str],
    message: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert run(["calibrate", "board", *options], COMMANDS) == 1
    assert message in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []
