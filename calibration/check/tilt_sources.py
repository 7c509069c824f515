"""What each source says of a camera's turn, and what they say together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.stats import chi2

from calibration.shelf.gravity_lines import Tilt
from palletloc.geometry import FloatArray
from palletloc.robust import huber_divisors, reweighted, robust_sigma

VERTICALS, LEVELS, FLOOR, PALLETS = "upright edges", "level edges", "floor lines", "pallets"
"""Names of the sources."""
_TOLD = 1 / float(np.radians(5.0)) ** 2
"""A source tells an axis that it knows to 5 degrees, in per square radian: what is worse is open."""
_ROUNDS = 14
"""Rounds of a robust fit before the last one: more than the weights need to settle."""


@dataclass(frozen=True, slots=True, eq=False)
class NamedTilt:
    """What one source says."""

    method: str
    """Its name."""
    tilt: Tilt
    """The tilt of what is seen against the stated mounting."""


@dataclass(frozen=True, slots=True)
class Absent:
    """A source that says nothing."""

    method: str
    """Its name."""
    why: str
    """In a few words."""


@dataclass(frozen=True, slots=True, eq=False)
class Contradiction:
    """Two sources that contradict each other."""

    first: str
    """Name of one."""
    second: str
    """Name of the other."""
    chance: float
    """How probable such a difference or a larger one is if both are right."""


@dataclass(frozen=True, slots=True, eq=False)
class FusedTilt:
    """What the sources say together."""

    turn: FloatArray
    """(2,) rotation of what is seen about the forklift's x and y axes, in radians."""
    covariance: FloatArray
    """(2, 2) of these."""
    chance: float
    """How probable such differences or larger ones are if all sources are right."""
    worst: Contradiction | None
    """The two that differ most for what they state; None where no two speak of the same axis."""


def fused_tilt(tilts: Sequence[NamedTilt]) -> FusedTilt:
    """Weigh sources by their information.

    Parameters
    ----------
    tilts : sequence of NamedTilt
        At least one; each may leave an axis open.

    Examples
    --------
    >>> one = NamedTilt("a", Tilt(np.array([0.0, 0.0]), np.diag([1e6, 1e6]), 9))
    >>> other = NamedTilt("b", Tilt(np.array([0.002, 0.0]), np.diag([1e6, 0.0]), 9))
    >>> fused_tilt([one, other]).turn.round(6).tolist()
    [0.001, 0.0]
    """
    information = np.sum([source.tilt.information for source in tilts], axis=0)
    covariance = _inverse(information)
    turn = covariance @ np.sum([source.tilt.information @ source.tilt.turn for source in tilts], axis=0)
    pairs = [_compared(first, second) for first, second in combinations(tilts, 2)]
    found = [pair for pair in pairs if pair is not None]
    square = sum(
        float((source.tilt.turn - turn) @ source.tilt.information @ (source.tilt.turn - turn)) for source in tilts
    )
    freedom = sum(_told(source.tilt.information) for source in tilts) - _told(information)
    chance = float(chi2.sf(square, freedom)) if freedom > 0 else 1.0
    return FusedTilt(turn, covariance, chance, min(found, key=lambda pair: pair.chance, default=None))


def _compared(first: NamedTilt, second: NamedTilt) -> Contradiction | None:
    """Compare two sources where both speak."""
    a, b = first.tilt.information, second.tilt.information
    both = a @ np.linalg.pinv(a + b, rcond=1e-9) @ b
    freedom = _told(both)
    if not freedom:
        return None
    off = second.tilt.turn - first.tilt.turn
    return Contradiction(first.method, second.method, float(chi2.sf(float(off @ both @ off), freedom)))


def _told(information: FloatArray) -> int:
    """Return about how many axes something is known."""
    return int((np.linalg.eigvalsh((information + information.T) / 2) > _TOLD).sum())


def _inverse(information: FloatArray) -> FloatArray:
    """Return the covariance; an axis that nothing tells gets a radian."""
    return np.asarray(np.linalg.inv(information + np.eye(2)))


def fit_with_prior(
    design: FloatArray, values: FloatArray, sigma: FloatArray, prior: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Fit unknowns to values, with Huber's weights; scatter beyond what is stated counts.

    Parameters
    ----------
    design : (n, k) array
        Derivatives of the values by the unknowns.
    values : (n,) array
        What is seen.
    sigma : (n,) array
        Standard deviations of it.
    prior : (k, k) array
        Information about the unknowns before, around 0; with the sights it must tell all of them.

    Returns
    -------
    solution : (k,) array
        The unknowns.
    information : (k, k) array
        About them: the inverse of their covariance.
    """

    def normal(divisors: FloatArray, scatter: float) -> tuple[FloatArray, FloatArray]:
        row = 1 / sigma / np.sqrt(divisors)
        weighted = (design * row[:, None] ** 2).T / scatter**2
        information = weighted @ design + prior
        return np.asarray(np.linalg.solve(information, weighted @ values), np.float64), information

    found = reweighted(
        lambda divisors, scatter: normal(divisors, scatter)[0],
        lambda solution: (values - design @ solution) / sigma,
        huber_divisors,
        lambda off: robust_sigma(off, 1.0),
        np.ones(len(values)),
        _ROUNDS,
    )
    return normal(found.weights, found.sigma)
