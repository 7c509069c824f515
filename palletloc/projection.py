"""Views of planes through a camera: metric images, with the tables they need, and the size of a pixel on a plane."""

from __future__ import annotations

from collections import OrderedDict

import cv2
import numpy as np
from scipy.spatial.transform import RigidTransform

from palletloc.cameras.protocol import CameraModel
from palletloc.geometry import FloatArray, Image
from palletloc.plane import PlaneGrid, PlaneView
from palletloc.remap_table import ImageWindow, Interpolation, RemapTable, build_table, exact_map

__all__ = ["Interpolation", "Projector", "coarse_table", "pixel_sizes"]

MAX_ERROR_PX = 0.75
"""How far a coarse table may lie from the exact map, in pixels of the image: detection looks for edges that are
several pixels wide."""
NODE_STEPS = (8, 4)
"""Distances of a coarse table's nodes that are tried, in pixels of the view."""
PROBE = 1e-4
"""Length on a plane by whose image the size of a pixel is found, in metres: far below a pixel, far above rounding."""


class Projector:
    """Views of planes through one camera; keeps the tables it has built.

    Not to be shared by threads.

    Parameters
    ----------
    camera : CameraModel
        The camera that took the images.
    cache_bytes : int
        Memory that kept tables may take; those used least recently go first, and a table larger than
        this is not kept.

    Examples
    --------
    >>> from palletloc.cameras import Equirectangular
    >>> from palletloc.plane import PALLET_FROM_VERTICAL
    >>> projector = Projector(Equirectangular(512, 256))
    >>> camera_from_plane = RigidTransform.from_translation([2.0, 0.0, -0.5]) * PALLET_FROM_VERTICAL
    >>> grid = PlaneGrid.spanning(-0.5, 0.5, 0.0, 0.2, resolution=0.01)
    >>> view = projector.view(np.full((256, 512, 3), 7, np.uint8), camera_from_plane, grid)
    >>> view.image.shape, bool(view.valid.all())
    ((21, 101, 3), True)
    """

    def __init__(self, camera: CameraModel, cache_bytes: int = 64 * 2**20) -> None:
        self.camera = camera
        self.cache_bytes = cache_bytes
        self._tables: OrderedDict[tuple[bytes, PlaneGrid], RemapTable] = OrderedDict()
        self._used_bytes = 0

    def view(
        self,
        image: Image,
        camera_from_plane: RigidTransform,
        grid: PlaneGrid,
        interpolation: Interpolation = Interpolation.LINEAR,
    ) -> PlaneView:
        """Return what the image shows of a plane.

        Parameters
        ----------
        image : (height, width) or (height, width, 3) array of uint8
            A whole image of the camera.
        camera_from_plane : RigidTransform
            Where the plane is: x right, y up in it.
        grid : PlaneGrid
            The part of the plane and its sampling.
        interpolation : Interpolation
            How the image is read between its pixels.

        Returns
        -------
        PlaneView
            Its `valid` belongs to the kept table and is read-only.

        Raises
        ------
        ValueError
            If the image is not 8-bit gray or colour, or has another size than the camera's.
        """
        self._check(image)
        table = self.table(camera_from_plane, grid)
        return PlaneView(table.apply(image, interpolation), table.valid, grid, camera_from_plane)

    def table(self, camera_from_plane: RigidTransform, grid: PlaneGrid) -> RemapTable:
        """Return the table of a plane, kept or new; see `build_table`."""
        key = (camera_from_plane.as_matrix().tobytes(), grid)
        table = self._tables.get(key)
        if table is not None:
            self._tables.move_to_end(key)
            return table
        table = build_table(self.camera, camera_from_plane, grid)
        if table.nbytes <= self.cache_bytes:
            self._tables[key] = table
            self._used_bytes += table.nbytes
        while self._used_bytes > self.cache_bytes:
            _, oldest = self._tables.popitem(last=False)
            self._used_bytes -= oldest.nbytes
        return table

    def _check(self, image: Image) -> None:
        expected = (self.camera.height, self.camera.width)
        if image.dtype != np.uint8 or image.shape[:2] != expected or image.shape[2:] not in ((), (3,)):
            raise ValueError(
                f"the camera gives 8-bit gray or colour images of {expected[1]} x {expected[0]} pixels, "
                f"got an array of shape {image.shape} and type {image.dtype}"
            )


def coarse_table(projector: Projector, camera_from_plane: RigidTransform, grid: PlaneGrid) -> RemapTable:
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
    for step in NODE_STEPS:
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


def pixel_sizes(
    camera: CameraModel, camera_from_plane: RigidTransform, points: FloatArray, directions: FloatArray
) -> FloatArray:
    """Return the length on a plane that one pixel of the image spans.

    Parameters
    ----------
    camera : CameraModel
        The camera.
    camera_from_plane : RigidTransform
        Where the plane is.
    points : (n, 2) array
        Right and up, in metres.
    directions : (n, 2) array
        Unit vectors in the plane.

    Returns
    -------
    (n,) array
        Metres per pixel; infinite where the camera does not see the point.
    """
    matrix = camera_from_plane.as_matrix()
    both = np.stack([points, points + PROBE * directions])
    seen = camera.project(both @ matrix[:3, :2].T + matrix[:3, 3])
    moved = np.hypot(*np.moveaxis(seen.pixels[1] - seen.pixels[0], -1, 0))
    if camera.period_px is not None:
        moved = np.where(moved > camera.period_px / 2, camera.period_px - moved, moved)
    return np.where(seen.valid.all(axis=0), PROBE / np.maximum(moved, 1e-12), np.inf)
