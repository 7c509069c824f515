import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml
from scipy.spatial.transform import RigidTransform, Rotation

from calibration.intrinsics.task import Chessboard
from calibration.targets.targets import CharucoBoard
from palletloc import read_camera
from palletloc.__main__ import COMMANDS
from palletloc.cameras import CameraModel, Eucm
from palletloc.cli.app import run
from palletloc.geometry import FloatArray, Image

CAMERA = Eucm(480, 400, 140.0, 140.5, 243.0, 198.0, 0.58, 1.1, 1.6)
CHARUCO = CharucoBoard(6, 5, 0.06, 0.045, "DICT_4X4_50")
PLAIN = Chessboard(6, 5, 0.05)
OMNI = Path(__file__).resolve().parents[3].parent / "shared/data/real_lenses/omni_corners.xml"
INTO = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])


def poses(width: float, height: float, count: int, seed: int) -> list[RigidTransform]:
    rng = np.random.default_rng(seed)
    found = []
    for i in range(count):
        azimuth, elevation = 0.75 * np.array([np.cos(2.4 * i), np.sin(2.4 * i)]) * np.sqrt((i + 0.5) / count)
        facing = Rotation.from_euler("zy", [azimuth, -elevation]) * Rotation.from_matrix(INTO)
        turned = facing * Rotation.from_rotvec(rng.normal(0, 0.35, 3))
        middle = facing.apply([0, 0, rng.uniform(0.38, 0.5)])
        found.append(RigidTransform.from_components(middle - turned.apply([width / 2, height / 2, 0.0]), turned))
    return found


def write(folder: Path, content: dict[str, Any]) -> Path:
    folder.mkdir(exist_ok=True)
    (folder / "intrinsics.yaml").write_text(yaml.safe_dump(content))
    return folder


@pytest.fixture(scope="module")
def charuco(tmp_path_factory: pytest.TempPathFactory, render: Callable[..., Image]) -> Path:
    folder = tmp_path_factory.mktemp("charuco")
    shots = []
    for i, pose in enumerate(poses(0.36, 0.30, 8, 0)):
        cv2.imwrite(str(folder / f"{i}.png"), render(CAMERA, [(CHARUCO, pose)]))
        shots.append(f"{i}.png")
    board = {"columns": 6, "rows": 5, "square_m": 0.06, "marker_m": 0.045, "dictionary": "DICT_4X4_50"}
    content = {"format": 1, "width": 480, "height": 400, "shots": shots, "boards": {"A": {"charuco": board}}}
    return write(folder, content)


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory, render: Callable[..., Image]) -> Path:
    folder = tmp_path_factory.mktemp("plain")
    shots = []
    for i, pose in enumerate(poses(0.35, 0.30, 8, 1)):
        cv2.imwrite(str(folder / f"{i}.png"), render(CAMERA, [(PLAIN, pose)]))
        shots.append(f"{i}.png")
    (folder / "again.png").write_bytes((folder / "2.png").read_bytes())
    cv2.imwrite(str(folder / "empty.png"), np.full((400, 480), 128, np.uint8))
    board = {"inner_columns": 6, "inner_rows": 5, "square_m": 0.05}
    shots = [*shots, "again.png", "empty.png"]
    content = {"format": 1, "width": 480, "height": 400, "shots": shots, "boards": {"A": {"chessboard": board}}}
    return write(folder, content)


def calibrate(folder: Path, out: Path, model: str = "eucm") -> int:
    return run(["calibrate", "intrinsics", str(folder), "--model", model, "--out", str(out)], COMMANDS)


def worst_bearing_deg(camera: CameraModel, max_angle_deg: float) -> float:
    """Return how far bearings are from the truth, a common rotation left out."""
    rng = np.random.default_rng(0)
    rays = rng.normal(size=(4000, 3))
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    pixels, valid = CAMERA.project(rays[rays[:, 0] > np.cos(np.radians(max_angle_deg))])
    truth: FloatArray = CAMERA.unproject(pixels[valid]).directions
    found = camera.unproject(pixels[valid])
    assert found.valid.mean() > 0.95
    truth, directions = truth[found.valid], found.directions[found.valid]
    turn, _ = Rotation.align_vectors(truth, directions)
    return float(np.degrees(np.linalg.norm(turn.apply(directions) - truth, axis=-1).max()))


def test_charuco_boards_give_the_lens(charuco: Path, tmp_path: Path) -> None:
    assert calibrate(charuco, tmp_path / "camera.yaml") == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == ["camera.html", "camera.json", "camera.yaml"]
    data = json.loads((tmp_path / "camera.json").read_text())
    assert data["rms_px"] < 0.06
    assert worst_bearing_deg(read_camera(tmp_path / "camera.yaml"), 55) < 0.05
    page = (tmp_path / "camera.html").read_text()
    assert page.count('src="data:image/png;base64,') == page.count("<img ") == 5
    assert "http" not in page


def test_chessboards_give_the_lens_and_twins_are_named(
    plain: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert calibrate(plain, tmp_path / "camera.yaml", "kannala_brandt") == 0
    assert worst_bearing_deg(read_camera(tmp_path / "camera.yaml"), 50) < 0.15
    told = capsys.readouterr().err
    assert "duplicate_view: again.png is the same as 2.png" in told
    assert "no_board: empty.png shows no whole board" in told
    seen = len(json.loads((tmp_path / "camera.json").read_text())["views"])
    assert seen >= 6
    assert seen + told.count("no_board") == 9


def corner_lines(count: int = 12, *, seed: int = 0, noise: float = 0.05) -> list[str]:
    rng = np.random.default_rng(seed)
    lines = ["shot,board,lens,x_m,y_m,z_m,u_px,v_px"]
    points = PLAIN.corners + np.array([0.05, 0.05, 0.0])
    for i, pose in enumerate(poses(0.35, 0.30, count, seed)):
        pixels, valid = CAMERA.project(pose.apply(points))
        pixels += rng.normal(0, noise, pixels.shape)
        for (x, y, z), (u, v) in zip(points[valid], pixels[valid], strict=True):
            lines.append(f"s{i},A,0,{x:.4f},{y:.4f},{z:.4f},{u:.4f},{v:.4f}")
    return lines


def corner_folder(folder: Path, lines: list[str]) -> Path:
    write(folder, {"format": 1, "width": 480, "height": 400, "corners": "corners.csv"})
    (folder / "corners.csv").write_text("\n".join(lines) + "\n")
    return folder


def test_a_table_of_corners_gives_the_lens(tmp_path: Path) -> None:
    assert calibrate(corner_folder(tmp_path / "in", corner_lines()), tmp_path / "camera.yaml") == 0
    assert worst_bearing_deg(read_camera(tmp_path / "camera.yaml"), 45) < 0.1


def test_a_bad_view_and_a_view_that_is_there_twice_are_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lines = corner_lines()
    rng = np.random.default_rng(0)
    for i, line in enumerate(lines):
        if line.startswith("s3,"):
            cells = line.split(",")
            u, v = (float(cell) + rng.normal(0, 3.0) for cell in cells[6:])
            lines[i] = ",".join([*cells[:6], f"{u:.4f}", f"{v:.4f}"])
    lines += [line.replace("s5,", "twin,") for line in lines if line.startswith("s5,")]
    assert calibrate(corner_folder(tmp_path / "in", lines), tmp_path / "camera.yaml") == 0
    told = capsys.readouterr().err
    assert "bad_view: view s3:" in told
    assert "duplicate_view: twin is the same as s5" in told
    assert told.count("bad_view") == 1


def test_boards_all_alike_are_degenerate_and_overwrite_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rng = np.random.default_rng(0)
    lines = ["shot,board,lens,x_m,y_m,z_m,u_px,v_px"]
    points = PLAIN.corners
    for i in range(6):
        pose = RigidTransform.from_components([0.8, 0.1 + 0.02 * i, 0.1], Rotation.from_matrix(INTO))
        pixels = CAMERA.project(pose.apply(points)).pixels + rng.normal(0, 0.1, (len(points), 2))
        lines += [f"s{i},A,0,{x},{y},{z},{u},{v}" for (x, y, z), (u, v) in zip(points, pixels, strict=True)]
    for name in ("camera.yaml", "camera.html", "camera.json"):
        (tmp_path / name).write_text("kept")
    code = calibrate(corner_folder(tmp_path / "in", lines), tmp_path / "camera.yaml")
    assert code == 3
    assert "degenerate: unobservable" in capsys.readouterr().err
    assert {(tmp_path / name).read_text() for name in ("camera.yaml", "camera.html", "camera.json")} == {"kept"}
    assert json.loads((tmp_path / "camera.failed.json").read_text())["exit_code"] == 3


def test_few_views_are_degenerate(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert calibrate(corner_folder(tmp_path / "in", corner_lines(2)), tmp_path / "camera.yaml") == 3
    assert "degenerate: few_views: lens 0: 2 boards are seen" in capsys.readouterr().err


def test_a_model_that_does_not_fit_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    if not OMNI.is_file():
        pytest.skip("the corners are not there")
    folder = write(tmp_path / "in", {"format": 1, "width": 1280, "height": 960, "corners": "omni.xml"})
    (folder / "omni.xml").write_bytes(OMNI.read_bytes())
    calibrate(folder, tmp_path / "kb.yaml", "kannala_brandt")
    assert "model_misfit" in capsys.readouterr().err
    assert calibrate(folder, tmp_path / "mei.yaml", "mei") == 0
    assert "model_misfit" not in capsys.readouterr().err
    told = json.loads((tmp_path / "mei.json").read_text())
    assert told["plain_rms_px"] == pytest.approx(0.8143, rel=0.02)
    assert told["parameters_alone"] is False
    assert "alone" in (tmp_path / "mei.html").read_text()
    told = json.loads(next(tmp_path.glob("kb*.json")).read_text())
    assert told["plain_rms_px"] == pytest.approx(1.94, rel=0.02)
    assert told["parameters_alone"] is True


def change(key: str, value: object) -> Callable[[dict[str, Any]], None]:
    def changed(content: dict[str, Any]) -> None:
        *path, last = key.split(".")
        place = content
        for step in path:
            place = place[step]
        if value is None:
            del place[last]
        else:
            place[last] = value

    return changed


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        (change("width", 500), "0.png: is 480 x 400 px, the camera is 500 x 400 px"),
        (change("shots", ["none.png"]), "none.png: no such file"),
        (change("boards", None), "boards: is missing"),
        (change("shots", None), "expected either the keys shots and boards, or the key corners"),
        (change("corners", "x.csv"), "expected either the keys shots and boards, or the key corners"),
        (change("boards.A.charuco.dictionary", "DICT_4X4_51"), "boards.A: unknown dictionary"),
        (change("boards.A.chessboard", {"inner_columns": 5, "inner_rows": 4, "square_m": 0.1}), "one of the keys"),
        (change("boards.B", {"charuco": {"columns": 6, "rows": 5, "square_m": 0.06, "marker_m": 0.045,
                                         "dictionary": "DICT_4X4_50"}}), "has the marker 0 of DICT_4X4_50"),
        (change("start", {"model": "equirectangular", "width": 400, "height": 200}), "start: is 400 x 200 px"),
        (change("lenses", 3), "lenses: "),
        (change("lens", 2), "unknown key 'lens'; did you mean 'lenses'"),
    ],
)  # fmt: skip
def test_bad_input_is_one_line(
    charuco: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str],
    changed: Callable[[dict[str, Any]], None], message: str,
) -> None:  # fmt: skip
    content = yaml.safe_load((charuco / "intrinsics.yaml").read_text())
    changed(content)
    folder = write(tmp_path / "bad", content)
    (folder / "0.png").write_bytes((charuco / "0.png").read_bytes())
    assert calibrate(folder, tmp_path / "camera.yaml") == 1
    told = capsys.readouterr().err
    assert message in told
    assert told.count("\n") == 1
    assert [path.name for path in tmp_path.iterdir()] == ["bad"]


@pytest.mark.parametrize(
    ("line", "message"),
    [(0, "line 1: expected the columns shot,board,lens"), (5, "line 6: expected two names, a lens and five numbers")],
)
def test_a_bad_line_of_corners_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], line: int, message: str
) -> None:
    lines = corner_lines(3)
    lines[line] = "s0,A,0,x"
    assert calibrate(corner_folder(tmp_path / "in", lines), tmp_path / "camera.yaml") == 1
    assert message in capsys.readouterr().err


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("s0,A,0", "s0,A,1", "line 2: lens 1 does not exist; expected 0 to 0"),
        ("s0,A,0,0.0500", "s0,A,0,nan", "finite numbers"),
    ],
)
def test_a_bad_cell_of_corners_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], old: str, new: str, message: str
) -> None:
    text = "\n".join(corner_lines(3)).replace(old, new, 1)
    assert calibrate(corner_folder(tmp_path / "in", text.splitlines()), tmp_path / "camera.yaml") == 1
    assert message in capsys.readouterr().err


def test_wrong_requests_are_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = corner_folder(tmp_path / "in", corner_lines(3))
    assert calibrate(folder, tmp_path / "camera.yaml", "fisheye") == 1
    assert "--model fisheye: unknown lens model; known are" in capsys.readouterr().err
    assert calibrate(folder, tmp_path / "camera.txt") == 1
    assert "expected the name of a .yaml file" in capsys.readouterr().err
    assert run(["calibrate", "intrinsics"], COMMANDS) == 2
