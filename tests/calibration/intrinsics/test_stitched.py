"""Cameras of two lenses: stitched to a panorama, and side by side."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from calibration.intrinsics.board_views import numbered_boards
from calibration.lenses.problem import BoardView
from palletloc import read_camera
from palletloc.cameras import (
    CameraModel,
    DualFisheye,
    Equirectangular,
    FisheyeLens,
    KannalaBrandt,
    StitchedEquirectangular,
    StitchedLens,
)
from palletloc.geometry import Image
from tests.calibration.board_room import HEADER, corner_rows, grid, room, write_corners, write_intrinsics, write_shots
from tests.calibration.expecting import Calibrate
from tests.calibration.yard_folder import board, board_key

PANORAMA_SIZE = (3840, 1920)
FRONT = RigidTransform.from_components(
    [0.02, 0.0, 0.0005], Rotation.from_euler("zyx", [0.1, -0.2, 0.15], degrees=True)
)
BACK = RigidTransform.from_components(
    [-0.02, 0.001, 0.0], Rotation.from_euler("zyx", [179.8, 0.3, 0.2], degrees=True)
)
PANORAMA = StitchedEquirectangular(
    *PANORAMA_SIZE, StitchedLens(FRONT, 0.004, -0.001), StitchedLens(BACK, -0.003, 0.0008)
)


SIDES = np.arange(6) * np.pi / 3
ROOM = room(SIDES, 1.6, 0.3, 0.2)


def places(count: int, seed: int = 1) -> list[RigidTransform]:
    rng = np.random.default_rng(seed)
    return [
        RigidTransform.from_components(rng.normal(0, 0.2, 3), Rotation.from_rotvec(rng.normal(0, [0.05, 0.05, 1.5])))
        for _ in range(count)
    ]


def panorama_rows(camera: CameraModel, count: int = 8, *, boards: int = 6) -> list[str]:
    rng, rows, points = np.random.default_rng(2), [HEADER], grid(7, 5, 0.1)
    for shot, place in enumerate(places(count)):
        for number, pose in enumerate(ROOM[:boards]):
            pixels, valid = camera.project((place.inv() * pose).apply(points))
            pixels = np.clip(pixels + rng.normal(0, 0.05, pixels.shape), -0.5, PANORAMA_SIZE[0] - 0.5)
            rows += corner_rows(f"s{shot},B{number},0", points, pixels, valid)
    return rows


MODEL = ("--model", "stitched_equirectangular", "--out")


def worst_point_deg(camera: CameraModel) -> float:
    """Return how far bearings of points at 2 m are off, with the camera where it fits best."""
    rng = np.random.default_rng(3)
    rays = rng.normal(size=(3000, 3))
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    rays = rays[np.abs(rays[:, 0]) > 0.05]
    truth = PANORAMA.unproject(PANORAMA.project(2 * rays).pixels)
    found = camera.unproject(PANORAMA.project(2 * rays).pixels)
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
    place = write_corners(tmp_path / "in", PANORAMA_SIZE, panorama_rows(PANORAMA), boards_stand_still=True)
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
    assert worst_point_deg(Equirectangular(*PANORAMA_SIZE)) > 0.1
    assert "px rms before" in ended.out
    page = (tmp_path / "camera.html").read_text()
    assert page.count('src="data:image/png;base64,') == page.count("<img ") == 2


def test_a_panorama_that_is_right_is_left_alone(tmp_path: Path, calibrate: Calibrate) -> None:
    place = write_corners(
        tmp_path / "in", PANORAMA_SIZE, panorama_rows(Equirectangular(*PANORAMA_SIZE)), boards_stand_still=True
    )
    ended = calibrate("intrinsics", place, *MODEL, tmp_path / "camera.yaml")
    assert ended.code == 0
    assert "note: no_gain" in ended.err
    data = json.loads((tmp_path / "camera.json").read_text())
    value, sigma = (np.array(data["back_lens_off"][key]) for key in ("value", "sigma"))
    assert (np.abs(value) < 4 * sigma).all()


def test_one_board_beside_the_seam_tells_nothing_of_the_other_lens(tmp_path: Path, calibrate: Calibrate) -> None:
    rows = [row for row in panorama_rows(PANORAMA, 10, boards=1)[1:] if 1100 < float(row.split(",")[6]) < 2740]
    place = write_corners(tmp_path / "in", PANORAMA_SIZE, [HEADER, *rows], boards_stand_still=False)
    ended = calibrate("intrinsics", place, *MODEL, tmp_path / "camera.yaml")
    assert ended.code == 3
    assert "degenerate: unobservable" in ended.err
    assert not (tmp_path / "camera.yaml").exists()


@pytest.mark.slow
def test_stitched_shots_of_boards_give_the_lenses(
    tmp_path: Path, calibrate: Calibrate, render: Callable[..., Image]
) -> None:
    truth = StitchedEquirectangular(1280, 640, PANORAMA.front, PANORAMA.back)
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
    place = write_corners(tmp_path / "in", PANORAMA_SIZE, panorama_rows(PANORAMA, 3))
    write_intrinsics(place, PANORAMA_SIZE, **{"corners": "corners.csv", "boards_stand_still": True, key: value})
    calibrate("intrinsics", place, *MODEL, tmp_path / "camera.yaml").refuses(message)


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
