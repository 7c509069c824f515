"""Remap tables for looking around: a fraction of a pixel off, and cheap where the plane is new in every shot."""

from __future__ import annotations

import cv2
import numpy as np
from scipy.spatial.transform import RigidTransform

from palletloc.geometry import FloatArray
from palletloc.plane import PlaneGrid
from palletloc.projection import Projector
from palletloc.remap_table import ImageWindow, RemapTable, exact_map

MAX_ERROR_PX = 0.75
"""How far a loose table may lie from the exact map, in pixels of the image."""
_STEPS = (8, 4)


def loose_table(projector: Projector, camera_from_plane: RigidTransform, grid: PlaneGrid) -> RemapTable:
    """Return a table that is bilinear between nodes some pixels of the view apart.

    Parameters
    ----------
    projector : Projector
        Of the camera.
    camera_from_plane : RigidTransform
        Where the plane is.
    grid : PlaneGrid
        The part of the plane and its sampling.

    Returns
    -------
    RemapTable
        Within about `MAX_ERROR_PX` of the exact map; the projector's own table where the camera does not see all of
        the plane, or where the map bends too much or jumps, as at the image's seam or between two lenses.
    """
    camera = projector.camera
    for step in _STEPS:
        pixels, valid = exact_map(camera, camera_from_plane, _nodes(grid, step))
        if not valid.all():
            break
        if _error_px(pixels) <= MAX_ERROR_PX:
            return _upsampled(pixels, step, grid, ImageWindow(0, 0, camera.width, camera.height))
    return projector.table(camera_from_plane, grid)


def _nodes(grid: PlaneGrid, step: int) -> PlaneGrid:
    """Return every ``step``-th place of a grid, halfway between pixels and around them all."""
    margin = (step + 1) / 2 * grid.resolution
    return PlaneGrid(
        left=grid.left - margin,
        top=grid.top + margin,
        resolution=step * grid.resolution,
        columns=-(-grid.columns // step) + 2,
        rows=-(-grid.rows // step) + 2,
    )


def _error_px(pixels: FloatArray) -> float:
    """Return a bound of the interpolation's error: an eighth of the second differences along rows and columns."""
    bends = [np.abs(np.diff(pixels, 2, axis=axis)).max(axis=(0, 1)) for axis in (0, 1)]
    return float(np.hypot(*(bends[0] + bends[1]))) / 8


def _upsampled(pixels: FloatArray, step: int, grid: PlaneGrid, window: ImageWindow) -> RemapTable:
    rows, columns = pixels.shape[:2]
    size = (columns * step, rows * step)
    places = np.asarray(cv2.resize(pixels.astype(np.float32), size, interpolation=cv2.INTER_LINEAR), np.float32)
    # node i falls on pixel (i + 0.5) step - 0.5 of the result, and on (i - 0.5) step - 0.5 of the view
    places = places[step:, step:][: grid.rows, : grid.columns]
    valid = np.ones((grid.rows, grid.columns), dtype=np.bool_)
    places.flags.writeable = valid.flags.writeable = False
    return RemapTable(window, places, valid, True, places.nbytes + valid.nbytes)
