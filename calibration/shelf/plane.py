"""A shelf's front plane as several methods see it, and what they say together."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from scipy.stats import chi2

from palletloc.geometry import FloatArray, wrap_angle
from palletloc.robust import huber_divisors
from palletloc.shelf import ShelfPlane

CHANCE = 0.0027
"""Two methods disagree where they differ by more than this leaves to chance: three standard deviations."""


@dataclass(frozen=True, slots=True, eq=False)
class Foot:
    """The point that planes are described from: there distance and heading hardly correlate."""

    point: FloatArray
    """(2,) a place of the camera, in odom, in metres."""
    yaw: float
    """Heading about into the shelf, in radians."""

    def plane(self, turn: float, distance: float) -> ShelfPlane:
        """Return the plane at a distance from the point, turned against the heading."""
        yaw = self.yaw + turn
        x, y = self.point + distance * np.array([np.cos(yaw), np.sin(yaw)])
        return ShelfPlane(float(x), float(y), float(wrap_angle(yaw + np.pi)))

    def described(self, plane: ShelfPlane) -> tuple[float, float]:
        """Return a plane's turn and distance: the inverse of `plane`, whatever point of it is given.

        Examples
        --------
        >>> foot = Foot(np.zeros(2), 0.0)
        >>> foot.described(ShelfPlane(2.0, 7.0, np.pi))
        (0.0, 2.0)
        """
        turn = float(wrap_angle(plane.yaw - self.yaw))
        into = np.array([np.cos(plane.yaw), np.sin(plane.yaw)])
        return turn, float((np.array([plane.x, plane.y]) - self.point) @ into)

    def local(self, points: FloatArray) -> FloatArray:
        """Return points, (n, 2) in odom, as places along the shelf (to the right) and depths into it."""
        into = np.array([np.cos(self.yaw), np.sin(self.yaw)])
        right = np.array([into[1], -into[0]])
        return np.asarray((points - self.point) @ np.stack([right, into], axis=1))


@dataclass(frozen=True, slots=True, eq=False)
class PlaneEstimate:
    """What one method says of the plane."""

    method: str
    """Its name."""
    turn: float
    """Heading into the shelf against the foot's, in radians."""
    distance: float
    """From the foot's point to the plane, in metres; NaN where the method gives only the heading."""
    information: FloatArray
    """(2, 2) inverse covariance of turn and distance, in 1/rad and 1/m; singular where it leaves one open."""
    evidence: str
    """What it is based on, in words."""

    @property
    def sigma(self) -> tuple[float, float]:
        """Standard deviations of turn and distance, each with the other one free; infinite where left open."""
        inverse = inverse_of(self.information)
        return float(np.sqrt(inverse[0, 0])), float(np.sqrt(inverse[1, 1]))

    def apart(self, depth: float) -> PlaneEstimate:
        """Return what it says of a parallel plane before or behind it: `depth` metres off, as standard deviation."""
        if not self.information[1, 1] > 0:
            return self
        information = np.linalg.inv(np.linalg.inv(self.information) + np.diag([0.0, depth**2]))
        return replace(self, information=np.asarray(information))


@dataclass(frozen=True, slots=True, eq=False)
class Disagreement:
    """Two methods that contradict each other."""

    first: str
    """Name of one."""
    second: str
    """Name of the other."""
    chance: float
    """How probable such a difference or a larger one is if both are right."""
    turn: float
    """Second minus first, in radians."""
    distance: float
    """Second minus first, in metres; NaN where one of them gives none."""


@dataclass(frozen=True, slots=True, eq=False)
class FusedPlane:
    """What they say together."""

    turn: float
    """Heading into the shelf against the foot's, in radians."""
    distance: float
    """From the foot's point, in metres."""
    covariance: FloatArray
    """(2, 2) of turn and distance."""
    chance: float
    """How probable such differences or larger ones are if all methods are right."""
    disagreement: Disagreement | None
    """The two that contradict each other most; None where all are consistent."""


def inverse_of(information: FloatArray) -> FloatArray:
    """Return the covariance that belongs to an information matrix; infinite where it leaves a value open."""
    scale = np.sqrt(np.maximum(np.diag(information), 1e-300))
    known = np.diag(information) > 1e-9
    covariance = np.full((2, 2), 0.0)
    covariance[~known, ~known] = np.inf
    if known.all():
        normed = information / np.outer(scale, scale)
        if np.linalg.cond(normed) > 1e12:
            return np.full((2, 2), np.inf)
        return np.asarray(np.linalg.inv(normed) / np.outer(scale, scale))
    i = int(np.flatnonzero(known)[0]) if known.any() else 0
    covariance[i, i] = 1 / information[i, i] if known.any() else np.inf
    return covariance


def fuse(estimates: Sequence[PlaneEstimate], common: FloatArray | None = None) -> FusedPlane | None:
    """Weigh several methods by their information.

    Parameters
    ----------
    estimates : sequence of PlaneEstimate
        At least one.
    common : (2, 2) array, optional
        Covariance of what is wrong in all of them alike, as the camera's mounting is.

    Returns
    -------
    FusedPlane or None
        None where they leave distance or heading open.
    """
    total = np.sum([estimate.information for estimate in estimates], axis=0)
    covariance = inverse_of(total)
    if not np.isfinite(covariance).all() or not (np.diag(covariance) > 0).all():
        return None
    values = [_vector(estimate) for estimate in estimates]
    weighted = np.sum(
        [estimate.information @ value for estimate, value in zip(estimates, values, strict=True)], axis=0
    )
    fused = covariance @ weighted
    rest = sum(
        float((value - fused) @ estimate.information @ (value - fused))
        for estimate, value in zip(estimates, values, strict=True)
    )
    freedom = sum(int(np.linalg.matrix_rank(estimate.information, tol=1e-9)) for estimate in estimates) - 2
    chance = float(chi2.sf(rest, freedom)) if freedom > 0 else 1.0
    shared = np.zeros((2, 2)) if common is None else common
    return FusedPlane(float(fused[0]), float(fused[1]), covariance + shared, chance, disagreement(estimates))


def _vector(estimate: PlaneEstimate) -> FloatArray:
    return np.array([estimate.turn, estimate.distance if np.isfinite(estimate.distance) else 0.0])


def depth_residuals(
    right: FloatArray, depth: FloatArray, turn: float, distance: float
) -> tuple[FloatArray, FloatArray]:
    """Return how far places lie behind a plane, (n,), and the derivatives by its turn and distance, (n, 2).

    Parameters
    ----------
    right, depth : (n,) array
        From `Foot.local`.
    turn, distance : float
        Of the plane, in radians and metres.
    """
    off = np.cos(turn) * depth - np.sin(turn) * right - distance
    return off, np.stack([-np.cos(turn) * right - np.sin(turn) * depth, -np.ones(len(right))], axis=1)


def robust_plane(
    residuals: Callable[[float, float], tuple[FloatArray, FloatArray]],
    sigma: FloatArray,
    prior: FloatArray,
    distance: float,
    tuning: float,
    rounds: int,
) -> tuple[float, float, FloatArray]:
    """Return turn, distance and their information of the plane with the least residuals, with Huber's weights.

    Parameters
    ----------
    residuals : callable
        Returns residuals, (n,), and their derivatives, (n, 2), for turn and distance.
    sigma : (n,) array
        Standard deviations of the residuals.
    prior : (2, 2) array
        Information about both before, around 0.
    distance : float
        Where to begin, in metres; the turn begins at 0.
    tuning : float
        Residuals beyond this many standard deviations count by their size.
    rounds : int
        How many steps are made, each with new weights.
    """
    turn, weight = 0.0, 1 / sigma
    information = prior
    for _ in range(rounds):
        off, design = residuals(turn, distance)
        root = weight / np.sqrt(huber_divisors(off * weight, tuning=tuning))
        scaled = design * root[:, None]
        information = np.asarray(scaled.T @ scaled + prior)
        step = np.linalg.solve(information, -scaled.T @ (off * root) - prior @ np.array([turn, distance]))
        turn, distance = turn + float(step[0]), distance + float(step[1])
    return turn, distance, information


def disagreement(estimates: Sequence[PlaneEstimate]) -> Disagreement | None:
    """Return the two estimates that contradict each other most; None where no two do."""
    worst: Disagreement | None = None
    for first, second in combinations(estimates, 2):
        found = _compared(first, second)
        if found.chance < CHANCE and (worst is None or found.chance < worst.chance):
            worst = found
    return worst


def _compared(first: PlaneEstimate, second: PlaneEstimate) -> Disagreement:
    difference = _vector(second) - _vector(first)
    sum_of_both = inverse_of(first.information) + inverse_of(second.information)
    both = np.isfinite(np.diag(sum_of_both))
    if not both.any():
        return Disagreement(first.method, second.method, 1.0, float(difference[0]), float("nan"))
    part = sum_of_both[np.ix_(both, both)]
    square = float(difference[both] @ np.linalg.solve(part, difference[both]))
    distance = float(difference[1]) if both[1] else float("nan")
    chance = float(chi2.sf(square, int(both.sum())))
    return Disagreement(first.method, second.method, chance, float(difference[0]), distance)
