import json
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from scipy.spatial.transform import RigidTransform, Rotation

from calibration.intrinsics.board_views import numbered_boards
from calibration.lenses.problem import BoardView
from calibration.targets.targets import CharucoBoard
from palletloc import read_camera
from palletloc.__main__ import COMMANDS
from palletloc.cameras import DualFisheye, FisheyeLens, KannalaBrandt
from palletloc.cli.app import run
from palletloc.geometry import FloatArray, Image

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
INTO = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])


def board() -> FloatArray:
    x, y = np.meshgrid(np.arange(8) - 3.5, np.arange(6) - 2.5)
    return np.asarray(np.stack([x, y, 0 * x], axis=-1).reshape(-1, 3) * 0.06)


def room(seed: int) -> list[RigidTransform]:
    """Return boards on four sides, facing the middle."""
    rng = np.random.default_rng(seed)
    found = []
    for azimuth in (0.3, 1.7, 3.0, -1.3):
        facing = Rotation.from_euler("zy", [azimuth, rng.normal(0, 0.2)]) * Rotation.from_matrix(INTO)
        turned = facing * Rotation.from_rotvec(rng.normal(0, 0.3, 3))
        found.append(RigidTransform.from_components(facing.apply([0, 0, 0.9]), turned))
    return found


def lines(*, still: bool, shots: int, ring: bool = True) -> list[str]:
    rng = np.random.default_rng(1)
    rows = ["shot,board,lens,x_m,y_m,z_m,u_px,v_px"]
    boards, points = room(0), board()
    for shot in range(shots):
        camera = RigidTransform.from_components(
            rng.normal(0, 0.15, 3), Rotation.from_rotvec(rng.normal(0, [0.3, 0.3, 1.5]))
        )
        for number, world_from_board in enumerate(boards if still else boards[shot % 4 : shot % 4 + 1]):
            seen = camera.inv().apply(world_from_board.apply(points))
            for lens, fisheye in enumerate((TRUTH.front, TRUTH.back)):
                pixels, valid = fisheye.model.project(fisheye.camera_from_lens.inv().apply(seen))
                if valid.sum() < 12 or not (ring or valid.all()):
                    continue
                pixels = pixels + rng.normal(0, 0.05, pixels.shape)
                rows += [
                    f"s{shot},B{number},{lens},{x:.4f},{y:.4f},{z},{u:.4f},{v:.4f}"
                    for (x, y, z), (u, v), ok in zip(points, pixels, valid, strict=True)
                    if ok
                ]
    return rows


def folder(place: Path, rows: list[str], *, still: bool) -> Path:
    place.mkdir()
    (place / "corners.csv").write_text("\n".join(rows) + "\n")
    (place / "intrinsics.yaml").write_text(
        "format: 1\nwidth: 1600\nheight: 800\nlenses: 2\ncorners: corners.csv\n"
        f"boards_stand_still: {str(still).lower()}\n"
    )
    return place


@pytest.mark.parametrize(("still", "shots"), [(True, 10), pytest.param(False, 30, marks=pytest.mark.slow)])
def test_two_lenses_become_one_camera(tmp_path: Path, still: bool, shots: int) -> None:
    place = folder(tmp_path / "in", lines(still=still, shots=shots), still=still)
    assert run(["calibrate", "intrinsics", str(place), "--out", str(tmp_path / "camera.yaml")], COMMANDS) == 0
    camera = read_camera(tmp_path / "camera.yaml")
    assert isinstance(camera, DualFisheye)
    found = camera.front.camera_from_lens.inv() * camera.back.camera_from_lens
    truth = TRUTH.front.camera_from_lens.inv() * TRUTH.back.camera_from_lens
    off = found * truth.inv()
    assert np.degrees(off.rotation.magnitude()) < 0.05
    assert np.abs(found.translation - truth.translation).max() < 0.002
    # The frame: midway between the lenses, x along the front one, the image upright.
    middle = camera.front.camera_from_lens.translation + camera.back.camera_from_lens.translation
    np.testing.assert_allclose(middle, 0, atol=1e-9)
    assert camera.front.camera_from_lens.rotation.apply([1.0, 0, 0])[0] > 0.999
    assert camera.front.camera_from_lens.rotation.apply([0.0, 0, 1.0])[2] > 0.999
    data = json.loads((tmp_path / "camera.json").read_text())
    assert data["rms_px"] == pytest.approx(0.05 * np.sqrt(2), rel=0.05)
    assert len(data["lenses"]) == 2


@pytest.mark.slow
def test_raw_shots_of_boards_give_both_lenses(tmp_path: Path, render: Callable[..., Image]) -> None:
    small = [
        FisheyeLens(
            KannalaBrandt(1200, 600, 170.0, 170.5, cx, 299.0, *TERMS, float(np.radians(100.0))), lens.camera_from_lens
        )
        for lens, cx in ((TRUTH.front, 301.0), (TRUTH.back, 898.0))
    ]
    truth = DualFisheye(*small)
    boards = [CharucoBoard(4, 3, 0.2, 0.15, "DICT_4X4_50", 6 * k) for k in range(5)]
    middle = RigidTransform.from_translation([-0.4, -0.3, 0.0])
    rng, shots = np.random.default_rng(5), []
    for i in range(7):
        place = RigidTransform.from_components(
            rng.normal(0, 0.15, 3), Rotation.from_rotvec(rng.normal(0, [0.3, 0.3, 1.5]))
        )
        # The fifth board is never seen.
        hung = [(board, place.inv() * pose * middle) for board, pose in zip(boards, room(0), strict=False)]
        cv2.imwrite(str(tmp_path / f"{i}.png"), render(truth, hung))
        shots.append(f"{i}.png")
    spec = {"columns": 4, "rows": 3, "square_m": 0.2, "marker_m": 0.15, "dictionary": "DICT_4X4_50"}
    content = {
        "format": 1, "width": 1200, "height": 600, "lenses": 2, "shots": shots, "boards_stand_still": True,
        "boards": {f"B{k}": {"charuco": spec | {"first_id": 6 * k}} for k in (4, 0, 1, 2, 3)},
    }  # fmt: skip
    (tmp_path / "intrinsics.yaml").write_text(yaml.safe_dump(content))
    assert run(["calibrate", "intrinsics", str(tmp_path), "--out", str(tmp_path / "camera.yaml")], COMMANDS) == 0
    camera = read_camera(tmp_path / "camera.yaml")
    assert isinstance(camera, DualFisheye)
    found = camera.front.camera_from_lens.inv() * camera.back.camera_from_lens
    off = found * (TRUTH.front.camera_from_lens.inv() * TRUTH.back.camera_from_lens).inv()
    assert np.degrees(off.rotation.magnitude()) < 0.05
    assert np.abs(off.translation).max() < 0.002
    assert json.loads((tmp_path / "camera.json").read_text())["rms_px"] < 0.05


def test_a_board_that_is_never_seen_has_no_number() -> None:
    views = [BoardView(f"{i}", i, board, 0, *([np.zeros((1, 3))] * 3)) for i, board in enumerate((3, 1, 3))]
    assert [view.board for view in numbered_boards(views)] == [1, 0, 1]


def test_lenses_without_a_link_are_degenerate(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rows = lines(still=False, shots=30, ring=False)
    both = {row.split(",")[0] for row in rows[1:] if row.split(",")[2] == "0"} & {
        row.split(",")[0] for row in rows[1:] if row.split(",")[2] == "1"
    }
    alone = [rows[0], *(row for row in rows[1:] if row.split(",")[0] not in both)]
    place = folder(tmp_path / "in", alone, still=False)
    assert run(["calibrate", "intrinsics", str(place), "--out", str(tmp_path / "camera.yaml")], COMMANDS) == 3
    assert "degenerate: lenses_not_linked" in capsys.readouterr().err


def test_two_lenses_take_one_model_only(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    place = folder(tmp_path / "in", lines(still=False, shots=6), still=False)
    out = str(tmp_path / "camera.yaml")
    assert run(["calibrate", "intrinsics", str(place), "--out", out, "--model", "eucm"], COMMANDS) == 1
    assert "a camera with two lenses needs the model kannala_brandt" in capsys.readouterr().err
