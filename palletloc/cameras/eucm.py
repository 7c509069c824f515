"""Fisheye lenses by the enhanced unified camera model.

B. Khomutenko, G. Garcia, P. Martinet, "An enhanced unified camera model", IEEE RA-L 1(1), 2016.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from palletloc.cameras.image_area import blank_invalid, check_angle, check_lens, check_size, inside_image
from palletloc.cameras.protocol import Projection, Rays
from palletloc.cameras.unified_sphere import UnifiedSphere, off_axis, reaches
from palletloc.geometry import FloatArray


@dataclass(frozen=True, slots=True)
class Eucm:
    """A camera whose optical axis is its x, with the image's right at -y and its down at -z.

    With ``rho`` across the axis and ``z`` along it, a point appears at
    ``rho / (alpha sqrt(beta rho^2 + z^2) + (1 - alpha) z)`` times the focal length.

    Raises
    ------
    ValueError
        If the numbers describe no lens.

    Examples
    --------
    >>> camera = Eucm(1000, 1000, 300.0, 300.0, 499.5, 499.5, alpha=0.6, beta=1.0)
    >>> camera.project(np.array([0.0, -1.0, 0.0])).pixels
    array([999.5, 499.5])
    """

    width: int
    """Image width in pixels."""
    height: int
    """Image height in pixels."""
    fx: float
    """Focal length along columns, in pixels per radian on the axis."""
    fy: float
    """Focal length along rows, in pixels per radian on the axis."""
    cx: float
    """Column of the optical axis."""
    cy: float
    """Row of the optical axis."""
    alpha: float
    """0 for a perspective image, larger the wider the lens, at most 1."""
    beta: float
    """How flat the surface is that the image is taken from; 1 for a sphere."""
    max_angle: float = np.pi
    """Largest angle off axis that the lens sees, in radians; the model's own limit where that is less."""
    _sphere: UnifiedSphere = field(init=False, repr=False, compare=False)
    _stretch: float = field(init=False, repr=False, compare=False)
    _limit: float = field(init=False, repr=False, compare=False)
    _max_radius: float = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        """Refuse parameters that describe no lens, and find how far it sees."""
        check_size(self.width, self.height)
        check_lens(self.fx, self.fy, (self.cx, self.cy, self.alpha, self.beta))
        check_angle(self.max_angle)
        if not self.beta > 0:
            raise ValueError(f"beta must be positive, got {self.beta}")
        sphere, stretch = UnifiedSphere(self.alpha), math.sqrt(self.beta)
        end = math.atan2(math.sin(sphere.max_angle) / stretch, math.cos(sphere.max_angle))
        limit = min(self.max_angle, end)
        on_sphere = math.atan2(stretch * math.sin(limit), math.cos(limit))
        object.__setattr__(self, "_sphere", sphere)
        object.__setattr__(self, "_stretch", stretch)
        object.__setattr__(self, "_limit", limit)
        object.__setattr__(self, "_max_radius", sphere.radius(on_sphere) / stretch)

    @property
    def period_px(self) -> float | None:
        """The image does not close around."""
        return None

    def project(self, points_camera: FloatArray) -> Projection:
        """Project points to pixels. See `CameraModel.project`."""
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            point = off_axis(np.asarray(points_camera, dtype=np.float64))
            across = point.right * point.right + point.down * point.down
            length = np.sqrt(self.beta * across + point.forward * point.forward)
            depth = self.alpha * length + (1 - self.alpha) * point.forward
            pixels = np.stack(
                [self.cx + self.fx * (point.right / depth), self.cy + self.fy * (point.down / depth)], axis=-1
            )
            valid = point.within(self._limit) & (length < np.inf)
        valid &= inside_image(pixels, self.width, self.height)
        blank_invalid(pixels, valid)
        return Projection(pixels, valid)

    def unproject(self, pixels: FloatArray) -> Rays:
        """Return the rays that pixels look along. See `CameraModel.unproject`."""
        pixels = np.asarray(pixels, dtype=np.float64)
        seen = np.where(inside_image(pixels, self.width, self.height)[..., None], pixels, np.nan)
        right, down = (seen[..., 0] - self.cx) / self.fx, (seen[..., 1] - self.cy) / self.fy
        squared = right * right + down * down
        valid = reaches(squared, self._max_radius)
        forward = self._sphere.forward(self.beta * squared)
        directions = np.stack([forward, -right, -down], axis=-1)
        directions /= np.sqrt(squared + forward * forward)[..., None]
        blank_invalid(directions, valid)
        return Rays(directions, np.zeros_like(directions), valid)

    def centers(self, points_camera: FloatArray) -> FloatArray:
        """Return the optical centre, the origin, for each point. See `CameraModel.centers`."""
        return np.zeros(np.shape(points_camera))
