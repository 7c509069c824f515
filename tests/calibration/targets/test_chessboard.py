"""Corners of plain chessboards; the truth is where the drawn lens puts them."""

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from calibration.intrinsics.task import Chessboard
from calibration.targets.chessboard import find_chessboard, off_smooth_board, sees_chessboard
from palletloc.cameras import KannalaBrandt
from palletloc.geometry import FloatArray, Image
from tests.calibration.board_room import towards
from tests.calibration.expecting import present

FAULT = Path(__file__).resolve().parents[3].parent / "shared/data/faults/chessboard-not-found/board.png"
BOARD = Chessboard(8, 6, 0.1)
Render = Callable[..., Image]


def lens(side: int) -> KannalaBrandt:
    focal, middle = 0.29 * side, (side - 1) / 2
    return KannalaBrandt(side, side, focal, focal, middle, middle, max_angle=np.radians(95.0))


def place(polar_deg: float, around_deg: float, distance: float, turn: FloatArray) -> RigidTransform:
    """Return the pose of a board whose middle is seen there, turned against the way to it."""
    polar, around = np.radians([polar_deg, around_deg])
    azimuth = np.arctan2(np.sin(polar) * np.cos(around), np.cos(polar))
    elevation = np.arcsin(np.sin(polar) * np.sin(around))
    facing = towards(azimuth, elevation)
    turned = facing * Rotation.from_rotvec(turn)
    return RigidTransform.from_components(facing.apply([0, 0, distance]) - turned.apply([0.35, 0.25, 0.0]), turned)


def off_truth(camera: KannalaBrandt, pose: RigidTransform, corners: FloatArray) -> float:
    """Return the rms distance of corners from where the lens puts them; boards look the same on their heads."""
    truth = camera.project(pose.apply(BOARD.corners)).pixels
    return min(float(np.sqrt(((corners - t) ** 2).sum(-1).mean())) for t in (truth, truth[::-1]))


def drawn(render: Render, camera: KannalaBrandt, pose: RigidTransform) -> Image:
    # The picture begins one square before the first inner corner.
    moved = RigidTransform.from_components(pose.apply([-0.1, -0.1, 0.0]), pose.rotation)
    return render(camera, [(BOARD, moved)], noise=2.0)


@pytest.mark.parametrize(
    ("polar_deg", "around_deg", "distance", "turn"),
    [
        (20.0, 30.0, 0.8, (0.3, -0.4, 0.2)),
        (55.0, 160.0, 0.7, (-0.2, 0.5, 1.2)),
        (50.0, -70.0, 0.8, (0.1, -0.3, -0.5)),
    ],
)
def test_corners_are_found_and_true(
    render: Render, polar_deg: float, around_deg: float, distance: float, turn: tuple[float, float, float]
) -> None:
    camera = lens(360)
    pose = place(polar_deg, around_deg, distance, np.array(turn))
    corners = present(find_chessboard(drawn(render, camera, pose), 8, 6))
    assert corners.shape == (48, 2)
    assert off_truth(camera, pose, corners) < 0.15


def test_an_empty_shot_has_none() -> None:
    noise = np.random.default_rng(0).integers(100, 140, (90, 120)).astype(np.uint8)
    assert find_chessboard(noise, 8, 6) is None
    assert not sees_chessboard(noise, 8, 6)


def test_a_wrong_corner_lies_off_a_smooth_board() -> None:
    camera = lens(720)
    corners = camera.project(place(50.0, 40.0, 0.6, np.array([0.4, -0.3, 0.2])).apply(BOARD.corners)).pixels
    assert np.abs(off_smooth_board(corners, 8)).max() < 0.1
    wrong = corners.copy()
    wrong[19] += (6.0, -5.0)
    assert np.linalg.norm(off_smooth_board(wrong, 8), axis=-1).max() > 1


@pytest.mark.skipif(not FAULT.is_file(), reason="the shot is not there")
def test_a_board_that_one_detector_misses_is_found() -> None:
    image = np.asarray(cv2.imread(str(FAULT), cv2.IMREAD_GRAYSCALE), dtype=np.uint8)
    corners = present(find_chessboard(image, 8, 6))
    assert corners.shape == (48, 2)
    assert np.sqrt((off_smooth_board(corners, 8) ** 2).sum(-1).mean()) < 0.2


@pytest.mark.slow
def test_no_board_that_a_person_sees_is_lost(render: Render) -> None:
    camera, rng, lost, errors = lens(720), np.random.default_rng(4), 0, list[float]()
    while len(errors) + lost < 40:
        pose = place(rng.uniform(0, 75), rng.uniform(-180, 180), rng.uniform(0.45, 1.1), rng.normal(0, 0.45, 3))
        outline = pose.apply(np.array([[-0.15, -0.15, 0], [0.85, -0.15, 0], [0.85, 0.65, 0], [-0.15, 0.65, 0]]))
        truth = camera.project(pose.apply(BOARD.corners)).pixels.reshape(6, 8, 2)
        least = min(np.linalg.norm(np.diff(truth, axis=axis), axis=-1).min() for axis in (0, 1))
        into = pose.rotation.apply([0, 0, 1])
        if not (camera.project(outline).valid.all() and least > 8 and (pose.apply(BOARD.corners) @ into > 0.1).all()):
            continue
        corners = find_chessboard(drawn(render, camera, pose), 8, 6)
        lost += corners is None
        errors += [] if corners is None else [off_truth(camera, pose, corners)]
    assert lost == 0
    assert np.median(errors) < 0.08
    assert max(errors) < 1.0
