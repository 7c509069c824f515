"""Boards on all sides of a camera, and the folders from which its intrinsics are calibrated."""

from collections.abc import Iterable, Sequence
from pathlib import Path

import cv2
import numpy as np
import yaml
from scipy.spatial.transform import RigidTransform, Rotation

from palletloc.geometry import BoolArray, FloatArray, Image

HEADER = "shot,board,lens,x_m,y_m,z_m,u_px,v_px"


def grid(columns: int, rows: int, square: float) -> FloatArray:
    """Return a board's corners around its middle, (n, 3) in metres."""
    x, y = np.meshgrid(np.arange(columns) - (columns - 1) / 2, np.arange(rows) - (rows - 1) / 2)
    return np.stack([x, y, 0 * x], axis=-1).reshape(-1, 3) * square


def towards(azimuth: float, elevation: float) -> Rotation:
    """Return how a board hangs in this direction that faces the camera; its y axis is down."""
    into = Rotation.from_matrix([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    return Rotation.from_euler("zy", [azimuth, -elevation]) * into


def room(
    azimuths: Iterable[float], distance: float, raised: float, turned: float, seed: int = 0
) -> list[RigidTransform]:
    """Return boards in these directions that face the middle but for random turns; all angles in radians."""
    rng, boards = np.random.default_rng(seed), []
    for azimuth in azimuths:
        facing = towards(azimuth, -rng.normal(0, raised))
        turn = Rotation.from_rotvec(rng.normal(0, turned, 3))
        boards.append(RigidTransform.from_components(facing.apply([0, 0, distance]), facing * turn))
    return boards


def corner_rows(where: str, points: FloatArray, pixels: FloatArray, valid: BoolArray | Sequence[bool]) -> list[str]:
    """Return the lines of a board's corners; `where` is its shot, board and lens."""
    return [
        f"{where},{x:.4f},{y:.4f},{z:.4f},{u:.4f},{v:.4f}"
        for (x, y, z), (u, v), seen in zip(points, pixels, valid, strict=True)
        if seen
    ]


def write_corners(folder: Path, size: tuple[int, int], rows: Sequence[str], **more: object) -> Path:
    """Write a folder with a table of corners."""
    write_intrinsics(folder, size, corners="corners.csv", **more)
    (folder / "corners.csv").write_text("\n".join(rows) + "\n")
    return folder


def write_intrinsics(folder: Path, size: tuple[int, int], **more: object) -> Path:
    """Write a folder's intrinsics.yaml."""
    folder.mkdir(exist_ok=True)
    content = {"format": 1, "width": size[0], "height": size[1]} | more
    (folder / "intrinsics.yaml").write_text(yaml.safe_dump(content))
    return folder


def write_shots(folder: Path, shots: Iterable[Image]) -> list[str]:
    """Write shots and return their names."""
    names = []
    for i, shot in enumerate(shots):
        cv2.imwrite(str(folder / f"{i}.png"), shot)
        names.append(f"{i}.png")
    return names
