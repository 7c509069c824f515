"""Boards of intrinsics.yaml: grids of AprilTags, Kalibr's files of targets, and prints that are wrong."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from calibration.intrinsics.board_views import Collected, collect
from calibration.intrinsics.kalibr_target import read_kalibr_target
from calibration.intrinsics.task import Chessboard, read_intrinsics
from calibration.targets.targets import AprilGrid, CharucoBoard, on_board
from palletloc.cameras import KannalaBrandt
from palletloc.errors import PalletLocError
from palletloc.geometry import Image
from tests.calibration.board_room import towards, write_intrinsics, write_shots
from tests.calibration.expecting import Calibrate

CAMERA = KannalaBrandt(300, 240, 160.0, 161.0, 151.0, 118.0, 0.01, max_angle=1.0)
CHARUCO = CharucoBoard(5, 4, 0.07, 0.052, "DICT_4X4_50")
CHARUCO_KEY = {"charuco": {"columns": 5, "rows": 4, "square_m": 0.07, "marker_m": 0.052, "dictionary": "DICT_4X4_50"}}
GRID = AprilGrid(3, 2, 0.1, 0.3)
KALIBR = "target_type: 'aprilgrid' #gridtype\ntagCols: 3\ntagRows: 2\ntagSize: 0.1\ntagSpacing: 0.3\n"
Render = Callable[..., Image]


def pose(width: float, height: float) -> RigidTransform:
    facing = towards(0.2, -0.1)
    turned = facing * facing.from_rotvec([0.2, -0.3, 0.1])
    middle = facing.apply([0, 0, 0.42])
    return RigidTransform.from_components(middle - turned.apply([width / 2, height / 2, 0.0]), turned)


@pytest.fixture(scope="module")
def charuco_shot(render: Render) -> Image:
    return render(CAMERA, [(CHARUCO, pose(0.35, 0.28))])


def collected(folder: Path, image: Image, boards: dict[str, Any]) -> Collected:
    shots = write_shots(folder, [image])
    write_intrinsics(folder, (300, 240), shots=shots, boards=boards)
    return collect(read_intrinsics(folder))


def test_a_grid_of_kalibr_is_found(tmp_path: Path, render: Render) -> None:
    at = pose(0.42, 0.29)
    (tmp_path / "april.yaml").write_text(KALIBR)
    found = collected(tmp_path, render(CAMERA, [(GRID, at)]), {"A": {"kalibr": "april.yaml"}})
    assert len(found.views) == 1
    view = found.views[0]
    assert len(view.points) >= 16
    off = np.linalg.norm(CAMERA.project(at.apply(view.points)).pixels - view.pixels, axis=-1)
    assert off.max() < 0.5
    assert found.patterns[view.name].corners.shape == (24, 2)
    np.testing.assert_allclose(on_board(found.patterns[view.name].corners).max(0), [0.39, 0.26, 0.0], atol=1e-9)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda image: image, None),
        (lambda image: image[:, ::-1], "its markers are mirrored"),
        (lambda image: 255 - image, "its markers are inverted"),
    ],
)
def test_prints_that_are_mirrored_or_inverted_are_said(
    tmp_path: Path, charuco_shot: Image, change: Callable[[Image], Image], reason: str | None
) -> None:
    found = collected(tmp_path, np.ascontiguousarray(change(charuco_shot)), {"A": CHARUCO_KEY})
    assert len(found.views) == (reason is None)
    assert [why.split(":")[0] for why in found.reasons.values()] == ([reason] if reason else [])


def test_squares_taken_for_corners_are_said(tmp_path: Path, render: Render, calibrate: Calibrate) -> None:
    board = Chessboard(6, 5, 0.05)
    shots = write_shots(tmp_path, [render(CAMERA, [(board, pose(0.35, 0.3))])])
    stated = {"chessboard": {"inner_columns": 7, "inner_rows": 6, "square_m": 0.05}}
    write_intrinsics(tmp_path, (300, 240), shots=shots, boards={"A": stated})
    ended = calibrate("intrinsics", tmp_path, "--out", tmp_path / "c.yaml")
    assert ended.code == 3
    page = (tmp_path / "c.failed.json").read_text()
    assert "0.png shows no whole board; it shows 6 x 5 inner corners, board A has 7 x 6" in page


@pytest.mark.parametrize(
    ("text", "board"),
    [
        (KALIBR, GRID),
        ("%YAML:1.0\n" + KALIBR, GRID),
        (
            "target_type: checkerboard\ntargetCols: 6\ntargetRows: 7\n"
            "rowSpacingMeters: 0.06\ncolSpacingMeters: 0.06\n",
            Chessboard(6, 7, 0.06),
        ),
    ],
)
def test_files_of_kalibr_describe_boards(tmp_path: Path, text: str, board: Chessboard | AprilGrid) -> None:
    (tmp_path / "t.yaml").write_text(text)
    assert read_kalibr_target(tmp_path / "t.yaml") == board


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("target_type: circlegrid\n", "target_type: is a grid of circles"),
        ("target_type: aprilgird\n", "target_type: unknown 'aprilgird'; did you mean 'aprilgrid'"),
        (KALIBR.replace("tagCols: 3", "tagCols: 3.5"), "tagCols: expected a whole number from 1"),
        (KALIBR.replace("tagSpacing: 0.3", "tagSpacing: 30"), "a spacing of 30"),
        (KALIBR.replace("tagCols: 3", "tagCols: 400"), "has the ids 0 to 586"),
        ("target_type: checkerboard\ntargetCols: 6\ntargetRows: 7\nrowSpacingMeters: 0.06\ncolSpacingMeters: 0.05\n",
         "rowSpacingMeters: expected the positive colSpacingMeters"),
        ("a: 1\n", "target_type: is missing"),
    ],
)  # fmt: skip
def test_a_wrong_target_is_one_line(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "t.yaml").write_text(text)
    cv2.imwrite(str(tmp_path / "0.png"), np.zeros((240, 300), np.uint8))
    write_intrinsics(tmp_path, (300, 240), shots=["0.png"], boards={"A": {"kalibr": "t.yaml"}})
    with pytest.raises(PalletLocError) as caught:
        read_intrinsics(tmp_path)
    assert message in str(caught.value)
    assert "t.yaml" in str(caught.value)
