"""Perspective cameras with the radial and tangential distortion of Brown.

D. C. Brown, "Close-range camera calibration", Photogrammetric Engineering 37(8), 1971, with the
coefficients of OpenCV: k1, k2, p1, p2, k3, and those of its rational model: k4, k5, k6.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from palletloc.cameras.brown_distortion import BrownDistortion
from palletloc.cameras.lens import Lens
from palletloc.geometry import BoolArray, FloatArray


@dataclass(frozen=True, slots=True)
class PerspectiveLens(Lens):
    """What perspective cameras share: a distortion of the plane one focal length ahead.

    Points behind the camera are not seen, nor those so far off axis that the distortion would fold the
    image over.
    """

    _distortion: BrownDistortion = field(init=False, repr=False, compare=False)

    def _image(self, points: FloatArray) -> tuple[FloatArray, BoolArray]:
        forward = points[..., 0]
        right, down = points[..., 1] / -forward, points[..., 2] / -forward
        squared = right * right + down * down
        valid = (forward > 0) & (forward < np.inf) & (squared <= self._distortion.max_radius**2)
        right, down = self._distortion.apply(right, down, squared)
        pixels = np.empty((*points.shape[:-1], 2))
        pixels[..., 0] = self.cx + self.fx * right
        pixels[..., 1] = self.cy + self.fy * down
        return pixels, valid

    def _look(self, right: FloatArray, down: FloatArray) -> tuple[FloatArray, BoolArray]:
        right, down = self._distortion.invert(right, down)
        squared = right * right + down * down
        forward = 1 / np.sqrt(1 + squared)
        directions = np.stack([forward, -forward * right, -forward * down], axis=-1)
        return directions, squared <= self._distortion.max_radius**2


@dataclass(frozen=True, slots=True)
class Pinhole(PerspectiveLens):
    """A perspective camera.

    Points behind the camera are not seen, nor those so far off axis that the distortion would fold the
    image over.

    Examples
    --------
    >>> camera = Pinhole(640, 480, 500.0, 500.0, 319.5, 239.5)
    >>> camera.project(np.array([2.0, -0.2, 0.1])).pixels
    array([369.5, 214.5])
    """

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

    def __post_init__(self) -> None:
        """Refuse parameters that describe no lens."""
        coefficients = (self.k1, self.k2, self.p1, self.p2, self.k3)
        self._check(*coefficients)
        object.__setattr__(self, "_distortion", BrownDistortion(*coefficients))


@dataclass(frozen=True, slots=True)
class RationalPinhole(PerspectiveLens):
    """A perspective camera whose radial distortion is a quotient: OpenCV's rational model of eight numbers.

    A radius r on the plane becomes ``r (1 + k1 r^2 + k2 r^4 + k3 r^6) / (1 + k4 r^2 + k5 r^4 + k6 r^6)``.

    Examples
    --------
    >>> camera = RationalPinhole(640, 480, 500.0, 500.0, 319.5, 239.5, k1=1.0, k4=1.0)
    >>> camera.project(np.array([2.0, -0.2, 0.1])).pixels
    array([369.5, 214.5])
    """

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
    k4: float = 0.0
    """Coefficient of r^2 below the radial terms."""
    k5: float = 0.0
    """Coefficient of r^4 there."""
    k6: float = 0.0
    """Coefficient of r^6 there."""

    def __post_init__(self) -> None:
        """Refuse parameters that describe no lens."""
        coefficients = (self.k1, self.k2, self.p1, self.p2, self.k3, self.k4, self.k5, self.k6)
        self._check(*coefficients)
        object.__setattr__(self, "_distortion", BrownDistortion(*coefficients))
