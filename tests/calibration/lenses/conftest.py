"""Boards before lenses whose parameters are known."""

from collections.abc import Callable

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from calibration.lenses.problem import BoardView
from palletloc.cameras import CameraModel
from palletloc.geometry import FloatArray


def board_points(columns: int = 9, rows: int = 6, square: float = 0.06) -> FloatArray:
    x, y = np.meshgrid(np.arange(columns) - (columns - 1) / 2, np.arange(rows) - (rows - 1) / 2)
    return np.stack([x, y, 0 * x], axis=-1).reshape(-1, 3) * square


def board_pose(rng: np.random.Generator, reach: float, tilt: float) -> RigidTransform:
    """Return a board somewhere in the field, facing the lens but for a tilt."""
    angle, around = reach * np.sqrt(rng.uniform()), rng.uniform(0, 2 * np.pi)
    ray = np.array([np.cos(angle), np.sin(angle) * np.cos(around), np.sin(angle) * np.sin(around)])
    across = np.cross(ray, [0.0, 0.0, 1.0] if abs(ray[2]) < 0.9 else [0.0, 1.0, 0.0])
    across /= np.linalg.norm(across)
    facing = Rotation.from_matrix(np.stack([across, np.cross(ray, across), ray], axis=1))
    turn = Rotation.from_rotvec(rng.normal(0, tilt, 3) * [1, 1, 0.5])
    return RigidTransform.from_components(rng.uniform(0.5, 0.9) * ray, facing * turn)


@pytest.fixture(scope="session")
def photograph() -> Callable[..., list[BoardView]]:
    """Return what takes corners of a board in random poses through a camera."""

    def take(
        camera: CameraModel, count: int = 20, *, noise: float = 0.1, reach_deg: float = 75.0, tilt_deg: float = 25.0,
        seed: int = 0,
    ) -> list[BoardView]:  # fmt: skip
        rng = np.random.default_rng(seed)
        views: list[BoardView] = []
        points = board_points()
        while len(views) < count:
            pose = board_pose(rng, float(np.radians(reach_deg)), float(np.radians(tilt_deg)))
            pixels, valid = camera.project(pose.apply(points))
            if valid.mean() < 0.6:
                continue
            pixels = pixels[valid] + rng.normal(0, noise, (int(valid.sum()), 2))
            sigma = np.full(len(pixels), max(noise, 1e-3))
            views.append(BoardView(f"view {len(views)}", len(views), 0, 0, points[valid], pixels, sigma))
        return views

    return take
