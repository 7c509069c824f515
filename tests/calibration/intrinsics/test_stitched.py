import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from palletloc import read_camera
from palletloc.cameras import CameraModel, Equirectangular, StitchedEquirectangular, StitchedLens
from palletloc.geometry import Image
from tests.calibration.board_room import HEADER, corner_rows, grid, room, write_corners, write_intrinsics, write_shots
from tests.calibration.expecting import Calibrate
from tests.calibration.yard_folder import board, board_key

SIZE = (3840, 1920)
FRONT = RigidTransform.from_components(
    [0.02, 0.0, 0.0005], Rotation.from_euler("zyx", [0.1, -0.2, 0.15], degrees=True)
)
BACK = RigidTransform.from_components(
    [-0.02, 0.001, 0.0], Rotation.from_euler("zyx", [179.8, 0.3, 0.2], degrees=True)
)
TRUTH = StitchedEquirectangular(*SIZE, StitchedLens(FRONT, 0.004, -0.001), StitchedLens(BACK, -0.003, 0.0008))


SIDES = np.arange(6) * np.pi / 3
ROOM = room(SIDES, 1.6, 0.3, 0.2)


def places(count: int, seed: int = 1) -> list[RigidTransform]:
    rng = np.random.default_rng(seed)
    return [
        RigidTransform.from_components(rng.normal(0, 0.2, 3), Rotation.from_rotvec(rng.normal(0, [0.05, 0.05, 1.5])))
        for _ in range(count)
    ]


def lines(camera: CameraModel, count: int = 8, *, boards: int = 6) -> list[str]:
    rng, rows, points = np.random.default_rng(2), [HEADER], grid(7, 5, 0.1)
    for shot, place in enumerate(places(count)):
        for number, pose in enumerate(ROOM[:boards]):
            pixels, valid = camera.project((place.inv() * pose).apply(points))
            pixels = np.clip(pixels + rng.normal(0, 0.05, pixels.shape), -0.5, SIZE[0] - 0.5)
            rows += corner_rows(f"s{shot},B{number},0", points, pixels, valid)
    return rows


MODEL = ("--model", "stitched_equirectangular", "--out")


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
    seen = points - found.origins
    seen /= np.linalg.norm(seen, axis=-1, keepdims=True)
    across = np.eye(3) - seen[:, :, None] * seen[:, None]
    off = found.directions - seen
    design = np.concatenate([across @ np.cross(np.eye(3), points[:, None]), across], axis=2)
    solved = np.linalg.lstsq(design.reshape(-1, 6), 2 * off.reshape(-1), rcond=None)[0]
    rest = off - (design @ solved) / 2
    return float(np.degrees(np.quantile(np.linalg.norm(rest, axis=-1), 0.99)))


def test_the_lenses_behind_a_panorama_are_found(tmp_path: Path, calibrate: Calibrate) -> None:
    place = write_corners(tmp_path / "in", SIZE, lines(TRUTH), boards_stand_still=True)
    ended = calibrate("intrinsics", place, *MODEL, tmp_path / "camera.yaml")
    assert ended.code == 0
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
    assert "px rms before" in ended.out
    page = (tmp_path / "camera.html").read_text()
    assert page.count('src="data:image/png;base64,') == page.count("<img ") == 2


def test_a_panorama_that_is_right_is_left_alone(tmp_path: Path, calibrate: Calibrate) -> None:
    place = write_corners(tmp_path / "in", SIZE, lines(Equirectangular(*SIZE)), boards_stand_still=True)
    ended = calibrate("intrinsics", place, *MODEL, tmp_path / "camera.yaml")
    assert ended.code == 0
    assert "note: no_gain" in ended.err
    data = json.loads((tmp_path / "camera.json").read_text())
    value, sigma = (np.array(data["back_lens_off"][key]) for key in ("value", "sigma"))
    assert (np.abs(value) < 4 * sigma).all()


def test_one_board_beside_the_seam_tells_nothing_of_the_other_lens(tmp_path: Path, calibrate: Calibrate) -> None:
    rows = [row for row in lines(TRUTH, 10, boards=1)[1:] if 1100 < float(row.split(",")[6]) < 2740]
    place = write_corners(tmp_path / "in", SIZE, [HEADER, *rows], boards_stand_still=False)
    ended = calibrate("intrinsics", place, *MODEL, tmp_path / "camera.yaml")
    assert ended.code == 3
    assert "degenerate: unobservable" in ended.err
    assert not (tmp_path / "camera.yaml").exists()


@pytest.mark.slow
def test_stitched_shots_of_boards_give_the_lenses(
    tmp_path: Path, calibrate: Calibrate, render: Callable[..., Image]
) -> None:
    truth = StitchedEquirectangular(1280, 640, TRUTH.front, TRUTH.back)
    poses = [pose * RigidTransform.from_translation([-0.4, -0.3, 0.0]) for pose in room(SIDES, 1.3, 0.3, 0.2)]
    shots = [
        render(truth, [(board(k), place.inv() * pose) for k, pose in enumerate(poses)]) for place in places(5, 4)
    ]
    boards = {f"B{k}": board_key(k) for k in range(6)}
    write_intrinsics(
        tmp_path, (1280, 640), shots=write_shots(tmp_path, shots), boards_stand_still=True, boards=boards
    )
    assert calibrate("intrinsics", tmp_path, *MODEL, tmp_path / "out" / "camera.yaml").code == 0
    data = json.loads((tmp_path / "out" / "camera.json").read_text())
    assert data["rms_px"]["before"] > 3 * data["rms_px"]["after"]
    assert data["rms_px"]["after"] < 0.1
    off = (FRONT.inv() * BACK) * RigidTransform.from_rotation(Rotation.from_euler("z", 180, degrees=True)).inv()
    assert np.abs(np.array(data["back_lens_off"]["value"])[3:] - off.translation).max() < 0.003


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [("lenses", 2, "lenses: expected no such key"), ("corners", "none.csv", "none.csv: no such file")],
)
def test_bad_input_is_one_line(tmp_path: Path, calibrate: Calibrate, key: str, value: object, message: str) -> None:
    place = write_corners(tmp_path / "in", SIZE, lines(TRUTH, 3))
    write_intrinsics(place, SIZE, **{"corners": "corners.csv", "boards_stand_still": True, key: value})
    calibrate("intrinsics", place, *MODEL, tmp_path / "camera.yaml").refuses(message)
