"""Fisheye lenses by a polynomial of the angle off axis, also beyond 90 degrees.

J. Kannala, S. Brandt, "A generic camera model and calibration method for conventional, wide-angle, and
fish-eye lenses", IEEE TPAMI 28(8), 2006: its radially symmetric part, with the coefficients of OpenCV.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from palletloc.cameras.lens import Lens, check_angle
from palletloc.cameras.odd_polynomial import OddPolynomial
from palletloc.geometry import BoolArray, FloatArray


@dataclass(frozen=True, slots=True)
class KannalaBrandt(Lens):
    """A fisheye; its focal lengths are the pixels per radian on the axis.

    A point at the angle theta off axis appears at the radius
    ``theta (1 + k1 theta^2 + k2 theta^4 + k3 theta^6 + k4 theta^8)`` times the focal length.

    Raises
    ------
    ValueError
        If `max_angle` is not in (0, pi] or lies where the radius no longer grows with the angle.

    Examples
    --------
    >>> lens = KannalaBrandt(1000, 1000, 250.0, 250.0, 499.5, 499.5, max_angle=np.radians(100))
    >>> lens.project(np.array([0.0, -1.0, 0.0])).pixels.round(1)
    array([892.2, 499.5])
    """

    k1: float = 0.0
    """Coefficient of theta^3."""
    k2: float = 0.0
    """Coefficient of theta^5."""
    k3: float = 0.0
    """Coefficient of theta^7."""
    k4: float = 0.0
    """Coefficient of theta^9."""
    max_angle: float = np.pi / 2
    """Largest angle off axis that the lens sees, in radians."""
    _radius: OddPolynomial = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        """Refuse parameters that describe no lens."""
        coefficients = (self.k1, self.k2, self.k3, self.k4)
        self._check(*coefficients, self.max_angle)
        check_angle(self.max_angle)
        radius = OddPolynomial(coefficients)
        end = radius.increasing_until()
        if end <= self.max_angle:
            raise ValueError(
                f"max_angle is {self.max_angle:.4f} rad, but the radius stops growing at {end:.4f} rad "
                f"for k1..k4 = {coefficients}"
            )
        object.__setattr__(self, "_radius", radius)

    def _image(self, points: FloatArray) -> tuple[FloatArray, BoolArray]:
        forward, left, up = points[..., 0], points[..., 1], points[..., 2]
        across = np.sqrt(left * left + up * up)
        angle = np.arctan2(across, forward)
        # Straight behind, and at the origin, every direction across is as good as any other.
        valid = (angle <= self.max_angle) & ((across > 0) | (forward > 0)) & np.isfinite(forward)
        scale = self._radius.factor(angle * angle)
        scale *= angle / np.maximum(across, np.finfo(np.float64).tiny)
        pixels = np.empty((*points.shape[:-1], 2))
        pixels[..., 0] = self.cx - self.fx * scale * left
        pixels[..., 1] = self.cy - self.fy * scale * up
        return pixels, valid

    def _look(self, right: FloatArray, down: FloatArray) -> tuple[FloatArray, BoolArray]:
        radius = np.sqrt(right * right + down * down)
        angle = self._radius.inverse(radius, self.max_angle)
        across = np.sin(angle) / np.maximum(radius, np.finfo(np.float64).tiny)
        directions = np.stack([np.cos(angle), -across * right, -across * down], axis=-1)
        return directions, np.isfinite(angle)
