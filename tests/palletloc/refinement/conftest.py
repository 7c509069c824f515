from collections.abc import Callable

import cv2
import numpy as np
import pytest

from palletloc import CameraModel, PalletModel
from palletloc.geometry import FloatArray, Image

Paint = Callable[[FloatArray], FloatArray]
"""Gives the gray levels of (..., 2) points of a plane: right and up, in metres."""
SUPERSAMPLED = 4
"""Samples along each side of a pixel."""
LENS_BLUR = 0.7
"""Standard deviation of the blur, in pixels."""
AROUND = 0.07
"""What is painted around a face, in metres."""


def painted(camera: CameraModel, camera_from_plane: FloatArray, extent: tuple[float, ...], paint: Paint) -> Image:
    """Return the gray image of a painted plane, blurred like a lens does; gray 90 beyond the extent."""
    image = np.full((camera.height, camera.width), 90.0)
    rows, columns = np.mgrid[: camera.height, : camera.width]
    seen = _on_plane(camera, np.stack([columns, rows], -1).astype(float), camera_from_plane)
    left, right, low, high = extent
    with np.errstate(invalid="ignore"):
        near = (seen[..., 0] > left) & (seen[..., 0] < right) & (seen[..., 1] > low) & (seen[..., 1] < high)
    step = (np.arange(SUPERSAMPLED) + 0.5) / SUPERSAMPLED - 0.5
    within = np.stack(np.meshgrid(step, step), -1).reshape(-1, 2)
    pixels = np.stack([columns[near], rows[near]], -1)[:, None] + within
    image[near] = paint(np.nan_to_num(_on_plane(camera, pixels, camera_from_plane), nan=1e3)).mean(axis=1)
    sides = cv2.copyMakeBorder(image, 0, 0, 8, 8, cv2.BORDER_WRAP if camera.period_px else cv2.BORDER_REPLICATE)
    blurred = cv2.GaussianBlur(sides, (0, 0), LENS_BLUR)[:, 8:-8]
    return np.clip(np.rint(blurred), 0, 255).astype(np.uint8)


def _on_plane(camera: CameraModel, pixels: FloatArray, camera_from_plane: FloatArray) -> FloatArray:
    """Return where the rays of pixels meet a plane: right and up; NaN where they do not."""
    directions, origins, valid = camera.unproject(pixels)
    rotation, place = camera_from_plane[:3, :3], camera_from_plane[:3, 3]
    start, ray = (origins - place) @ rotation, directions @ rotation
    with np.errstate(invalid="ignore", divide="ignore"):
        reach = -start[..., 2] / ray[..., 2]
        met = valid & (reach > 0)
    return np.where(met[..., None], start[..., :2] + ray[..., :2] * reach[..., None], np.nan)


@pytest.fixture(scope="session")
def paint_plane() -> Callable[..., Image]:
    """Return a function that takes the picture of a painted plane through any camera, by casting rays."""
    return painted


@pytest.fixture(scope="session")
def shoot_face() -> Callable[..., Image]:
    """Return a function that takes the picture of a sharp flat face through any camera, by casting rays.

    The face is drawn ``grown`` metres out of its solid: its outline larger, its openings smaller.
    """

    def shot(
        camera: CameraModel,
        camera_from_face: FloatArray,
        model: PalletModel,
        grown: float = 0.0,
        levels: tuple[float, float, float] = (90.0, 180.0, 30.0),
    ) -> Image:
        half = model.width / 2

        def paint(points: FloatArray) -> FloatArray:
            right, up = points[..., 0], points[..., 1]
            gray = np.full(right.shape, levels[0])
            gray[(np.abs(right) <= half + grown) & (up >= -grown) & (up <= model.height + grown)] = levels[1]
            for opening in model.openings:
                inside = (right >= opening.left + grown) & (right <= opening.right - grown)
                inside &= (up <= opening.top - grown) & (up >= opening.bottom + (0 if opening.open_below else grown))
                gray[inside] = levels[2]
            return gray

        extent = (-half - AROUND, half + AROUND, -AROUND, model.height + AROUND)
        return painted(camera, camera_from_face, extent, paint)

    return shot
