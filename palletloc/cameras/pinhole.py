"""Perspective cameras with the radial and tangential distortion of Brown.

D. C. Brown, "Close-range camera calibration", Photogrammetric Engineering 37(8), 1971, with the
coefficients of OpenCV: k1, k2, p1, p2, k3.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from palletloc.cameras.brown_distortion import BrownDistortion
from palletloc.cameras.image_area import blank_invalid, check_lens, check_size, inside_image
from palletloc.cameras.protocol import Projection, Rays
from palletloc.geometry import FloatArray


@dataclass(frozen=True, slots=True)
class Pinhole:
    """A perspective camera whose optical axis is its x, with the image's right at -y and its down at -z.

    Points behind the camera are not seen, nor those so far off axis that the distortion would fold the
    image over.

    Examples
    --------
    >>> camera = Pinhole(640, 480, 500.0, 500.0, 319.5, 239.5)
    >>> camera.project(np.array([2.0, -0.2, 0.1])).pixels
    array([369.5, 214.5])
    """

    width: int
    """Image width in pixels."""
    height: int
    """Image height in pixels."""
    fx: float
    """Focal length along columns, in pixels."""
    fy: float
    """Focal length along rows, in pixels."""
    cx: float
    """Column of the optical axis."""
    cy: float
    """Row of the optical axis."""
    k1: float = 0.0
    """Radial coefficient of r^2."""
    k2: float = 0.0
    """Radial coefficient of r^4."""
    p1: float = 0.0
    """Tangential coefficient along rows."""
    p2: float = 0.0
    """Tangential coefficient along columns."""
    k3: float = 0.0
    """Radial coefficient of r^6."""
    _distortion: BrownDistortion = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        """Refuse parameters that describe no lens."""
        coefficients = (self.k1, self.k2, self.p1, self.p2, self.k3)
        check_size(self.width, self.height)
        check_lens(self.fx, self.fy, (self.cx, self.cy, *coefficients))
        object.__setattr__(self, "_distortion", BrownDistortion(*coefficients))

    @property
    def period_px(self) -> float | None:
        """The image does not close around."""
        return None

    def project(self, points_camera: FloatArray) -> Projection:
        """Project points to pixels. See `CameraModel.project`."""
        points = np.asarray(points_camera, dtype=np.float64)
        forward = points[..., 0]
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            right, down = points[..., 1] / -forward, points[..., 2] / -forward
            squared = right * right + down * down
            valid = (forward > 0) & (forward < np.inf) & (squared <= self._distortion.max_radius**2)
            pixels = np.empty((*points.shape[:-1], 2))
            distorted_right, distorted_down = self._distortion.apply(right, down, squared)
            pixels[..., 0] = self.cx + self.fx * distorted_right
            pixels[..., 1] = self.cy + self.fy * distorted_down
        valid &= inside_image(pixels, self.width, self.height)
        blank_invalid(pixels, valid)
        return Projection(pixels, valid)

    def unproject(self, pixels: FloatArray) -> Rays:
        """Return the rays that pixels look along. See `CameraModel.unproject`."""
        pixels = np.asarray(pixels, dtype=np.float64)
        seen = np.where(inside_image(pixels, self.width, self.height)[..., None], pixels, np.nan)
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            right, down = (seen[..., 0] - self.cx) / self.fx, (seen[..., 1] - self.cy) / self.fy
            right, down = self._distortion.invert(right, down)
            squared = right * right + down * down
            valid = squared <= self._distortion.max_radius**2
            forward = 1 / np.sqrt(1 + squared)
            directions = np.stack([forward, -forward * right, -forward * down], axis=-1)
        blank_invalid(directions, valid)
        return Rays(directions, np.zeros_like(directions), valid)

    def centers(self, points_camera: FloatArray) -> FloatArray:
        """Return the optical centre, the origin, for each point. See `CameraModel.centers`."""
        return np.zeros(np.shape(points_camera))
