import re
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest

from calibration.targets.board_pdf import board_pdf
from calibration.targets.targets import (
    CharucoBoard,
    SingleTag,
    Target,
    TargetError,
    board_pattern,
    coverage,
    known_dictionaries,
    marker_dictionary,
    patterns,
)
from tests.calibration.expecting import Calibrate, present

SQUARE = 48  # pixels, so that a marker of 36 has whole modules


def opencv_board(board: CharucoBoard, *, legacy: bool) -> cv2.aruco.CharucoBoard:
    ids = board.first_id + np.arange(board.columns * board.rows // 2)
    dictionary = marker_dictionary(board.dictionary)
    made = cv2.aruco.CharucoBoard((board.columns, board.rows), board.square, board.marker, dictionary, ids)
    made.setLegacyPattern(legacy)
    return made


@pytest.mark.parametrize("rows", [4, 5])
@pytest.mark.parametrize("legacy", [False, True])
def test_a_board_is_black_where_opencv_prints_black(rows: int, legacy: bool) -> None:
    board = CharucoBoard(7, rows, 0.048, 0.036, "DICT_4X4_250", first_id=30)
    picture = opencv_board(board, legacy=legacy).generateImage((7 * SQUARE, rows * SQUARE))
    x, y = ((np.arange(count * SQUARE) + 0.5) / 1000 for count in (7, rows))
    ours = 1 - coverage(board_pattern(board, legacy=legacy), x, y, 0.001)
    assert np.abs(ours - np.asarray(picture) / 255.0).max() < 1e-9


@pytest.mark.parametrize("legacy", [False, True])
def test_markers_are_where_opencv_has_them(legacy: bool) -> None:
    board = CharucoBoard(6, 4, 0.1, 0.07, "DICT_5X5_100", first_id=3)
    theirs = opencv_board(board, legacy=legacy)
    ours = board_pattern(board, legacy=legacy)
    np.testing.assert_array_equal(ours.marker_ids, np.ravel(theirs.getIds()))
    np.testing.assert_allclose(ours.marker_corners, np.array(theirs.getObjPoints())[..., :2], atol=1e-6)
    np.testing.assert_allclose(ours.corners, np.array(theirs.getChessboardCorners())[:, :2], atol=1e-6)


def test_only_boards_with_even_rows_have_a_legacy_pattern() -> None:
    assert [p.legacy for p in patterns(CharucoBoard(7, 5, 0.1, 0.07, "DICT_4X4_50"))] == [False]
    assert [p.legacy for p in patterns(CharucoBoard(7, 4, 0.1, 0.07, "DICT_4X4_50"))] == [False, True]


@pytest.mark.parametrize("dictionary", ["DICT_APRILTAG_36h11", "DICT_6X6_250"])
def test_a_tag_is_black_where_opencv_prints_black(dictionary: str) -> None:
    modules = marker_dictionary(dictionary).markerSize + 2
    picture = np.asarray(marker_dictionary(dictionary).generateImageMarker(7, 10 * modules))
    middles = (np.arange(10 * modules) + 0.5) / 1000
    (pattern,) = patterns(SingleTag(modules / 100, dictionary, 7))
    assert np.abs(1 - coverage(pattern, middles, middles, 0.001) - picture / 255.0).max() < 1e-9


def test_a_cell_between_black_and_white_counts_by_its_area() -> None:
    pattern = board_pattern(CharucoBoard(3, 3, 0.1, 0.05, "DICT_4X4_50"))
    edge = coverage(pattern, np.array([0.1 - 0.0025]), np.array([0.005]), 0.01)
    assert edge[0, 0] == pytest.approx(0.75)


@pytest.mark.parametrize(
    ("target", "message"),
    [
        (
            CharucoBoard(7, 5, 0.1, 0.07, "DICT_4X4_20"),
            "unknown dictionary 'DICT_4X4_20'; did you mean 'DICT_4X4_250'",
        ),
        (CharucoBoard(7, 5, 0.1, 0.07, "DICT_4X4_50", 40), "the ids 0 to 49; the target needs 40 to 56"),
        (CharucoBoard(7, 5, 0.1, 0.1, "DICT_4X4_50"), "smaller than its square"),
        (CharucoBoard(1, 5, 0.1, 0.07, "DICT_4X4_50"), "2 columns and 2 rows"),
        (SingleTag(0.1, "DICT_4X4_50", 50), "the target needs 50 to 50"),
        (SingleTag(0.0, "DICT_4X4_50", 0), "positive size"),
    ],
)
def test_a_target_that_cannot_be_is_refused(target: CharucoBoard | SingleTag, message: str) -> None:
    with pytest.raises(TargetError, match=message.replace("(", r"\(")):
        patterns(target)


def test_every_dictionary_that_is_named_can_be_made() -> None:
    for name in known_dictionaries():
        assert marker_dictionary(name).markerSize >= 4


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
    box = present(re.search(rb"/MediaBox \[ *0 0 ([\d.]+) ([\d.]+) *\]", content))
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


def test_the_command_writes_the_page_and_says_what_it_is(tmp_path: Path, calibrate: Calibrate) -> None:
    path = tmp_path / "board.pdf"
    ended = calibrate("board", "--out", path, "--columns", 6, "--first", 8)
    assert ended.code == 0
    assert path.read_bytes().startswith(b"%PDF")
    assert "charuco: {columns: 6, rows: 5, square_m: 0.1, marker_m: 0.075" in ended.out
