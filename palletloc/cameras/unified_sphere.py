"""The step that the unified models share: from the unit sphere to a plane, through a point on the axis.

With ``d`` the length of a vector and ``z`` its part along the axis, a point across the axis divided by
``alpha d + (1 - alpha) z`` is its image: a perspective one for alpha = 0, a parallel one for alpha = 1. Mei's
model has alpha = xi / (1 + xi); those of Khomutenko (EUCM) and of Usenko (double sphere) change the vector before.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from palletloc.geometry import BoolArray, FloatArray

_ROUNDING = 1e-12


class OffAxis(NamedTuple):
    """Points by their place against an optical axis."""

    right: FloatArray
    """(...) in metres."""
    down: FloatArray
    """(...) in metres."""
    forward: FloatArray
    """(...) in metres."""
    distance: FloatArray
    """(...) from the centre, in metres."""

    def within(self, max_angle: float) -> BoolArray:
        """Return which points are at most so far off axis, and neither the centre nor infinitely far away."""
        cosine = np.cos(max_angle)
        valid: BoolArray = (self.distance > 0) & (self.distance < np.inf)
        valid &= self.forward >= cosine * self.distance
        return valid


def off_axis(points_camera: FloatArray) -> OffAxis:
    """Return points of the camera frame, (..., 3), against its optical axis x."""
    forward, left, up = points_camera[..., 0], points_camera[..., 1], points_camera[..., 2]
    return OffAxis(-left, -up, forward, np.sqrt(forward * forward + left * left + up * up))


@dataclass(frozen=True, slots=True)
class UnifiedSphere:
    """The step for one alpha."""

    alpha: float
    """Between 0 and 1."""
    max_angle: float = field(init=False, compare=False)
    """Where the image folds or becomes infinite, in radians off axis."""

    def __post_init__(self) -> None:
        """Find where the image ends.

        Raises
        ------
        ValueError
            If alpha is not between 0 and 1.
        """
        if not 0 <= self.alpha <= 1:
            raise ValueError(f"alpha must be between 0 and 1, got {self.alpha}")
        least, most = sorted((self.alpha, 1 - self.alpha))
        object.__setattr__(self, "max_angle", float(np.arccos(-least / most)))

    def radius(self, angle: float) -> float:
        """Return the radius in the plane at an angle off axis; infinite where it has none."""
        depth = self.alpha + (1 - self.alpha) * np.cos(angle)
        return float(np.sin(angle) / depth) if depth > _ROUNDING else np.inf

    def forward(self, squared: FloatArray) -> FloatArray:
        """Return ``z``, the part along the axis of the vector whose part across is a point of the plane.

        Parameters
        ----------
        squared : (...) array
            Squared radius in the plane; beyond the fold the fold's own is taken.
        """
        root = np.sqrt(np.maximum(1 - (2 * self.alpha - 1) * squared, 0.0))
        along: FloatArray = (1 - self.alpha**2 * squared) / (self.alpha * root + 1 - self.alpha)
        return along


def reaches(squared: FloatArray, max_radius: float) -> BoolArray:
    """Return which squared radii lie within a largest one, up to rounding; NaN does not."""
    within: BoolArray = squared <= max_radius**2 * (1 + _ROUNDING)
    return within
