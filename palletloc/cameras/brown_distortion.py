"""The lens distortion of Brown on the plane one focal length ahead, and its inverse.

D. C. Brown, "Close-range camera calibration", Photogrammetric Engineering 37(8), 1971, with the
coefficients of OpenCV: k1, k2, p1, p2, k3, and k4, k5, k6, by whose polynomial the radial one is divided.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from palletloc.cameras.odd_polynomial import OddPolynomial
from palletloc.cameras.odd_rational import OddRational
from palletloc.geometry import FloatArray

_MAX_STEPS = 40
"""Newton steps, halved ones among them: four to six are usual, more are needed only near the fold."""
_BLOCK = 2**14
"""Points inverted at a time, to stay in the CPU's cache."""
_CONVERGED = 1e-12
"""A distance to the target on the plane, relative to its radius, up to which a point counts as inverted."""
_ROUNDING = 1e-13
"""The same distance below which steps only repeat what rounding does."""


@dataclass(frozen=True, slots=True)
class BrownDistortion:
    """Radial and tangential distortion, one to one up to a radius."""

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
    max_radius: float = field(init=False, compare=False)
    """How far out no two points coincide; infinite where none ever do."""
    _radius: OddPolynomial = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        """Find how far out the distortion is one to one."""
        above, below = (self.k1, self.k2, self.k3), (self.k4, self.k5, self.k6)
        radius = OddRational(above, below) if any(below) else OddPolynomial(above)
        # The distortion's derivative is symmetric, with the radial factor and slope as eigenvalues; the
        # tangential part moves them by at most 6 |p| r. While they stay positive, no two points coincide.
        margin = 6 * float(np.hypot(self.p1, self.p2))
        object.__setattr__(self, "_radius", radius)
        object.__setattr__(self, "max_radius", radius.increasing_until(margin))

    def apply(self, right: FloatArray, down: FloatArray, squared: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Distort points on the plane one focal length ahead, given with their squared radius."""
        factor = self._radius.factor(squared)
        if not (self.p1 or self.p2):
            return right * factor, down * factor
        factor += 2 * (self.p2 * right + self.p1 * down)
        return right * factor + self.p2 * squared, down * factor + self.p1 * squared

    def invert(self, right: FloatArray, down: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Invert `apply`, NaN where there is no inverse: radially, then with the tangential terms."""
        radius = np.sqrt(right * right + down * down)
        start = self._radius.inverse(radius, self.max_radius)
        if self.p1 or self.p2:
            start = np.where(np.isnan(start), self.max_radius, start)
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
            better = (trial_error < error[moving]) & (_squared(trial) <= self.max_radius**2)
            part[moving] = np.where(better, 1.0, part[moving] / 2)
            moving = moving[better]
            ahead[:, moving], residual[:, moving] = trial[:, better], trial_residual[:, better]
            error[moving] = trial_error[better]
        return np.where(error <= _CONVERGED**2 * limit, ahead, np.nan)

    def _residual(self, ahead: FloatArray, target: FloatArray) -> FloatArray:
        """Return how far (2, n) points, distorted, lie from where they should."""
        return np.stack(self.apply(ahead[0], ahead[1], _squared(ahead))) - target

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
