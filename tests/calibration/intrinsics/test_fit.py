import json
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from scipy.spatial.transform import RigidTransform, Rotation

from calibration.intrinsics.task import Chessboard
from calibration.targets.targets import CharucoBoard
from palletloc import read_camera
from palletloc.cameras import CameraModel, Eucm
from palletloc.geometry import FloatArray, Image
from tests.calibration.board_room import HEADER, corner_rows, towards, write_corners, write_intrinsics, write_shots
from tests.calibration.expecting import Calibrate
from tests.calibration.yard_folder import Change, set_key

CAMERA = Eucm(480, 400, 140.0, 140.5, 243.0, 198.0, 0.58, 1.1, 1.6)
CHARUCO = CharucoBoard(6, 5, 0.06, 0.045, "DICT_4X4_50")
CHARUCO_KEY = {"charuco": {"columns": 6, "rows": 5, "square_m": 0.06, "marker_m": 0.045, "dictionary": "DICT_4X4_50"}}
PLAIN = Chessboard(6, 5, 0.05)
SIZE = (480, 400)
EUCM = ("--model", "eucm", "--out")
OMNI = Path(__file__).resolve().parents[3].parent / "shared/data/real_lenses/omni_corners.xml"


def poses(width: float, height: float, count: int, seed: int) -> list[RigidTransform]:
    rng, found = np.random.default_rng(seed), []
    for i in range(count):
        azimuth, elevation = 0.75 * np.array([np.cos(2.4 * i), np.sin(2.4 * i)]) * np.sqrt((i + 0.5) / count)
        facing = towards(azimuth, elevation)
        turned = facing * Rotation.from_rotvec(rng.normal(0, 0.35, 3))
        middle = facing.apply([0, 0, rng.uniform(0.38, 0.5)])
        found.append(RigidTransform.from_components(middle - turned.apply([width / 2, height / 2, 0.0]), turned))
    return found


@pytest.fixture(scope="module")
def charuco(tmp_path_factory: pytest.TempPathFactory, render: Callable[..., Image]) -> Path:
    folder = tmp_path_factory.mktemp("charuco")
    shots = write_shots(folder, (render(CAMERA, [(CHARUCO, pose)]) for pose in poses(0.36, 0.30, 8, 0)))
    return write_intrinsics(folder, SIZE, shots=shots, boards={"A": CHARUCO_KEY})


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory, render: Callable[..., Image]) -> Path:
    folder = tmp_path_factory.mktemp("plain")
    shots = write_shots(folder, (render(CAMERA, [(PLAIN, pose)]) for pose in poses(0.35, 0.30, 8, 1)))
    (folder / "again.png").write_bytes((folder / "2.png").read_bytes())
    cv2.imwrite(str(folder / "empty.png"), np.full((400, 480), 128, np.uint8))
    board = {"chessboard": {"inner_columns": 6, "inner_rows": 5, "square_m": 0.05}}
    return write_intrinsics(folder, SIZE, shots=[*shots, "again.png", "empty.png"], boards={"A": board})


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


def test_charuco_boards_give_the_lens(charuco: Path, tmp_path: Path, calibrate: Calibrate) -> None:
    assert calibrate("intrinsics", charuco, *EUCM, tmp_path / "camera.yaml").code == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == ["camera.html", "camera.json", "camera.yaml"]
    data = json.loads((tmp_path / "camera.json").read_text())
    assert data["rms_px"] < 0.06
    assert worst_bearing_deg(read_camera(tmp_path / "camera.yaml"), 55) < 0.05
    page = (tmp_path / "camera.html").read_text()
    assert page.count('src="data:image/png;base64,') == page.count("<img ") == 5
    assert "http" not in page


def test_chessboards_give_the_lens_and_twins_are_named(plain: Path, tmp_path: Path, calibrate: Calibrate) -> None:
    ended = calibrate("intrinsics", plain, "--model", "kannala_brandt", "--out", tmp_path / "camera.yaml")
    assert ended.code == 0
    assert worst_bearing_deg(read_camera(tmp_path / "camera.yaml"), 50) < 0.15
    assert "duplicate_view: again.png is the same as 2.png" in ended.err
    assert "no_board: empty.png shows no whole board" in ended.err
    seen = len(json.loads((tmp_path / "camera.json").read_text())["views"])
    assert seen >= 6
    assert seen + ended.err.count("no_board") == 9


def corner_lines(count: int = 12, *, seed: int = 0, noise: float = 0.05) -> list[str]:
    rng, lines, points = np.random.default_rng(seed), [HEADER], PLAIN.corners + np.array([0.05, 0.05, 0.0])
    for i, pose in enumerate(poses(0.35, 0.30, count, seed)):
        pixels, valid = CAMERA.project(pose.apply(points))
        pixels += rng.normal(0, noise, pixels.shape)
        lines += corner_rows(f"s{i},A,0", points, pixels, valid)
    return lines


def test_a_table_of_corners_gives_the_lens(tmp_path: Path, calibrate: Calibrate) -> None:
    folder = write_corners(tmp_path / "in", SIZE, corner_lines())
    assert calibrate("intrinsics", folder, *EUCM, tmp_path / "camera.yaml").code == 0
    assert worst_bearing_deg(read_camera(tmp_path / "camera.yaml"), 45) < 0.1


def test_a_bad_view_and_a_view_that_is_there_twice_are_named(tmp_path: Path, calibrate: Calibrate) -> None:
    lines = corner_lines()
    rng = np.random.default_rng(0)
    for i, line in enumerate(lines):
        if line.startswith("s3,"):
            cells = line.split(",")
            u, v = (float(cell) + rng.normal(0, 3.0) for cell in cells[6:])
            lines[i] = ",".join([*cells[:6], f"{u:.4f}", f"{v:.4f}"])
    lines += [line.replace("s5,", "twin,") for line in lines if line.startswith("s5,")]
    ended = calibrate("intrinsics", write_corners(tmp_path / "in", SIZE, lines), *EUCM, tmp_path / "camera.yaml")
    assert ended.code == 0
    assert "bad_view: view s3:" in ended.err
    assert "duplicate_view: twin is the same as s5" in ended.err
    assert ended.err.count("bad_view") == 1


def test_boards_all_alike_are_degenerate_and_overwrite_nothing(tmp_path: Path, calibrate: Calibrate) -> None:
    rng, lines, points = np.random.default_rng(0), [HEADER], PLAIN.corners
    for i in range(6):
        pose = RigidTransform.from_components([0.8, 0.1 + 0.02 * i, 0.1], towards(0.0, 0.0))
        pixels, valid = CAMERA.project(pose.apply(points))
        lines += corner_rows(f"s{i},A,0", points, pixels + rng.normal(0, 0.1, pixels.shape), valid)
    for name in ("camera.yaml", "camera.html", "camera.json"):
        (tmp_path / name).write_text("kept")
    ended = calibrate("intrinsics", write_corners(tmp_path / "in", SIZE, lines), *EUCM, tmp_path / "camera.yaml")
    assert ended.code == 3
    assert "degenerate: unobservable" in ended.err
    assert {(tmp_path / name).read_text() for name in ("camera.yaml", "camera.html", "camera.json")} == {"kept"}
    assert json.loads((tmp_path / "camera.failed.json").read_text())["exit_code"] == 3


def test_few_views_are_degenerate(tmp_path: Path, calibrate: Calibrate) -> None:
    folder = write_corners(tmp_path / "in", SIZE, corner_lines(2))
    ended = calibrate("intrinsics", folder, *EUCM, tmp_path / "camera.yaml")
    assert ended.code == 3
    assert "degenerate: few_views: lens 0: 2 boards are seen" in ended.err


@pytest.mark.skipif(not OMNI.is_file(), reason="the corners are not there")
def test_a_model_that_does_not_fit_is_told(tmp_path: Path, calibrate: Calibrate) -> None:
    folder = write_intrinsics(tmp_path / "in", (1280, 960), corners="omni.xml")
    (folder / "omni.xml").write_bytes(OMNI.read_bytes())
    ended = calibrate("intrinsics", folder, "--model", "kannala_brandt", "--out", tmp_path / "kb.yaml")
    assert "model_misfit" in ended.err
    ended = calibrate("intrinsics", folder, "--model", "mei", "--out", tmp_path / "mei.yaml")
    assert ended.code == 0
    assert "model_misfit" not in ended.err
    told = json.loads((tmp_path / "mei.json").read_text())
    assert told["plain_rms_px"] == pytest.approx(0.8143, rel=0.02)
    assert told["parameters_alone"] is False
    assert "alone" in (tmp_path / "mei.html").read_text()
    told = json.loads(next(tmp_path.glob("kb*.json")).read_text())
    assert told["plain_rms_px"] == pytest.approx(1.94, rel=0.02)
    assert told["parameters_alone"] is True


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        (set_key("width", value=500), "0.png: is 480 x 400 px, the camera is 500 x 400 px"),
        (set_key("shots", value=["none.png"]), "none.png: no such file"),
        (lambda content: content.pop("boards"), "boards: is missing"),
        (lambda content: content.pop("shots"), "expected either the keys shots and boards, or the key corners"),
        (set_key("corners", value="x.csv"), "expected either the keys shots and boards, or the key corners"),
        (set_key("boards", "A", "charuco", "dictionary", value="DICT_4X4_51"), "boards.A: unknown dictionary"),
        (set_key("boards", "A", "chessboard", value={"inner_columns": 5, "inner_rows": 4, "square_m": 0.1}),
         "one of the keys"),
        (set_key("boards", "B", value=CHARUCO_KEY), "has the marker 0 of DICT_4X4_50"),
        (set_key("start", value={"model": "equirectangular", "width": 400, "height": 200}), "start: is 400 x 200 px"),
        (set_key("lenses", value=3), "lenses: "),
        (set_key("lens", value=2), "unknown key 'lens'; did you mean 'lenses'"),
    ],
)  # fmt: skip
def test_bad_input_is_one_line(
    charuco: Path, tmp_path: Path, calibrate: Calibrate, changed: Change, message: str
) -> None:
    content = yaml.safe_load((charuco / "intrinsics.yaml").read_text())
    changed(content)
    folder = tmp_path / "bad"
    folder.mkdir()
    (folder / "intrinsics.yaml").write_text(yaml.safe_dump(content))
    (folder / "0.png").write_bytes((charuco / "0.png").read_bytes())
    calibrate("intrinsics", folder, *EUCM, tmp_path / "camera.yaml").refuses(message)
    assert [path.name for path in tmp_path.iterdir()] == ["bad"]


@pytest.mark.parametrize(
    ("line", "message"),
    [(0, "line 1: expected the columns shot,board,lens"), (5, "line 6: expected two names, a lens and five numbers")],
)
def test_a_bad_line_of_corners_is_named(tmp_path: Path, calibrate: Calibrate, line: int, message: str) -> None:
    lines = corner_lines(3)
    lines[line] = "s0,A,0,x"
    folder = write_corners(tmp_path / "in", SIZE, lines)
    calibrate("intrinsics", folder, *EUCM, tmp_path / "camera.yaml").refuses(message)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("s0,A,0", "s0,A,1", "line 2: lens 1 does not exist; expected 0 to 0"),
        ("s0,A,0,0.0500", "s0,A,0,nan", "finite numbers"),
    ],
)
def test_a_bad_cell_of_corners_is_named(
    tmp_path: Path, calibrate: Calibrate, old: str, new: str, message: str
) -> None:
    folder = write_corners(tmp_path / "in", SIZE, ["\n".join(corner_lines(3)).replace(old, new, 1)])
    calibrate("intrinsics", folder, *EUCM, tmp_path / "camera.yaml").refuses(message)


def test_wrong_requests_are_one_line(tmp_path: Path, calibrate: Calibrate) -> None:
    folder = write_corners(tmp_path / "in", SIZE, corner_lines(3))
    ended = calibrate("intrinsics", folder, "--model", "fisheye", "--out", tmp_path / "camera.yaml")
    ended.refuses("--model fisheye: unknown lens model; known are")
    calibrate("intrinsics", folder, *EUCM, tmp_path / "camera.txt").refuses("expected the name of a .yaml file")
