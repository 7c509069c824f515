"""What upright and level edges say about gravity, and where the level ones point."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calibration.shelf.line_segments import Segments
from palletloc.geometry import BoolArray, FloatArray, wrap_angle
from palletloc.robust import cauchy_divisors, reweighted, robust_sigma

_NEAR = float(np.sin(np.radians(3.0)))
"""Edges that lean by less, as a sine, may be plumb: wrong mountings and leaning loads both stay below."""
_NEAR_LEVEL = float(np.radians(5.0))
"""Edges that point by less, in radians, off the direction along the shelf may be level."""
_PLUMB, _LEVEL = float(np.radians(0.1)), float(np.radians(0.15))
"""What built edges lack to be plumb, and to be level, in radians; one standard deviation."""
_BIN = float(np.radians(4.0))
"""Plumb edges nearer to each other in azimuth, in radians, count as one: both sides of a post."""
_SECTOR = float(np.radians(20.0))
"""Width of the parts of the image whose scatter is compared, in radians: a seam is as wide."""
_LEAST = 8
"""Edges that a robust fit, or a sector, needs."""
_LEAST_HEIGHT = 0.08
"""Level edges nearer to the horizon, as a sine, tell nothing of where they point."""
_ROUNDS = 20
"""Rounds of a robust fit: more than the weights need to settle."""
_LEAST_SCATTER = 1e-3
"""Of weighed residuals: keeps weights finite where all edges agree exactly."""


@dataclass(frozen=True, slots=True, eq=False)
class Tilt:
    """How the seen world is tilted against the frame that the mounting states."""

    turn: FloatArray
    """(2,) rotation about the forklift's x and y axes, in radians."""
    information: FloatArray
    """(2, 2) inverse covariance; singular where one axis is left open."""
    segments: int
    """How many segments it is based on."""


def vertical_tilt(shots: Sequence[Segments]) -> Tilt | None:
    """Return the tilt that makes upright edges plumb: the vertical vanishing point.

    Parameters
    ----------
    shots : sequence of Segments
        One for each shot.

    Returns
    -------
    Tilt or None
        None where too few edges are upright.

    Notes
    -----
    Of a plumb edge at azimuth phi the normal's z component is cos(phi) times the turn about x plus sin(phi) times
    that about y. Shots see the same edges again, and these need not be plumb themselves: what they have in common
    does not average out over the shots.
    """
    azimuth, away, sigma, shot = upright_edges(shots)
    if len(azimuth) < _LEAST:
        return None
    design = np.stack([np.cos(azimuth), np.sin(azimuth)], axis=1)
    turn, _, _ = _robust(design, away, 1 / sigma)
    # Parts of an image that are coarse or badly stitched scatter more, and count less.
    turn, scatter, weight = _robust(
        design, away, 1 / (sigma * _local_scatter(azimuth, (away - design @ turn) / sigma))
    )
    random = np.linalg.pinv((design * weight[:, None] ** 2).T @ design) * max(scatter, 0.5) ** 2
    covariance = random + _PLUMB**2 * np.linalg.pinv(_distinct(design, azimuth, shot))
    return Tilt(turn, np.linalg.pinv(covariance), len(azimuth))


def upright_edges(shots: Sequence[Segments]) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return azimuth, tilt, its sigma and the shot of each nearly upright segment, (n,) each; one entry per shot."""
    normals = np.concatenate([segments.normals for segments in shots])
    middles = np.concatenate([segments.middles for segments in shots])
    sigma = np.concatenate([segments.sigma for segments in shots])
    shot = np.repeat(np.arange(len(shots), dtype=np.float64), [len(segments.sigma) for segments in shots])
    near = np.abs(normals[:, 2]) < _NEAR
    azimuth = np.arctan2(middles[near, 1], middles[near, 0])
    across = np.stack([-np.sin(azimuth), np.cos(azimuth)], axis=1)
    away = np.sign((normals[near, :2] * across).sum(axis=1)) * normals[near, 2]
    return azimuth, away, sigma[near], shot[near]


def _robust(design: FloatArray, values: FloatArray, weight: FloatArray) -> tuple[FloatArray, float, FloatArray]:
    """Return the solution, the scatter in units of the weights, and the final weights.

    Cauchy's weights act on residuals, not on their squares: an edge that leans counts even less than by them.
    """

    def fit(divisors: FloatArray, _: float) -> FloatArray:
        now = weight / divisors
        return np.asarray(np.linalg.lstsq(design * now[:, None], values * now, rcond=None)[0], np.float64)

    found = reweighted(
        fit,
        lambda solution: (values - design @ solution) * weight,
        cauchy_divisors,
        lambda off: robust_sigma(off, _LEAST_SCATTER),
        np.ones(len(values)),
        _ROUNDS,
    )
    return found.solution, found.sigma, weight / found.weights


def _local_scatter(azimuth: FloatArray, errors: FloatArray) -> FloatArray:
    """Return the scatter of errors around each azimuth, against zero, not below a half."""
    sector = np.floor(azimuth / _SECTOR).astype(np.intp)
    scatter = np.ones(len(azimuth))
    for number in np.unique(sector):
        mine = sector == number
        scatter[mine] = robust_sigma(errors[mine]) if mine.sum() >= _LEAST else 2.0
    return np.maximum(scatter, 0.5)


def _distinct(design: FloatArray, azimuth: FloatArray, shot: FloatArray) -> FloatArray:
    """Return the normal matrix of edges that are not the same, for the shot that shows most of them."""
    best = np.zeros((2, 2))
    for number in np.unique(shot):
        mine = shot == number
        bins = np.rint(azimuth[mine] / _BIN)
        first = np.unique(bins, return_index=True)[1]
        normal = design[mine][first].T @ design[mine][first]
        best = normal if np.trace(normal) > np.trace(best) else best
    return best


@dataclass(frozen=True, slots=True, eq=False)
class LevelDirection:
    """Where the level edges along a shelf point, seen in one shot."""

    heading: float
    """In the forklift frame, in radians."""
    rise: float
    """Elevation, in radians; zero where the mounting is right."""
    covariance: FloatArray
    """(2, 2) of heading and rise, from the noise of the segments alone."""
    segments: int
    """How many it is based on."""

    def heading_if_level(self) -> tuple[float, float]:
        """Return the heading, and its standard deviation, of edges that are level by the mounting."""
        return self._given(self.heading, self.rise, 0)

    def rise_along(self, heading: float) -> tuple[float, float]:
        """Return the rise, and its standard deviation, of edges that point along a known heading."""
        return self._given(self.rise, float(wrap_angle(self.heading - heading)), 1)

    def _given(self, value: float, other: float, index: int) -> tuple[float, float]:
        """Return a value once the other one is known to be off by that much, with what edges lack to be level."""
        slope = float(self.covariance[0, 1] / self.covariance[1 - index, 1 - index])
        left = float(self.covariance[index, index]) - slope * float(self.covariance[0, 1])
        return value - slope * other, float(np.sqrt(max(left, 0.0) + (min(abs(slope), 5.0) * _LEVEL) ** 2))


def level_direction(segments: Segments, heading: float) -> LevelDirection | None:
    """Return the vanishing point of the edges along a shelf.

    Parameters
    ----------
    segments : Segments
        Of one shot.
    heading : float
        About where they point, in the forklift frame, in radians.

    Returns
    -------
    LevelDirection or None
        None where too few edges, or only edges at one height, point there.
    """
    along = np.array([np.cos(heading), np.sin(heading), 0.0])
    aside = np.array([-np.sin(heading), np.cos(heading), 0.0])
    chosen = _along(segments, along)
    if chosen.sum() < _LEAST:
        return None
    normals = segments.normals[chosen]
    design = np.stack([normals @ aside, normals[:, 2]], axis=1)
    solution, scatter, weight = _robust(design, -(normals @ along), 1 / segments.sigma[chosen])
    normal = (design * weight[:, None] ** 2).T @ design
    if np.linalg.eigvalsh(normal)[0] < 1e-3 * np.linalg.eigvalsh(normal)[1]:
        return None
    covariance = np.linalg.inv(normal) * max(scatter, 0.5) ** 2
    direction = along + solution[0] * aside + np.array([0.0, 0.0, solution[1]])
    rise = float(np.arctan2(direction[2], np.hypot(direction[0], direction[1])))
    return LevelDirection(float(np.arctan2(direction[1], direction[0])), rise, covariance, int(chosen.sum()))


def _along(segments: Segments, along: FloatArray) -> BoolArray:
    """Tell which segments may point along a direction, whatever their height."""
    tangent = np.cross(segments.normals, segments.middles)
    across = along - (segments.middles @ along)[:, None] * segments.middles
    across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-9)
    near = np.abs((tangent * across).sum(axis=1)) > np.cos(_NEAR_LEVEL)
    high = np.abs(segments.middles[:, 2]) > _LEAST_HEIGHT
    return np.asarray(near & high & (np.abs(segments.normals @ along) < np.sin(_NEAR_LEVEL)))


def level_heading(found: Sequence[tuple[LevelDirection, float]]) -> tuple[float, float] | None:
    """Return where the edges along a shelf point in odom, if they are level, and its standard deviation, in radians.

    Each direction comes with the forklift's heading in odom, in radians; None where there is none.
    """
    if not found:
        return None
    given = [
        (wrap_angle(direction.heading_if_level()[0] + yaw), direction.heading_if_level()[1])
        for direction, yaw in found
    ]
    first = given[0][0]
    headings = np.array([wrap_angle(heading - first) for heading, _ in given])
    middle = float(np.median(headings))
    spread = robust_sigma(headings - middle)
    sigma = float(np.hypot(max(spread, float(np.median([s for _, s in given]))), _LEVEL))
    return float(wrap_angle(first + middle)), sigma


def level_tilt(found: Sequence[tuple[LevelDirection, float]]) -> Tilt | None:
    """Return the tilt that makes the edges along a shelf level.

    Parameters
    ----------
    found : sequence of LevelDirection and float
        Of each shot, with the heading of the shelf in the forklift frame, in radians.

    Returns
    -------
    Tilt or None
        Known about one axis only; None where there is no shot.
    """
    if not found:
        return None
    given = [edges.rise_along(heading) for edges, heading in found]
    rise, sigma = (float(np.median(values)) for values in zip(*given, strict=True))
    spread = robust_sigma(np.array([value - rise for value, _ in given]))
    # The edge rises by the turn about x times its y component minus that about y times its x component.
    heading = float(np.median(np.unwrap([heading for _, heading in found])))
    direction = np.array([np.sin(heading), -np.cos(heading)])
    total = float(np.hypot(np.hypot(spread, sigma), _LEVEL))
    information = np.outer(direction, direction) / total**2
    return Tilt(direction * rise, information, sum(edges.segments for edges, _ in found))
