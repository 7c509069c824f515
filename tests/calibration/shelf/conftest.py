"""Recordings of pictures that a test has drawn."""

from collections.abc import Callable, Iterable
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from palletloc.cameras import CameraModel
from palletloc.geometry import FloatArray
from palletloc.io.recording import Recording, ShotFile
from palletloc.pallet_library import find_models
from palletloc.shelf import ShelfPlane
from palletloc.trajectory import Trajectory


@pytest.fixture(scope="session")
def recorded() -> Callable[..., Recording]:
    """Return what writes pictures, taken at poses in odom a second apart, and returns their recording."""

    def record(
        folder: Path, camera: CameraModel, mounting: RigidTransform, poses: FloatArray, shelf: ShelfPlane,
        pictures: Iterable[FloatArray],
    ) -> Recording:  # fmt: skip
        files = []
        for i, picture in enumerate(pictures):
            cv2.imwrite(str(folder / f"{i}.png"), np.asarray(picture).round().astype(np.uint8))
            files.append(ShotFile(float(i), f"{i}.png"))
        way = Trajectory(np.arange(float(len(poses))), *poses.T)
        return Recording(folder, camera, mounting, shelf, find_models(("epal1-1200",), {}), tuple(files), way)

    return record
