"""Views of planes through a camera: metric images, with the tables they need kept per plane."""

from __future__ import annotations

from collections import OrderedDict

import numpy as np
from scipy.spatial.transform import RigidTransform

from palletloc.cameras.protocol import CameraModel
from palletloc.geometry import Image
from palletloc.plane import PlaneGrid, PlaneView
from palletloc.remap_table import Interpolation, RemapTable, build_table

__all__ = ["Interpolation", "Projector"]


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
