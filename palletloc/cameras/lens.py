"""What cameras with one lens share: their fields, their frame, and the step that the unified models have in common.

With ``d`` the length of a vector and ``z`` its part along the axis, a point across the axis divided by
``alpha d + (1 - alpha) z`` is its image: a perspective one for alpha = 0, a parallel one for alpha = 1. Mei's
model has alpha = xi / (1 + xi); those of Khomutenko (EUCM) and of Usenko (double sphere) change the vector before.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from palletloc.cameras.image_area import blank_invalid, check_size, inside_image
from palletloc.cameras.protocol import Projection, Rays
from palletloc.geometry import BoolArray, FloatArray

_ROUNDING = 1e-12
"""Relative, of a squared radius: what rounding adds to that of a ray at the rim."""


@dataclass(frozen=True, slots=True)
class Lens(ABC):
    """A camera with one centre whose optical axis is its x, with the image's right at -y and its down at -z."""

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

    def _check(self, *others: float) -> None:
        """Refuse an image without pixels, focal lengths that are not positive, and numbers that are not finite."""
        check_size(self.width, self.height)
        if not (0 < self.fx < math.inf and 0 < self.fy < math.inf):
            raise ValueError(f"focal lengths must be positive, in pixels, got fx {self.fx}, fy {self.fy}")
        numbers = (self.cx, self.cy, *others)
        if not all(math.isfinite(number) for number in numbers):
            raise ValueError(f"lens parameters must be finite numbers, got {numbers}")

    @property
    def period_px(self) -> float | None:
        """The image does not close around."""
        return None

    def project(self, points_camera: FloatArray) -> Projection:
        """Project points to pixels. See `CameraModel.project`."""
        points = np.asarray(points_camera, dtype=np.float64)
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            pixels, valid = self._image(points)
        valid &= inside_image(pixels, self.width, self.height)
        blank_invalid(pixels, valid)
        return Projection(pixels, valid)

    def unproject(self, pixels: FloatArray) -> Rays:
        """Return the rays that pixels look along. See `CameraModel.unproject`."""
        pixels = np.asarray(pixels, dtype=np.float64)
        seen = np.where(inside_image(pixels, self.width, self.height)[..., None], pixels, np.nan)
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            directions, valid = self._look((seen[..., 0] - self.cx) / self.fx, (seen[..., 1] - self.cy) / self.fy)
        blank_invalid(directions, valid)
        return Rays(directions, np.zeros_like(directions), valid)

    def centers(self, points_camera: FloatArray) -> FloatArray:
        """Return the optical centre, the origin, for each point. See `CameraModel.centers`."""
        return np.zeros(np.shape(points_camera))

    @abstractmethod
    def _image(self, points: FloatArray) -> tuple[FloatArray, BoolArray]:
        """Return the pixels of points, (..., 2), on the image or off it, and which points the lens sees."""

    @abstractmethod
    def _look(self, right: FloatArray, down: FloatArray) -> tuple[FloatArray, BoolArray]:
        """Return the unit rays, (..., 3), of points on the plane one focal length ahead, and which of them exist."""


def check_angle(max_angle: float) -> None:
    """Refuse a largest angle off axis that is none.

    Raises
    ------
    ValueError
        If it is not in (0, pi].
    """
    if not 0 < max_angle <= math.pi:
        raise ValueError(f"max_angle must be in (0, pi] radians, got {max_angle}")


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


def unified_depth(alpha: float, length: FloatArray, forward: FloatArray) -> FloatArray:
    """Return what the part of vectors across the axis is divided by in the unified models.

    Parameters
    ----------
    alpha : float
        Between 0 and 1.
    length : (...) array
        Of the vectors.
    forward : (...) array
        Their parts along the axis.
    """
    return alpha * length + (1 - alpha) * forward


@dataclass(frozen=True, slots=True)
class UnifiedSphere:
    """The step from the unit sphere to a plane, through a point on the axis, for one alpha."""

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
