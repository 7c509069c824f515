"""Fisheye lenses by the double sphere model.

V. Usenko, N. Demmel, D. Cremers, "The double sphere camera model", 3DV 2018.
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
class DoubleSphere:
    """A camera whose optical axis is its x, with the image's right at -y and its down at -z.

    A point is put on a unit sphere, seen from ``xi`` behind its centre, put on a second unit sphere, and imaged
    as in the unified model.

    Raises
    ------
    ValueError
        If the numbers describe no lens.

    Examples
    --------
    >>> camera = DoubleSphere(1000, 1000, 300.0, 300.0, 499.5, 499.5, xi=0.0, alpha=0.6)
    >>> camera.project(np.array([0.0, -1.0, 0.0])).pixels
    array([999.5, 499.5])
    """

    width: int
    """Image width in pixels."""
    height: int
    """Image height in pixels."""
    fx: float
    """Focal length along columns, in pixels; ``1 + (1 - alpha) xi`` or so times the pixels per radian."""
    fy: float
    """The same along rows."""
    cx: float
    """Column of the optical axis."""
    cy: float
    """Row of the optical axis."""
    xi: float
    """How far the two spheres' centres are apart, in radii; above -1."""
    alpha: float
    """0 for a perspective image of the second sphere, larger the wider the lens, at most 1."""
    max_angle: float = np.pi
    """Largest angle off axis that the lens sees, in radians; the model's own limit where that is less."""
    _sphere: UnifiedSphere = field(init=False, repr=False, compare=False)
    _limit: float = field(init=False, repr=False, compare=False)
    _max_radius: float = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        """Refuse parameters that describe no lens, and find how far it sees."""
        check_size(self.width, self.height)
        check_lens(self.fx, self.fy, (self.cx, self.cy, self.xi, self.alpha))
        check_angle(self.max_angle)
        if not self.xi > -1:
            raise ValueError(f"xi must be above -1, got {self.xi}")
        sphere = UnifiedSphere(self.alpha)
        limit = min(self.max_angle, self._end(sphere.max_angle))
        on_second = math.atan2(math.sin(limit), math.cos(limit) + self.xi)
        object.__setattr__(self, "_sphere", sphere)
        object.__setattr__(self, "_limit", limit)
        object.__setattr__(self, "_max_radius", sphere.radius(on_second))

    def _end(self, on_second: float) -> float:
        """Return the angle off axis at which the second sphere's own limit, or the first one's rim, is reached."""
        if self.xi > 1 and on_second >= math.asin(1 / self.xi):
            return math.acos(-1 / self.xi)
        return on_second + math.asin(self.xi * math.sin(on_second))

    @property
    def period_px(self) -> float | None:
        """The image does not close around."""
        return None

    def project(self, points_camera: FloatArray) -> Projection:
        """Project points to pixels. See `CameraModel.project`."""
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            point = off_axis(np.asarray(points_camera, dtype=np.float64))
            across = point.right * point.right + point.down * point.down
            forward = point.forward + self.xi * point.distance
            depth = self.alpha * np.sqrt(across + forward * forward) + (1 - self.alpha) * forward
            pixels = np.stack(
                [self.cx + self.fx * (point.right / depth), self.cy + self.fy * (point.down / depth)], axis=-1
            )
            valid = point.within(self._limit)
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
        second = self._sphere.forward(squared)
        length = squared + second * second
        # From the second centre along the ray to the first sphere.
        inside = np.maximum(second * second + (1 - self.xi**2) * squared, 0.0)
        reach = (self.xi * second + np.sqrt(inside)) / length
        directions = np.stack([reach * second - self.xi, -reach * right, -reach * down], axis=-1)
        directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
        blank_invalid(directions, valid)
        return Rays(directions, np.zeros_like(directions), valid)

    def centers(self, points_camera: FloatArray) -> FloatArray:
        """Return the optical centre, the origin, for each point. See `CameraModel.centers`."""
        return np.zeros(np.shape(points_camera))
