"""Perspective cameras with the radial and tangential distortion of Brown.

D. C. Brown, "Close-range camera calibration", Photogrammetric Engineering 37(8), 1971, with the
coefficients of OpenCV: k1, k2, p1, p2, k3.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from palletloc.cameras.image_area import blank_invalid, check_lens, check_size, inside_image
from palletloc.cameras.odd_polynomial import OddPolynomial
from palletloc.cameras.protocol import Projection, Rays
from palletloc.geometry import FloatArray

_MAX_STEPS = 40
# Points inverted at a time, to stay in the CPU's cache.
_BLOCK = 2**14
_CONVERGED = 1e-12
_ROUNDING = 1e-13


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
    _radius: OddPolynomial = field(init=False, repr=False, compare=False)
    _max_radius: float = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        """Refuse parameters that describe no lens, and find how far out the distortion is one to one."""
        check_size(self.width, self.height)
        check_lens(self.fx, self.fy, (self.cx, self.cy, self.k1, self.k2, self.p1, self.p2, self.k3))
        radius = OddPolynomial((self.k1, self.k2, self.k3))
        # The distortion's derivative is symmetric, with the radial factor and slope as eigenvalues; the
        # tangential part moves them by at most 6 |p| r. While they stay positive, no two points coincide.
        margin = 6 * float(np.hypot(self.p1, self.p2))
        object.__setattr__(self, "_radius", radius)
        object.__setattr__(self, "_max_radius", radius.increasing_until(margin))

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
            valid = (forward > 0) & (forward < np.inf) & (squared <= self._max_radius**2)
            pixels = np.empty((*points.shape[:-1], 2))
            distorted_right, distorted_down = self._distort(right, down, squared)
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
            right, down = self._undistort((seen[..., 0] - self.cx) / self.fx, (seen[..., 1] - self.cy) / self.fy)
            squared = right * right + down * down
            valid = squared <= self._max_radius**2
            forward = 1 / np.sqrt(1 + squared)
            directions = np.stack([forward, -forward * right, -forward * down], axis=-1)
        blank_invalid(directions, valid)
        return Rays(directions, np.zeros_like(directions), valid)

    def centers(self, points_camera: FloatArray) -> FloatArray:
        """Return the optical centre, the origin, for each point. See `CameraModel.centers`."""
        return np.zeros(np.shape(points_camera))

    def _distort(self, right: FloatArray, down: FloatArray, squared: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Distort points on the plane one focal length ahead, given with their squared radius."""
        factor = self._radius.factor(squared)
        if not (self.p1 or self.p2):
            return right * factor, down * factor
        factor += 2 * (self.p2 * right + self.p1 * down)
        return right * factor + self.p2 * squared, down * factor + self.p1 * squared

    def _undistort(self, right: FloatArray, down: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Invert `_distort`, NaN where there is no inverse: radially, then with the tangential terms."""
        radius = np.sqrt(right * right + down * down)
        start = self._radius.inverse(radius, self._max_radius)
        if self.p1 or self.p2:
            start = np.where(np.isnan(start), self._max_radius, start)
        scale = np.where(radius > 0, start / np.where(radius > 0, radius, 1.0), 1.0)
        if not (self.p1 or self.p2):
            return right * scale, down * scale
        target = np.stack([right, down]).reshape(2, -1)
        ahead = target * scale.reshape(-1)
        for first in range(0, target.shape[1], _BLOCK):
            block = np.s_[:, first : first + _BLOCK]
            ahead[block] = self._descend(ahead[block], target[block])
        return ahead[0].reshape(right.shape), ahead[1].reshape(right.shape)

    def _descend(self, ahead: FloatArray, target: FloatArray) -> FloatArray:
        """Find the (2, n) points that distort to the target by Newton steps, each halved until it helps."""
        limit = 1 + _squared(target)
        part = np.ones_like(limit)
        residual = self._residual(ahead, target)
        error = _squared(residual)
        for _ in range(_MAX_STEPS):
            moving = np.flatnonzero(error > _ROUNDING**2 * limit)
            if not moving.size:
                break
            trial = ahead[:, moving] - part[moving] * self._newton_step(ahead[:, moving], residual[:, moving])
            trial_residual = self._residual(trial, target[:, moving])
            trial_error = _squared(trial_residual)
            better = (trial_error < error[moving]) & (_squared(trial) <= self._max_radius**2)
            part[moving] = np.where(better, 1.0, part[moving] / 2)
            moving = moving[better]
            ahead[:, moving], residual[:, moving] = trial[:, better], trial_residual[:, better]
            error[moving] = trial_error[better]
        return np.where(error <= _CONVERGED**2 * limit, ahead, np.nan)

    def _residual(self, ahead: FloatArray, target: FloatArray) -> FloatArray:
        """Return how far (2, n) points, distorted, lie from where they should."""
        return np.stack(self._distort(ahead[0], ahead[1], _squared(ahead))) - target

    def _newton_step(self, ahead: FloatArray, residual: FloatArray) -> FloatArray:
        """Solve the distortion's derivative, a symmetric 2 x 2 matrix per point, for a residual."""
        x, y = ahead
        squared = _squared(ahead)
        factor = self._radius.factor(squared)
        bend = (self._radius.slope(squared) - factor) / np.where(squared > 0, squared, 1.0)
        level = factor + 2 * (self.p2 * x + self.p1 * y)
        xx = level + bend * x * x + 4 * self.p2 * x
        yy = level + bend * y * y + 4 * self.p1 * y
        xy = bend * x * y + 2 * (self.p1 * x + self.p2 * y)
        right, down = residual
        determinant = xx * yy - xy * xy
        return np.stack([(yy * right - xy * down) / determinant, (xx * down - xy * right) / determinant])


def _squared(vectors: FloatArray) -> FloatArray:
    """Return the squared lengths of (2, ...) vectors."""
    squared: FloatArray = vectors[0] ** 2 + vectors[1] ** 2
    return squared
