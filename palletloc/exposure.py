"""Dark shots brightened: steps that round to whole gray levels would lose most of what little contrast they have."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from palletloc.cameras.protocol import CameraModel
from palletloc.geometry import FloatArray, Image, LevelPose
from palletloc.mounting import Mounting
from palletloc.shelf import ShelfPlane

BRIGHT = 200.0
"""Gray level that the brightest parts of the shelf shall have."""
BRIGHTEST = 98.0
"""Percentile of the gray levels about the shelf that counts as its brightest: lamps and reflections are more so."""
LEAST_GAIN, MOST_GAIN = 1.5, 12.0
"""Gain from which on brightening is worth its time, and the largest one: beyond, there is only noise."""
ABOUT = 1.0
"""How far around given places the light is looked at, in metres."""
STEP = 0.15
"""How far apart it is looked at, in metres."""


def brightened(image: Image, camera: CameraModel, mounting: Mounting, points: FloatArray) -> Image:
    """Return a shot as if it had been exposed for what it is to measure.

    Parameters
    ----------
    image : (height, width) or (height, width, 3) array
        The shot.
    camera : CameraModel
        The camera that took it.
    mounting : Mounting
        Of the camera.
    points : (n, 3) array
        Places in the forklift frame that it shall be exposed for, in metres.

    Returns
    -------
    Image
        The shot itself where it is bright enough there.
    """
    matrix = mounting.camera_from_forklift
    seen = camera.project(points @ matrix[:3, :3].T + matrix[:3, 3])
    height, width = image.shape[:2]
    columns, rows = np.rint(seen.pixels[seen.valid]).astype(np.intp).T
    inside = (columns >= 0) & (columns < width) & (rows >= 0) & (rows < height)
    if not inside.any():
        return image
    colours = image[rows[inside], columns[inside]].reshape(int(np.count_nonzero(inside)), -1)
    levels = np.sort(colours.max(axis=1))
    brightest = float(np.interp(BRIGHTEST / 100 * (len(levels) - 1), np.arange(len(levels)), levels))
    gain = BRIGHT / max(brightest, 1.0)
    if gain < LEAST_GAIN:
        return image
    return np.asarray(cv2.convertScaleAbs(image, alpha=min(gain, MOST_GAIN)), dtype=np.uint8)


def shelf_points(shelf: ShelfPlane, heights: tuple[float, float], reach: float) -> FloatArray:
    """Return points all over a shelf's front.

    Parameters
    ----------
    shelf : ShelfPlane
        In the forklift frame.
    heights : (float, float)
        Lowest and highest, in metres.
    reach : float
        How far to both sides of the place nearest to the forklift, in metres.

    Returns
    -------
    (n, 3) array
        In the forklift frame.
    """
    out = np.array([np.cos(shelf.facing), np.sin(shelf.facing)])
    foot = out * (out @ [shelf.x, shelf.y])
    along, up = np.meshgrid(np.arange(-reach, reach, STEP), np.arange(*heights, STEP))
    floor = foot + along.reshape(-1, 1) * np.array([-out[1], out[0]])
    return np.column_stack([floor, up.ravel()])


def points_about(poses: Sequence[LevelPose]) -> FloatArray:
    """Return points around given places.

    Parameters
    ----------
    poses : sequence of LevelPose
        ``forklift_from_pallet``.

    Returns
    -------
    (n, 3) array
        In the forklift frame.
    """
    return np.concatenate([_AROUND @ pose.matrix()[:3, 1:3].T + (pose.x, pose.y, pose.z) for pose in poses])


def _around() -> FloatArray:
    """Return points on and around a face, (n, 2): left and up, in metres."""
    left, up = np.meshgrid(np.arange(-ABOUT, ABOUT, STEP), np.arange(-STEP, 2 * STEP, STEP / 2))
    return np.stack([left.ravel(), up.ravel()], axis=1)


_AROUND = _around()
