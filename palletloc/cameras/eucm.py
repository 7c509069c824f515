"""Fisheye lenses by the enhanced unified camera model.

B. Khomutenko, G. Garcia, P. Martinet, "An enhanced unified camera model", IEEE RA-L 1(1), 2016.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from palletloc.cameras.lens import Lens, UnifiedSphere, check_angle, off_axis, reaches, unified_depth
from palletloc.geometry import BoolArray, FloatArray


@dataclass(frozen=True, slots=True)
class Eucm(Lens):
    """A fisheye; its focal lengths are the pixels per radian on the axis.

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
        self._check(self.alpha, self.beta)
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

    def _image(self, points: FloatArray) -> tuple[FloatArray, BoolArray]:
        point = off_axis(points)
        across = point.right * point.right + point.down * point.down
        length = np.sqrt(self.beta * across + point.forward * point.forward)
        depth = unified_depth(self.alpha, length, point.forward)
        pixels = [self.cx + self.fx * (point.right / depth), self.cy + self.fy * (point.down / depth)]
        return np.stack(pixels, axis=-1), point.within(self._limit) & (length < np.inf)

    def _look(self, right: FloatArray, down: FloatArray) -> tuple[FloatArray, BoolArray]:
        squared = right * right + down * down
        forward = self._sphere.forward(self.beta * squared)
        directions = np.stack([forward, -right, -down], axis=-1)
        directions /= np.sqrt(squared + forward * forward)[..., None]
        return directions, reaches(squared, self._max_radius)
