import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from calibration.intrinsics.board_views import numbered_boards
from calibration.lenses.problem import BoardView
from palletloc import read_camera
from palletloc.cameras import CameraModel, DualFisheye, FisheyeLens, KannalaBrandt
from palletloc.geometry import Image
from tests.calibration.board_room import HEADER, corner_rows, grid, room, write_corners, write_intrinsics, write_shots
from tests.calibration.expecting import Calibrate
from tests.calibration.yard_folder import board, board_key

SIZE = (1600, 800)
TERMS = (0.012, -0.004, 0.001, -0.0001)
TRUTH = DualFisheye(
    FisheyeLens(
        KannalaBrandt(*SIZE, 225.0, 226.0, 401.0, 398.0, *TERMS, float(np.radians(103.0))),
        RigidTransform.from_translation([0.015, 0.0, 0.0]),
    ),
    FisheyeLens(
        KannalaBrandt(*SIZE, 224.0, 224.5, 1198.0, 402.0, *TERMS, float(np.radians(103.0))),
        RigidTransform.from_components([-0.015, 0.0005, -0.001], Rotation.from_euler("zyx", [3.125, 0.01, -0.008])),
    ),
)


BOARDS = room((0.3, 1.7, 3.0, -1.3), 0.9, 0.2, 0.3)


def place(rng: np.random.Generator) -> RigidTransform:
    return RigidTransform.from_components(
        rng.normal(0, 0.15, 3), Rotation.from_rotvec(rng.normal(0, [0.3, 0.3, 1.5]))
    )


def lines(*, still: bool, shots: int, ring: bool = True) -> list[str]:
    rng, rows, points = np.random.default_rng(1), [HEADER], grid(8, 6, 0.06)
    for shot in range(shots):
        camera = place(rng)
        for number, world_from_board in enumerate(BOARDS if still else BOARDS[shot % 4 : shot % 4 + 1]):
            seen = camera.inv().apply(world_from_board.apply(points))
            for lens, fisheye in enumerate((TRUTH.front, TRUTH.back)):
                pixels, valid = fisheye.model.project(fisheye.camera_from_lens.inv().apply(seen))
                if valid.sum() >= 12 and (ring or valid.all()):
                    pixels = pixels + rng.normal(0, 0.05, pixels.shape)
                    rows += corner_rows(f"s{shot},B{number},{lens}", points, pixels, valid)
    return rows


def folder(path: Path, rows: list[str], *, still: bool) -> Path:
    return write_corners(path, SIZE, rows, lenses=2, boards_stand_still=still)


def assert_places_found(camera: CameraModel) -> DualFisheye:
    """Hold that the back lens lies before the front one as it does in truth."""
    assert isinstance(camera, DualFisheye)
    found, truth = (dual.front.camera_from_lens.inv() * dual.back.camera_from_lens for dual in (camera, TRUTH))
    assert np.degrees((found * truth.inv()).rotation.magnitude()) < 0.05
    assert np.abs(found.translation - truth.translation).max() < 0.002
    assert np.abs((found * truth.inv()).translation).max() < 0.002
    return camera


@pytest.mark.parametrize(("still", "shots"), [(True, 10), pytest.param(False, 30, marks=pytest.mark.slow)])
def test_two_lenses_become_one_camera(tmp_path: Path, calibrate: Calibrate, still: bool, shots: int) -> None:
    path = folder(tmp_path / "in", lines(still=still, shots=shots), still=still)
    assert calibrate("intrinsics", path, "--out", tmp_path / "camera.yaml").code == 0
    camera = assert_places_found(read_camera(tmp_path / "camera.yaml"))
    # The frame: midway between the lenses, x along the front one, the image upright.
    middle = camera.front.camera_from_lens.translation + camera.back.camera_from_lens.translation
    np.testing.assert_allclose(middle, 0, atol=1e-9)
    assert camera.front.camera_from_lens.rotation.apply([1.0, 0, 0])[0] > 0.999
    assert camera.front.camera_from_lens.rotation.apply([0.0, 0, 1.0])[2] > 0.999
    data = json.loads((tmp_path / "camera.json").read_text())
    assert data["rms_px"] == pytest.approx(0.05 * np.sqrt(2), rel=0.05)
    assert len(data["lenses"]) == 2


@pytest.mark.slow
def test_raw_shots_of_boards_give_both_lenses(
    tmp_path: Path, calibrate: Calibrate, render: Callable[..., Image]
) -> None:
    small = [
        FisheyeLens(
            KannalaBrandt(1200, 600, 170.0, 170.5, cx, 299.0, *TERMS, float(np.radians(100.0))), lens.camera_from_lens
        )
        for lens, cx in ((TRUTH.front, 301.0), (TRUTH.back, 898.0))
    ]
    truth = DualFisheye(*small)
    rng, middle = np.random.default_rng(5), RigidTransform.from_translation([-0.4, -0.3, 0.0])
    cameras = [place(rng) for _ in range(7)]
    shots = [
        render(truth, [(board(k), camera.inv() * pose * middle) for k, pose in enumerate(BOARDS)])
        for camera in cameras
    ]
    boards = {f"B{k}": board_key(k) for k in (4, 0, 1, 2, 3)}  # the fifth board is never seen
    write_intrinsics(
        tmp_path, (1200, 600), lenses=2, shots=write_shots(tmp_path, shots), boards_stand_still=True, boards=boards
    )
    assert calibrate("intrinsics", tmp_path, "--out", tmp_path / "camera.yaml").code == 0
    assert_places_found(read_camera(tmp_path / "camera.yaml"))
    assert json.loads((tmp_path / "camera.json").read_text())["rms_px"] < 0.05


def test_a_board_that_is_never_seen_has_no_number() -> None:
    views = [BoardView(f"{i}", i, number, 0, *([np.zeros((1, 3))] * 3)) for i, number in enumerate((3, 1, 3))]
    assert [view.board for view in numbered_boards(views)] == [1, 0, 1]


def test_lenses_without_a_link_are_degenerate(tmp_path: Path, calibrate: Calibrate) -> None:
    rows = lines(still=False, shots=30, ring=False)
    first, second = ({row.split(",")[0] for row in rows[1:] if row.split(",")[2] == lens} for lens in "01")
    alone = [rows[0], *(row for row in rows[1:] if row.split(",")[0] not in first & second)]
    ended = calibrate("intrinsics", folder(tmp_path / "in", alone, still=False), "--out", tmp_path / "camera.yaml")
    assert ended.code == 3
    assert "degenerate: lenses_not_linked" in ended.err


def test_two_lenses_take_one_model_only(tmp_path: Path, calibrate: Calibrate) -> None:
    path = folder(tmp_path / "in", lines(still=False, shots=6), still=False)
    ended = calibrate("intrinsics", path, "--out", tmp_path / "camera.yaml", "--model", "eucm")
    ended.refuses("a camera with two lenses needs the model kannala_brandt")
