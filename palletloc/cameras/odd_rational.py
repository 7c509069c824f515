"""Radial distortion as a quotient of polynomials: x (1 + c1 x^2 + ...) / (1 + d1 x^2 + ...)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.polynomial import Polynomial

from palletloc.cameras.odd_polynomial import OddPolynomial, first_root
from palletloc.geometry import FloatArray

_BEFORE_POLE = 1 - 1e-9
"""A part of the way to a pole, where the quotient is still finite: so far off axis no lens sees."""


@dataclass(frozen=True, slots=True)
class OddRational(OddPolynomial):
    """``x (1 + c1 x^2 + c2 x^4 + ...) / (1 + d1 x^2 + d2 x^4 + ...)``, with the uses of an `OddPolynomial`."""

    divisor: tuple[float, ...]
    """d1, d2, ..."""

    def factor(self, squared: FloatArray) -> FloatArray:
        """Return the quotient over x, as a function of s = x^2."""
        quotient: FloatArray = OddPolynomial(self.coefficients).factor(squared)
        quotient /= OddPolynomial(self.divisor).factor(squared)
        return quotient

    def slope(self, squared: FloatArray) -> FloatArray:
        """Return the derivative, as a function of s = x^2."""
        above, below = OddPolynomial(self.coefficients), OddPolynomial(self.divisor)
        value, under = above.factor(squared), below.factor(squared)
        # The derivative of x N / D is N / D + (x N' D - x N D') / D^2, and x N' is (x N)' - N.
        rise = (above.slope(squared) - value) * under - value * (below.slope(squared) - under)
        rise += value * under
        rise /= under * under
        return rise

    def increasing_until(self, margin: float = 0.0) -> float:
        """Return how far from zero the quotient rises; see `OddPolynomial.increasing_until`.

        Examples
        --------
        >>> round(OddRational((), (1.0,)).increasing_until(), 6)
        1.0
        """
        above, below = (_in_x(coefficients) for coefficients in (self.coefficients, self.divisor))
        x = Polynomial([0.0, 1.0])
        rise = above * below + x * (above.deriv() * below - above * below.deriv())
        conditions = (below, above - margin * x * below, rise - margin * x * below * below)
        return (
            min(first_root(np.asarray(condition.coef, dtype=np.float64)) for condition in conditions) * _BEFORE_POLE
        )


def _in_x(coefficients: tuple[float, ...]) -> Polynomial:
    """Return 1 + c1 x^2 + c2 x^4 + ... as a polynomial of x."""
    powers = [1.0]
    for coefficient in coefficients:
        powers += [0.0, coefficient]
    return Polynomial(powers)
