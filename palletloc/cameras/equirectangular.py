"""The whole sphere as longitude and latitude: the stitched image of a 360-degree camera."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from palletloc.cameras.image_area import blank_invalid, check_size
from palletloc.cameras.protocol import Projection, Rays
from palletloc.geometry import FloatArray


@dataclass(frozen=True, slots=True)
class Equirectangular:
    """A camera that sees everything: columns are longitudes, rows are latitudes.

    ``lon = pi - 2 pi (u + 0.5) / width`` runs from left (+y) over forward (+x, the image's middle) to the
    right, ``lat = pi / 2 - pi (v + 0.5) / height`` from up to down.

    Examples
    --------
    >>> camera = Equirectangular(width=3840, height=1920)
    >>> camera.project(np.array([2.0, 0.0, 0.0])).pixels
    array([1919.5,  959.5])
    """

    width: int
    """Image width in pixels, 360 degrees."""
    height: int
    """Image height in pixels, 180 degrees."""

    def __post_init__(self) -> None:
        """Refuse an image without pixels."""
        check_size(self.width, self.height)

    @property
    def period_px(self) -> float | None:
        """The image closes around after its width."""
        return float(self.width)

    def project(self, points_camera: FloatArray) -> Projection:
        """Project points to pixels; every point is seen but the origin. See `CameraModel.project`.

        ``u`` lies in [-0.5, width - 0.5].
        """
        points = np.asarray(points_camera, dtype=np.float64)
        x, y, z = points[..., 0], points[..., 1], points[..., 2]
        with np.errstate(over="ignore"):
            level = x * x + y * y
            squared = level + z * z
        # Column by column: NumPy is slow where the last axis is short.
        u = np.arctan2(y, x)
        v = np.arctan2(z, np.sqrt(level))
        pixels = np.empty((*points.shape[:-1], 2))
        pixels[..., 0] = u * (-self.width / (2 * np.pi)) + (self.width / 2 - 0.5)
        pixels[..., 1] = v * (-self.height / np.pi) + (self.height / 2 - 0.5)
        valid = (squared > 0) & (squared < np.inf)
        blank_invalid(pixels, valid)
        return Projection(pixels, valid)

    def unproject(self, pixels: FloatArray) -> Rays:
        """Return the rays that pixels look along; ``u`` may be any number of turns on. See `CameraModel`."""
        pixels = np.asarray(pixels, dtype=np.float64)
        u, v = pixels[..., 0], pixels[..., 1]
        valid = np.isfinite(u) & (v >= -0.5) & (v <= self.height - 0.5)
        with np.errstate(invalid="ignore"):
            lon = np.pi - 2 * np.pi * ((u + 0.5) / self.width)
            lat = np.pi / 2 - np.pi * ((v + 0.5) / self.height)
            level = np.cos(lat)
            directions = np.stack([level * np.cos(lon), level * np.sin(lon), np.sin(lat)], axis=-1)
        blank_invalid(directions, valid)
        return Rays(directions, np.zeros_like(directions), valid)

    def centers(self, points_camera: FloatArray) -> FloatArray:
        """Return the optical centre, the origin, for each point. See `CameraModel.centers`."""
        return np.zeros(np.shape(points_camera))
