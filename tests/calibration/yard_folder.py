"""Folders with a rendered shot of four boards, and input that is changed at a key."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import cv2
import yaml
from scipy.spatial.transform import RigidTransform

from calibration.targets.targets import CharucoBoard, on_board, patterns
from palletloc.cameras import Equirectangular
from palletloc.geometry import FloatArray, Image
from tests.calibration.simulated_yard import boards_around

CAMERA = Equirectangular(1280, 640)
Change = Callable[[dict[str, Any]], object]
"""Of a file's content."""
CORNERS = ("top_left", "top_right", "bottom_left")


def board(number: int) -> CharucoBoard:
    return CharucoBoard(4, 3, 0.2, 0.15, "DICT_4X4_50", 6 * number)


def board_key(number: int) -> dict[str, Any]:
    """Return a board as files describe it."""
    spec = {"columns": 4, "rows": 3, "square_m": 0.2, "marker_m": 0.15, "dictionary": "DICT_4X4_50"}
    return {"charuco": spec | {"first_id": 6 * number}}


def render_yard(folder: Path, render: Callable[..., Image], forklift_from_camera: RigidTransform) -> list[FloatArray]:
    """Write the shot of a yard and return the true corners of each board, (3, 3), in the forklift frame."""
    poses = boards_around(forklift_from_camera.translation, (0.6, 2.2, -2.2, -0.9), 3)
    hung = [(board(k), forklift_from_camera.inv() * pose) for k, pose in enumerate(poses)]
    cv2.imwrite(str(folder / "shot.png"), render(CAMERA, hung))
    return [pose.apply(on_board(patterns(board(k))[0].outline)) for k, pose in enumerate(poses)]


def write(folder: Path, content: dict[str, Any]) -> None:
    camera = {"model": "equirectangular", "width": 1280, "height": 640}
    usual = {"format": 1, "camera": camera, "shots": ["shot.png"]}
    (folder / "extrinsics.yaml").write_text(yaml.safe_dump(usual | content))


def copied(folder: Path, place: Path, names: Sequence[str] = ("shot.png",)) -> dict[str, Any]:
    """Copy files of a folder, and return what its extrinsics.yaml says."""
    place.mkdir()
    for name in names:
        (place / name).write_bytes((folder / name).read_bytes())
    content: dict[str, Any] = yaml.safe_load((folder / "extrinsics.yaml").read_text())
    return content


def set_key(*keys: str | int, value: object) -> Change:
    """Return a change of a file's content."""

    def change(content: dict[str, Any]) -> None:
        place: Any = content
        for key in keys[:-1]:
            place = place[key]
        place[keys[-1]] = value

    return change
