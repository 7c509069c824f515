"""Metric planes placed by a pose, and the grids that sample them.

A plane has its own frame, named as it is looked at: ``right`` and ``up`` lie in the plane, the third axis
points to the viewer. Pallet and plane share their origin; the two kinds differ in what is up:

=============  ==================  =======================  ============================
plane          right               up                       towards the viewer
=============  ==================  =======================  ============================
vertical       pallet's -y         pallet's z               pallet's -x (into the aisle)
horizontal     pallet's -y         pallet's x (into it)     pallet's z (from above)
=============  ==================  =======================  ============================
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from palletloc.geometry import BoolArray, FloatArray, Image, LevelPose

PALLET_FROM_VERTICAL = RigidTransform.from_rotation(
    Rotation.from_matrix([[0.0, 0.0, -1.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
)
"""Axes of a vertical plane (right, up, towards the viewer) in the pallet frame."""
FACE_IN_PALLET: FloatArray = PALLET_FROM_VERTICAL.as_matrix()
"""The same as a (4, 4) matrix."""
FACE_IN_PALLET.flags.writeable = False
PALLET_FROM_HORIZONTAL = RigidTransform.from_rotation(
    Rotation.from_matrix([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
)
"""Axes of a horizontal plane (right, up, towards the viewer) in the pallet frame."""


def place_plane(
    target_from_forklift: RigidTransform, forklift_from_pallet: LevelPose, pallet_from_plane: RigidTransform
) -> RigidTransform:
    """Return ``target_from_plane`` for a plane through a pallet's pose.

    Parameters
    ----------
    target_from_forklift : RigidTransform
        Usually ``camera_from_forklift``.
    forklift_from_pallet : LevelPose
        The pose.
    pallet_from_plane : RigidTransform
        `PALLET_FROM_VERTICAL` or `PALLET_FROM_HORIZONTAL`.

    Notes
    -----
    The same as the product of the three transforms, without checking each product for being one.
    """
    matrix = target_from_forklift.as_matrix() @ forklift_from_pallet.matrix() @ pallet_from_plane.as_matrix()
    return RigidTransform(matrix, normalize=False, copy=False)


@dataclass(frozen=True, slots=True)
class PlaneGrid:
    """A regular sampling of a plane: which part of it, and how finely.

    Pixel centres are at integers: column ``c``, row ``r`` is the point ``right = left + c * resolution``,
    ``up = top - r * resolution``.
    """

    left: float
    """``right`` coordinate of the first column, in metres."""
    top: float
    """``up`` coordinate of the first row, in metres."""
    resolution: float
    """Metres per pixel."""
    columns: int
    """Number of columns."""
    rows: int
    """Number of rows."""

    def __post_init__(self) -> None:
        """Refuse a grid that samples nothing."""
        if not (self.resolution > 0 and self.columns > 0 and self.rows > 0):
            raise ValueError(f"a plane grid needs a positive resolution and size, got {self}")

    @classmethod
    def spanning(cls, left: float, right: float, bottom: float, top: float, resolution: float) -> PlaneGrid:
        """Return the grid that covers a rectangle, both edges included.

        Parameters
        ----------
        left, right, bottom, top : float
            The rectangle in the plane's coordinates, in metres.
        resolution : float
            Metres per pixel.

        Examples
        --------
        >>> PlaneGrid.spanning(-1.0, 1.0, 0.0, 0.5, resolution=0.25)
        PlaneGrid(left=-1.0, top=0.5, resolution=0.25, columns=9, rows=3)
        """
        columns = int(np.ceil((right - left) / resolution - 1e-9)) + 1
        rows = int(np.ceil((top - bottom) / resolution - 1e-9)) + 1
        return cls(left, top, resolution, columns, rows)

    def points(self, pixels: FloatArray) -> FloatArray:
        """Convert pixels to metres.

        Parameters
        ----------
        pixels : (..., 2) array
            Columns and rows.

        Returns
        -------
        (..., 2) array
            ``right`` and ``up`` in metres.
        """
        return np.stack(
            [self.left + pixels[..., 0] * self.resolution, self.top - pixels[..., 1] * self.resolution], -1
        )

    def pixels(self, points: FloatArray) -> FloatArray:
        """Convert metres to pixels: the inverse of `points`."""
        pixels = np.empty(points.shape)
        pixels[..., 0] = (points[..., 0] - self.left) / self.resolution
        pixels[..., 1] = (self.top - points[..., 1]) / self.resolution
        return pixels


@dataclass(frozen=True, slots=True)
class PlaneView:
    """What the camera sees of a plane: a metric image."""

    image: Image
    """(rows, columns) gray or (rows, columns, 3) colour."""
    valid: BoolArray
    """(rows, columns); False where the camera does not see the plane."""
    grid: PlaneGrid
    """Between its pixels and metres."""
    camera_from_plane: RigidTransform
    """Where the plane was."""

    @property
    def plane_from_camera(self) -> FloatArray:
        """(3,) the camera's centre in the plane's coordinates: right, up and towards the viewer, in metres."""
        return np.asarray(self.camera_from_plane.inv().translation)
