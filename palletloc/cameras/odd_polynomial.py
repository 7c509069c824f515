"""The odd polynomials of radial distortion: x (1 + c1 x^2 + c2 x^4 + ...), and their inverse."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from palletloc.geometry import FloatArray

_MAX_STEPS = 100
"""Newton steps; where the bracket has to be halved each time, 60 exhaust the precision of a float64."""
_FAR = 2.0**32
"""No lens sees farther off axis, in radians or focal lengths; a root beyond is as good as none."""
_ROUNDING = 4 * float(np.finfo(np.float64).eps)
"""Relative size of what rounding leaves of a value."""


@dataclass(frozen=True, slots=True)
class OddPolynomial:
    """``x (1 + c1 x^2 + c2 x^4 + ...)``: radial distortion as a function of a radius or an angle."""

    coefficients: tuple[float, ...]
    """c1, c2, ..."""

    def factor(self, squared: FloatArray) -> FloatArray:
        """Return ``1 + c1 s + c2 s^2 + ...``: the polynomial over x, as a function of s = x^2."""
        return _horner(self.coefficients, squared)

    def slope(self, squared: FloatArray) -> FloatArray:
        """Return the derivative, as a function of s = x^2."""
        return _horner(self._slope_coefficients, squared)

    @property
    def _slope_coefficients(self) -> tuple[float, ...]:
        return tuple((2 * i + 3) * c for i, c in enumerate(self.coefficients))

    def increasing_until(self, margin: float = 0.0) -> float:
        """Return how far from zero the polynomial rises.

        Parameters
        ----------
        margin : float
            The slope and the factor must both exceed ``margin * x`` instead of zero.

        Returns
        -------
        float
            The smallest positive x where they no longer do; infinite where they always do.

        Examples
        --------
        >>> OddPolynomial((-1 / 3,)).increasing_until()
        1.0
        """
        return min(
            _first_root(coefficients, -margin) for coefficients in (self.coefficients, self._slope_coefficients)
        )

    def inverse(self, values: FloatArray, upper: float) -> FloatArray:
        """Invert the polynomial where it rises, by Newton's method kept inside a shrinking bracket.

        Parameters
        ----------
        values : (...) array
            Values of the polynomial, not negative.
        upper : float
            The polynomial rises from 0 to here; infinite if it always does.

        Returns
        -------
        (...) array
            The x in [0, upper]; NaN where there is none.
        """
        upper = min(upper, self._beyond(float(values.max(initial=0.0, where=np.isfinite(values))), upper))
        reach = upper * float(self.factor(np.asarray(upper * upper)))
        found = np.full(values.size, np.nan)
        unsettled = np.flatnonzero(values <= reach * (1 + _ROUNDING))
        target = values.reshape(-1)[unsettled]
        x, low, high = np.minimum(target, upper), np.zeros_like(target), np.full_like(target, upper)
        for _ in range(_MAX_STEPS):
            squared = x * x
            excess = x * self.factor(squared) - target
            low = np.where(excess < 0, x, low)
            high = np.where(excess > 0, x, high)
            with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
                trial = x - excess / self.slope(squared)
            trial = np.where((trial >= low) & (trial <= high), trial, (low + high) / 2)
            found[unsettled] = trial
            moving = np.abs(trial - x) > _ROUNDING * upper
            if not moving.any():
                break
            unsettled, target, x = unsettled[moving], target[moving], trial[moving]
            low, high = low[moving], high[moving]
        return found.reshape(values.shape)

    def _beyond(self, value: float, upper: float) -> float:
        """Return an x whose value exceeds the given one, or that exceeds the upper one."""
        x = 1.0
        while x < upper and x * float(self.factor(np.asarray(x * x))) < value and x < _FAR:
            x *= 2
        return x


def _horner(coefficients: tuple[float, ...], s: FloatArray) -> FloatArray:
    """Return 1 + c1 s + c2 s^2 + ..., without the terms at the end that are zero."""
    used = len(coefficients)
    while used and coefficients[used - 1] == 0.0:
        used -= 1
    if not used:
        return np.ones_like(s)
    value = s * coefficients[used - 1]
    for c in reversed(coefficients[: used - 1]):
        value += c
        value *= s
    value += 1.0
    return value


def _first_root(coefficients: tuple[float, ...], linear: float) -> float:
    """Return the first positive root of 1 + linear x + c1 x^2 + c2 x^4 + ...; infinite without one."""
    powers = np.zeros(2 * len(coefficients) + 2)
    powers[0] = 1.0
    powers[1] = linear
    powers[2::2] = coefficients
    return first_root(powers)


def first_root(powers: FloatArray) -> float:
    """Return the first positive root of a polynomial; infinite without one.

    Parameters
    ----------
    powers : (n,) array
        Its coefficients, that of the lowest power first, which is 1.

    Examples
    --------
    >>> round(first_root(np.array([1.0, 0.0, -0.25])), 9)
    2.0
    """
    # Lowest power first: these are the roots' inverses, found without dividing by a tiny coefficient.
    inverses = np.roots(powers)
    # A double root comes out as a pair with a small imaginary part.
    real = inverses.real[np.abs(inverses.imag) <= 1e-6 * np.abs(inverses)]
    largest = float(real.max(initial=0.0))
    return 1 / largest if largest > 1 / _FAR else math.inf
