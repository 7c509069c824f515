"""Yards of targets, and shots that are drawn by casting rays."""

from collections.abc import Callable, Sequence

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from calibration.intrinsics.task import Chessboard
from calibration.targets.targets import AprilGrid, CharucoBoard, SingleTag, Target, marker_dictionary, patterns
from palletloc.__main__ import COMMANDS
from palletloc.cameras import CameraModel
from palletloc.cli.app import run
from palletloc.geometry import FloatArray, Image
from tests.calibration.expecting import Calibrate, Ran
from tests.calibration.simulated_yard import Yard, YardErrors, boards_around, simulate_yard

AROUND = (0.4, 1.3, 2.6, -0.6, -1.4, -2.5)
USUAL = YardErrors()
Printed = Target | Chessboard
Hung = tuple[Printed, RigidTransform]


@pytest.fixture(scope="session")
def forklift_from_camera() -> RigidTransform:
    rotation = Rotation.from_euler("ZYX", [-1.8, 1.2, -0.9], degrees=True)
    return RigidTransform.from_components([0.33, 0.09, 1.92], rotation)


@pytest.fixture(scope="session")
def yard(forklift_from_camera: RigidTransform) -> Callable[..., Yard]:
    """Return what draws a yard of boards in the given directions."""
    board = CharucoBoard(7, 5, 0.1, 0.075, "DICT_4X4_250")

    def draw(
        azimuths: Sequence[float] = AROUND, seed: int = 0, errors: YardErrors = USUAL, target: Target = board
    ) -> Yard:
        boards = boards_around(forklift_from_camera.translation, azimuths, seed)
        return simulate_yard(patterns(target)[0], forklift_from_camera, boards, errors, seed)

    return draw


def print_of(target: Printed, *, legacy: bool = False) -> tuple[FloatArray, float]:
    """Return OpenCV's own picture of a target, 0 black to 1 white, and its width in metres.

    Of a plain chessboard our own.
    """
    if isinstance(target, Chessboard):
        row, column = np.indices((target.rows + 1, target.columns + 1))
        squares = (row + column) % 2.0
        return np.kron(squares, np.ones((48, 48))), (target.columns + 1) * target.square
    dictionary = marker_dictionary(target.dictionary)
    if isinstance(target, SingleTag):
        picture = dictionary.generateImageMarker(target.id, 20 * (dictionary.markerSize + 2))
        return np.asarray(picture, dtype=np.float64) / 255, target.size
    if isinstance(target, AprilGrid):
        return grid_picture(target)
    ids = target.first_id + np.arange(target.columns * target.rows // 2)
    size = (target.columns, target.rows)
    board = cv2.aruco.CharucoBoard(size, target.square, target.marker, dictionary, ids)
    board.setLegacyPattern(legacy)
    picture = board.generateImage((size[0] * 48, size[1] * 48))
    return np.asarray(picture, dtype=np.float64) / 255, target.columns * target.square


def grid_picture(grid: AprilGrid, module: int = 8) -> tuple[FloatArray, float]:
    """Return a grid as Kalibr draws it, with OpenCV's markers turned, and its width in metres."""
    dictionary, side = marker_dictionary(grid.dictionary), module * 10
    gap = round(side * grid.spacing)
    pitch = side + gap
    picture = np.ones((grid.rows * pitch + gap, grid.columns * pitch + gap))
    for i in range(grid.rows + 1):
        for j in range(grid.columns + 1):
            picture[i * pitch : i * pitch + gap, j * pitch : j * pitch + gap] = 0.0
    for number in range(grid.rows * grid.columns):
        up, across = divmod(number, grid.columns)
        top, left = picture.shape[0] - gap - up * pitch - side, gap + across * pitch
        tag = np.asarray(dictionary.generateImageMarker(grid.first_id + number, side, borderBits=2))
        picture[top : top + side, left : left + side] = tag[::-1, ::-1] / 255
    return picture, picture.shape[1] / side * grid.tag


@pytest.fixture
def calibrate(capfd: pytest.CaptureFixture[str]) -> Calibrate:
    """Return what runs ``palletloc calibrate`` and returns how it ended."""
    return lambda *arguments: Ran(run(["calibrate", *map(str, arguments)], COMMANDS), *capfd.readouterr())


@pytest.fixture(scope="session")
def render() -> Callable[..., Image]:
    """Return what draws a shot of targets in the camera frame by casting nine rays for each pixel."""

    def draw(camera: CameraModel, hung: Sequence[Hung], *, legacy: bool = False, noise: float = 1.5) -> Image:
        shot = np.full((camera.height, camera.width), 110.0)
        for target, camera_from_board in hung:
            picture, width = print_of(target, legacy=legacy)
            _hang(camera, shot, picture, width, camera_from_board)
        shot = np.asarray(cv2.GaussianBlur(shot, (0, 0), 0.6), dtype=np.float64)
        shot += np.random.default_rng(0).normal(0, noise, shot.shape)
        return np.asarray(np.clip(np.round(shot), 0, 255), dtype=np.uint8)

    return draw


def _hang(camera: CameraModel, shot: FloatArray, picture: FloatArray, width: float, pose: RigidTransform) -> None:
    scale = picture.shape[1] / width
    margin = picture.shape[1] // 7
    framed = np.pad(picture, margin, constant_values=1.0).astype(np.float32)
    middle = pose.apply([width / 2, picture.shape[0] / scale / 2, 0.0])
    grid = np.stack(np.meshgrid(np.arange(camera.width), np.arange(camera.height)), -1).astype(np.float64)
    cosine = camera.unproject(grid).directions @ middle / np.linalg.norm(middle)
    v, u = np.nonzero(np.nan_to_num(cosine, nan=-1.0) > np.cos(width / np.linalg.norm(middle)))
    level, weight = np.zeros(len(u)), np.zeros(len(u))
    inverse = pose.inv()
    for du, dv in ((i / 3, j / 3) for i in (-1, 0, 1) for j in (-1, 0, 1)):
        directions, origins, valid = camera.unproject(np.stack([u + du, v + dv], -1).astype(np.float64))
        rays = inverse.rotation.apply(np.nan_to_num(directions, nan=1.0))
        start = inverse.apply(np.nan_to_num(origins))
        reach = -start[:, 2] / rays[:, 2]
        x, y = ((start[:, i] + reach * rays[:, i]) * scale + margin - 0.5 for i in (0, 1))
        inside = valid & (reach > 0) & (x > 0) & (y > 0) & (x < framed.shape[1] - 1) & (y < framed.shape[0] - 1)
        across, down = (np.clip(c, -1, 32000).astype(np.float32).reshape(-1, 1) for c in (x, y))
        read = [
            cv2.remap(framed, across[i : i + 30000], down[i : i + 30000], cv2.INTER_LINEAR)
            for i in range(0, len(u), 30000)  # OpenCV takes no longer columns
        ]
        level += np.where(inside, 30 + 190 * np.concatenate(read).ravel(), 0.0)
        weight += inside
    shot[v, u] = (level + (9 - weight) * shot[v, u]) / 9
