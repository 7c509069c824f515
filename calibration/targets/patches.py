"""Views of the sphere that are free of distortion: square gnomonic patches, cut through any camera model.

A marker's outline is straight there, as the detector expects. Seam and poles of an equirectangular image are
directions like all others.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from palletloc.cameras.protocol import CameraModel
from palletloc.geometry import BoolArray, FloatArray, Image

HALF_FOV = np.radians(30.0)
"""Half the field of view of a patch, in radians."""
_ROWS = ((0.0, 8), (45.0, 6), (-45.0, 6), (90.0, 1), (-90.0, 1))
"""Latitude in degrees and number of patches of each row: patches of 60 degrees overlap by 15 at least."""
AnyImage = NDArray[Any]
"""(height, width) gray image of uint8 or float32."""
_MIN_SHARE = 0.02
"""Patches of which the camera sees less are left out."""
_FAR = 100.0
"""Where a patch is cut, in metres: there the distance of two lens centres does not show."""
_STEP, _BESIDE = 1e-3, 0.02
"""Step of the derivatives, and how far beside a direction they are taken, in radians."""
_SEAM_PX = 4
"""How many columns from the other side are set beside an image: the kernel reads two."""


@dataclass(frozen=True, slots=True, eq=False)
class Patch:
    """A pinhole view of a part of the sphere."""

    axes: FloatArray
    """(3, 3): its rows are the view's right, down and forward in the camera frame."""
    focal: float
    """In pixels of the patch per unit of the tangent plane."""
    image: Image
    """(n, n) gray image."""

    def directions(self, pixels: FloatArray) -> FloatArray:
        """Return the unit vectors in the camera frame that pixels of the patch, (..., 2), look along."""
        middle = (self.image.shape[0] - 1) / 2
        plane = (np.asarray(pixels, dtype=np.float64) - middle) / self.focal
        rays = np.concatenate([plane, np.ones((*plane.shape[:-1], 1))], axis=-1) @ self.axes
        unit: FloatArray = rays / np.linalg.norm(rays, axis=-1, keepdims=True)
        return unit


def view_axes(direction: FloatArray) -> FloatArray:
    """Return right, down and forward, as rows, of a view along a direction, upright where that has a meaning.

    Examples
    --------
    >>> view_axes(np.array([1.0, 0.0, 0.0])).tolist()
    [[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]]
    """
    forward = direction / np.linalg.norm(direction)
    up = np.array([0.0, 0.0, 1.0]) if abs(forward[2]) < 0.99 else np.array([1.0, 0.0, 0.0])
    right = np.cross(forward, up)
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(forward, right), forward]) + 0.0


def pixel_density(camera: CameraModel, directions: FloatArray) -> FloatArray:
    """Return how many pixels a radian has, in the direction where they are fewest.

    Parameters
    ----------
    camera : CameraModel
        The camera.
    directions : (n, 3) array
        Unit vectors in the camera frame.

    Returns
    -------
    (n,) array
        In pixels per radian; NaN where the camera does not see.
    """
    density = np.full(len(directions), np.nan)
    for i, direction in enumerate(directions):
        axes = view_axes(direction)
        # Beside the direction itself: at the pole of an equirectangular image columns have no derivative.
        around = direction + _BESIDE * axes[:2].sum(0) + _STEP * np.concatenate([axes[:2], -axes[:2]])
        pixels, valid = camera.project(_FAR * around)
        difference = pixels[:2] - pixels[2:]
        if camera.period_px is not None:
            difference[:, 0] -= np.round(difference[:, 0] / camera.period_px) * camera.period_px
        if valid.all():
            density[i] = np.linalg.svd(difference / (2 * _STEP), compute_uv=False)[-1]
    return density


def patch_directions() -> FloatArray:
    """Return the middles of patches that cover the sphere with an overlap, (n, 3) unit vectors."""
    angles = [(np.radians(lat), 2 * np.pi * i / count) for lat, count in _ROWS for i in range(count)]
    return np.array([(np.cos(a) * np.cos(o), np.cos(a) * np.sin(o), np.sin(a)) for a, o in angles])


def sphere_patches(camera: CameraModel, image: Image, scale: float) -> Iterator[Patch]:
    """Cut a shot into patches, one by one; what the camera does not see is left out.

    Parameters
    ----------
    camera : CameraModel
        Of the shot.
    image : (height, width) array of uint8
        The shot in gray.
    scale : float
        Pixels of a patch's middle per pixel of the shot.

    Yields
    ------
    Patch
        In no particular order.
    """
    middles = patch_directions()
    for middle, density in zip(middles, _densities(camera, middles), strict=True):
        if np.isfinite(density):
            patch, valid = cut_patch(camera, image, middle, scale * density)
            if valid.mean() > _MIN_SHARE:
                yield patch


def _densities(camera: CameraModel, middles: FloatArray) -> FloatArray:
    """Return the density at each middle; where only the rim of a patch is seen, the usual one of the camera."""
    density = pixel_density(camera, middles)
    if np.isfinite(density).any():
        density[~np.isfinite(density)] = np.nanmedian(density)
    else:  # a camera so narrow that it sees no middle
        middle = np.array([[(camera.width - 1) / 2, (camera.height - 1) / 2]])
        density[:] = pixel_density(camera, camera.unproject(middle).directions)[0]
    return density


def cut_patch(camera: CameraModel, image: Image, direction: FloatArray, focal: float) -> tuple[Patch, BoolArray]:
    """Cut one patch out of a shot.

    Parameters
    ----------
    camera, image
        As for `sphere_patches`.
    direction : (3,) array
        Where the patch looks.
    focal : float
        Its pixels per unit of the tangent plane.

    Returns
    -------
    patch : Patch
        The view, black where the camera does not see.
    valid : (n, n) array of bool
        Where it does.
    """
    side = int(np.ceil(2 * focal * np.tan(HALF_FOV)))
    axes = view_axes(direction)
    grid = (np.arange(side) - (side - 1) / 2) / focal
    points = axes[2] + grid[None, :, None] * axes[0] + grid[:, None, None] * axes[1]
    pixels, valid = camera.project(_FAR * points)
    return Patch(axes, focal, sample(camera, image, pixels)), valid


def sample(camera: CameraModel, image: AnyImage, pixels: FloatArray) -> AnyImage:
    """Read a shot at pixels, across its seam where it has one.

    Parameters
    ----------
    camera : CameraModel
        Of the shot.
    image : (height, width) array of uint8 or float32
        The shot in gray.
    pixels : (rows, columns, 2) array
        Where to read; NaN reads black.

    Returns
    -------
    (rows, columns) array
        Of the image's type.
    """
    u, v = pixels[..., 0], pixels[..., 1]
    if camera.period_px is not None:
        # A band from the other side is set beside the image, so that the kernel reads across the seam.
        image = np.concatenate([image[:, -_SEAM_PX:], image, image[:, :_SEAM_PX]], axis=1)
        u = u + _SEAM_PX
    columns, rows = (np.nan_to_num(c, nan=-1e4).astype(np.float32) for c in (u, v))
    read = cv2.remap(image, columns, rows, cv2.INTER_CUBIC, borderMode=cv2.BORDER_CONSTANT)
    return np.asarray(read, dtype=image.dtype)
