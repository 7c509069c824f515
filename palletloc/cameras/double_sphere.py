"""Fisheye lenses by the double sphere model.

V. Usenko, N. Demmel, D. Cremers, "The double sphere camera model", 3DV 2018.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from palletloc.cameras.lens import Lens, UnifiedSphere, check_angle, off_axis, reaches, unified_depth
from palletloc.geometry import BoolArray, FloatArray


@dataclass(frozen=True, slots=True)
class DoubleSphere(Lens):
    """A fisheye; its focal lengths are ``1 + (1 - alpha) xi`` or so times the pixels per radian on the axis.

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
        self._check(self.xi, self.alpha)
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

    def _image(self, points: FloatArray) -> tuple[FloatArray, BoolArray]:
        point = off_axis(points)
        across = point.right * point.right + point.down * point.down
        forward = point.forward + self.xi * point.distance
        depth = unified_depth(self.alpha, np.sqrt(across + forward * forward), forward)
        pixels = [self.cx + self.fx * (point.right / depth), self.cy + self.fy * (point.down / depth)]
        return np.stack(pixels, axis=-1), point.within(self._limit)

    def _look(self, right: FloatArray, down: FloatArray) -> tuple[FloatArray, BoolArray]:
        squared = right * right + down * down
        second = self._sphere.forward(squared)
        length = squared + second * second
        # From the second centre along the ray to the first sphere.
        inside = np.maximum(second * second + (1 - self.xi**2) * squared, 0.0)
        reach = (self.xi * second + np.sqrt(inside)) / length
        directions = np.stack([reach * second - self.xi, -reach * right, -reach * down], axis=-1)
        directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
        return directions, reaches(squared, self._max_radius)
