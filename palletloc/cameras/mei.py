"""Catadioptric and fisheye cameras by the unified model with Brown's distortion.

C. Mei, P. Rives, "Single view point omnidirectional camera calibration from planar grids", ICRA 2007, with the
coefficients of OpenCV's module omnidir and of Kalibr's omni-radtan: xi, k1, k2, p1, p2.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from palletloc.cameras.brown_distortion import BrownDistortion
from palletloc.cameras.lens import Lens, UnifiedSphere, check_angle, off_axis, reaches
from palletloc.geometry import BoolArray, FloatArray


@dataclass(frozen=True, slots=True)
class Mei(Lens):
    """A camera whose focal lengths are ``1 + xi`` times the pixels per radian on the axis.

    A point on the unit sphere is seen from a centre ``xi`` behind, and its perspective image is distorted.

    Raises
    ------
    ValueError
        If the numbers describe no lens.

    Examples
    --------
    >>> camera = Mei(1000, 1000, 400.0, 400.0, 499.5, 499.5, xi=1.0)
    >>> camera.project(np.array([0.0, -1.0, 0.0])).pixels
    array([899.5, 499.5])
    """

    xi: float
    """How far behind the sphere's centre the second centre lies, in radii; not negative."""
    k1: float = 0.0
    """Radial coefficient of r^2."""
    k2: float = 0.0
    """Radial coefficient of r^4."""
    p1: float = 0.0
    """Tangential coefficient along rows."""
    p2: float = 0.0
    """Tangential coefficient along columns."""
    max_angle: float = np.pi
    """Largest angle off axis that the lens sees, in radians; the model's own limit where that is less."""
    _sphere: UnifiedSphere = field(init=False, repr=False, compare=False)
    _distortion: BrownDistortion = field(init=False, repr=False, compare=False)
    _limit: float = field(init=False, repr=False, compare=False)
    _max_radius: float = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        """Refuse parameters that describe no lens, and find how far it sees."""
        coefficients = (self.k1, self.k2, self.p1, self.p2)
        self._check(self.xi, *coefficients)
        check_angle(self.max_angle)
        if self.xi < 0:
            raise ValueError(f"xi must not be negative, got {self.xi}")
        sphere, distortion = UnifiedSphere(self.xi / (1 + self.xi)), BrownDistortion(*coefficients)
        limit = min(self.max_angle, sphere.max_angle)
        object.__setattr__(self, "_sphere", sphere)
        object.__setattr__(self, "_distortion", distortion)
        object.__setattr__(self, "_limit", limit)
        object.__setattr__(self, "_max_radius", min(sphere.radius(limit) / (1 + self.xi), distortion.max_radius))

    def _image(self, points: FloatArray) -> tuple[FloatArray, BoolArray]:
        point = off_axis(points)
        depth = point.forward + self.xi * point.distance
        right, down = point.right / depth, point.down / depth
        squared = right * right + down * down
        valid = point.within(self._limit) & (squared <= self._max_radius**2)
        right, down = self._distortion.apply(right, down, squared)
        return np.stack([self.cx + self.fx * right, self.cy + self.fy * down], axis=-1), valid

    def _look(self, right: FloatArray, down: FloatArray) -> tuple[FloatArray, BoolArray]:
        right, down = self._distortion.invert(right, down)
        squared = right * right + down * down
        valid = reaches(squared, self._max_radius)
        right, down = (1 + self.xi) * right, (1 + self.xi) * down
        forward = self._sphere.forward((1 + self.xi) ** 2 * squared)
        directions = np.stack([forward, -right, -down], axis=-1)
        directions /= np.sqrt(right * right + down * down + forward * forward)[..., None]
        return directions, valid
