"""How large a pixel of the camera's image is on a plane: what limits a measurement there."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import RigidTransform

from palletloc.cameras.protocol import CameraModel
from palletloc.geometry import FloatArray

_STEP = 1e-4


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
    both = np.stack([points, points + _STEP * directions])
    seen = camera.project(both @ matrix[:3, :2].T + matrix[:3, 3])
    moved = np.hypot(*np.moveaxis(seen.pixels[1] - seen.pixels[0], -1, 0))
    if camera.period_px is not None:
        moved = np.where(moved > camera.period_px / 2, camera.period_px - moved, moved)
    return np.where(seen.valid.all(axis=0), _STEP / np.maximum(moved, 1e-12), np.inf)
