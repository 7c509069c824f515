import json
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from scipy.spatial.transform import RigidTransform, Rotation

from calibration.targets.targets import CharucoBoard
from palletloc import read_camera
from palletloc.__main__ import COMMANDS
from palletloc.cameras import CameraModel, Equirectangular, StitchedEquirectangular, StitchedLens
from palletloc.cli.app import run
from palletloc.geometry import FloatArray, Image

SIZE = (3840, 1920)
FRONT = RigidTransform.from_components(
    [0.02, 0.0, 0.0005], Rotation.from_euler("zyx", [0.1, -0.2, 0.15], degrees=True)
)
BACK = RigidTransform.from_components(
    [-0.02, 0.001, 0.0], Rotation.from_euler("zyx", [179.8, 0.3, 0.2], degrees=True)
)
TRUTH = StitchedEquirectangular(*SIZE, StitchedLens(FRONT, 0.004, -0.001), StitchedLens(BACK, -0.003, 0.0008))
INTO = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])


def board() -> FloatArray:
    x, y = np.meshgrid(np.arange(7) - 3.0, np.arange(5) - 2.0)
    return np.asarray(np.stack([x, y, 0 * x], axis=-1).reshape(-1, 3) * 0.1)


def room(distance: float = 1.6, seed: int = 0) -> list[RigidTransform]:
    """Return boards on all sides, at several heights, facing the middle."""
    rng = np.random.default_rng(seed)
    found = []
    for azimuth in np.arange(6) * np.pi / 3:
        facing = Rotation.from_euler("zy", [azimuth, rng.normal(0, 0.3)]) * Rotation.from_matrix(INTO)
        turned = facing * Rotation.from_rotvec(rng.normal(0, 0.2, 3))
        found.append(RigidTransform.from_components(facing.apply([0, 0, distance]), turned))
    return found


def places(count: int, seed: int = 1) -> list[RigidTransform]:
    rng = np.random.default_rng(seed)
    return [
        RigidTransform.from_components(rng.normal(0, 0.2, 3), Rotation.from_rotvec(rng.normal(0, [0.05, 0.05, 1.5])))
        for _ in range(count)
    ]


def lines(camera: CameraModel, count: int = 8, *, boards: int = 6) -> list[str]:
    rng = np.random.default_rng(2)
    rows = ["shot,board,lens,x_m,y_m,z_m,u_px,v_px"]
    points = board()
    for shot, place in enumerate(places(count)):
        for number, pose in enumerate(room()[:boards]):
            pixels, valid = camera.project((place.inv() * pose).apply(points))
            pixels = np.clip(pixels + rng.normal(0, 0.05, pixels.shape), -0.5, SIZE[0] - 0.5)
            rows += [
                f"s{shot},B{number},0,{x:.4f},{y:.4f},{z},{u:.4f},{v:.4f}"
                for (x, y, z), (u, v), ok in zip(points, pixels, valid, strict=True)
                if ok
            ]
    return rows


def folder(place: Path, rows: list[str], *, still: bool = True) -> Path:
    place.mkdir()
    (place / "corners.csv").write_text("\n".join(rows) + "\n")
    content = {"format": 1, "width": 3840, "height": 1920, "corners": "corners.csv", "boards_stand_still": still}
    (place / "intrinsics.yaml").write_text(yaml.safe_dump(content))
    return place


def calibrate(place: Path, out: Path) -> int:
    command = ["calibrate", "intrinsics", str(place), "--model", "stitched_equirectangular", "--out", str(out)]
    return run(command, COMMANDS)


def worst_point_deg(camera: CameraModel) -> float:
    """Return how far bearings of points at 2 m are off, with the camera where it fits best."""
    rng = np.random.default_rng(3)
    rays = rng.normal(size=(3000, 3))
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    rays = rays[np.abs(rays[:, 0]) > 0.05]
    truth = TRUTH.unproject(TRUTH.project(2 * rays).pixels)
    found = camera.unproject(TRUTH.project(2 * rays).pixels)
    points = truth.origins + 2 * truth.directions
    # Six numbers move the camera; the rest is its error.
    off = np.zeros((len(points), 3))
    design = np.zeros((len(points), 3, 6))
    for i, (p, o, d) in enumerate(zip(points, found.origins, found.directions, strict=True)):
        seen = (p - o) / np.linalg.norm(p - o)
        across = np.eye(3) - np.outer(seen, seen)
        off[i] = d - seen
        design[i, :, :3] = across @ np.cross(np.eye(3), p)
        design[i, :, 3:] = across
    solved = np.linalg.lstsq(design.reshape(-1, 6), 2 * off.reshape(-1), rcond=None)[0]
    rest = off - (design @ solved) / 2
    return float(np.degrees(np.quantile(np.linalg.norm(rest, axis=-1), 0.99)))


def test_the_lenses_behind_a_panorama_are_found(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert calibrate(folder(tmp_path / "in", lines(TRUTH)), tmp_path / "camera.yaml") == 0
    data = json.loads((tmp_path / "camera.json").read_text())
    assert data["rms_px"]["before"] > 10 * data["rms_px"]["after"]
    assert data["rms_px"]["after"] == pytest.approx(0.05 * np.sqrt(2), rel=0.1)
    expected = FRONT.inv() * BACK
    nominal = RigidTransform.from_rotation(Rotation.from_euler("z", 180, degrees=True))
    off = expected * nominal.inv()
    truth = np.concatenate([off.rotation.as_rotvec(), off.translation])
    value, sigma = (np.array(data["back_lens_off"][key]) for key in ("value", "sigma"))
    assert (np.abs(value - truth) < 4 * sigma).all()
    assert sigma[3:].max() < 0.001
    bends = np.array(data["bends"]["value"]) - [[0.004, -0.001], [-0.003, 0.0008]]
    assert (np.abs(bends) < 4 * np.array(data["bends"]["sigma"])).all()
    camera = read_camera(tmp_path / "camera.yaml")
    assert isinstance(camera, StitchedEquirectangular)
    assert worst_point_deg(camera) < 0.01
    assert worst_point_deg(Equirectangular(*SIZE)) > 0.1
    assert "px rms before" in capsys.readouterr().out
    page = (tmp_path / "camera.html").read_text()
    assert page.count('src="data:image/png;base64,') == page.count("<img ") == 2


def test_a_panorama_that_is_right_is_left_alone(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert calibrate(folder(tmp_path / "in", lines(Equirectangular(*SIZE))), tmp_path / "camera.yaml") == 0
    assert "note: no_gain" in capsys.readouterr().err
    data = json.loads((tmp_path / "camera.json").read_text())
    value, sigma = (np.array(data["back_lens_off"][key]) for key in ("value", "sigma"))
    assert (np.abs(value) < 4 * sigma).all()


def test_one_board_beside_the_seam_tells_nothing_of_the_other_lens(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rows = [row for row in lines(TRUTH, 10, boards=1)[1:] if 1100 < float(row.split(",")[6]) < 2740]
    place = folder(tmp_path / "in", ["shot,board,lens,x_m,y_m,z_m,u_px,v_px", *rows], still=False)
    assert calibrate(place, tmp_path / "camera.yaml") == 3
    assert "degenerate: unobservable" in capsys.readouterr().err
    assert not (tmp_path / "camera.yaml").exists()


@pytest.mark.slow
def test_stitched_shots_of_boards_give_the_lenses(tmp_path: Path, render: Callable[..., Image]) -> None:
    truth = StitchedEquirectangular(1280, 640, TRUTH.front, TRUTH.back)
    boards = [CharucoBoard(4, 3, 0.2, 0.15, "DICT_4X4_50", 6 * k) for k in range(6)]
    middle = RigidTransform.from_translation([-0.4, -0.3, 0.0])
    shots = []
    for i, place in enumerate(places(5, 4)):
        hung = [(board, place.inv() * pose * middle) for board, pose in zip(boards, room(1.3), strict=True)]
        cv2.imwrite(str(tmp_path / f"{i}.png"), render(truth, hung))
        shots.append(f"{i}.png")
    spec = {"columns": 4, "rows": 3, "square_m": 0.2, "marker_m": 0.15, "dictionary": "DICT_4X4_50"}
    content = {
        "format": 1, "width": 1280, "height": 640, "shots": shots, "boards_stand_still": True,
        "boards": {f"B{k}": {"charuco": spec | {"first_id": 6 * k}} for k in range(6)},
    }  # fmt: skip
    (tmp_path / "intrinsics.yaml").write_text(yaml.safe_dump(content))
    assert calibrate(tmp_path, tmp_path / "out" / "camera.yaml") == 0
    data = json.loads((tmp_path / "out" / "camera.json").read_text())
    assert data["rms_px"]["before"] > 3 * data["rms_px"]["after"]
    assert data["rms_px"]["after"] < 0.1
    off = (FRONT.inv() * BACK) * RigidTransform.from_rotation(Rotation.from_euler("z", 180, degrees=True)).inv()
    assert np.abs(np.array(data["back_lens_off"]["value"])[3:] - off.translation).max() < 0.003


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [("lenses", 2, "lenses: expected no such key"), ("corners", "none.csv", "none.csv: no such file")],
)
def test_bad_input_is_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], key: str, value: object, message: str
) -> None:
    place = folder(tmp_path / "in", lines(TRUTH, 3))
    content = yaml.safe_load((place / "intrinsics.yaml").read_text()) | {key: value}
    (place / "intrinsics.yaml").write_text(yaml.safe_dump(content))
    assert calibrate(place, tmp_path / "camera.yaml") == 1
    told = capsys.readouterr().err
    assert message in told
    assert told.count("\n") == 1
