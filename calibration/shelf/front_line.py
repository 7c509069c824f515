"""The front as a line on the floor: through the corners of uprights, and through the fronts of pallets."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calibration.shelf.plane import Foot, PlaneEstimate, depth_residuals, robust_plane
from calibration.shelf.upright_edges import Edges
from palletloc.geometry import BoolArray, FloatArray, wrap_angle
from palletloc.robust import HUBER

UPRIGHTS, PALLETS = "uprights", "pallets"
"""Names of the methods."""
_TALL = 0.45
"""Part of the height bands that an upright's edge is clear in."""
_NEAR = 0.008
"""How far corners of the front stand off one line, in metres, as uprights are set."""
_SURPRISE = 0.2
"""What a turn of one standard deviation costs, in parts of the tallest edge: between lines alike the expected one
wins."""
_LOOSE_TURN = float(np.radians(1.2))
"""The heading is known no better, in radians: what pallets tell may be off by as much."""
_LEAST_SUPPORT = 1.2
"""A line needs so many times the tallest edge: one edge lies on any line."""
_POST_DEPTH, _AGAINST = 0.14, 1.5
"""How deep a post is at most, in metres, and what tall edges just before a line count against it."""
_TURN_STEPS = np.linspace(-2.5, 2.5, 61)
"""Turns that are tried, in standard deviations."""
_BUILT_DEPTH, _BUILT_TURN = 0.006, float(np.radians(0.1))
"""How far uprights stand off the plane of the front, in metres and radians, as shelves are built."""
_ROUNDS = 15
"""Steps of the robust line through pallets: more than the weights need to settle."""
_PALLET_DEPTH, _PALLET_TURN = 0.03, float(np.radians(1.5))
"""How far pallets stand off one plane, in metres and radians, as drivers set them."""


@dataclass(frozen=True, slots=True, eq=False)
class FrontLine:
    """The corners of uprights that form the front."""

    estimate: PlaneEstimate
    """The plane through them."""
    members: BoolArray
    """(k,) which edges they are."""
    uprights: int
    """How many posts they belong to."""


def upright_line(
    edges: Edges, places: FloatArray, covariance: FloatArray, foot: Foot, turn_sigma: float
) -> FrontLine | None:
    """Find the line of the uprights' front corners.

    Parameters
    ----------
    edges : Edges
        How tall each is.
    places : (k, 2) array
        Where they are, in odom.
    covariance : (2 k, 2 k) array
        Of the places, with what they share.
    foot : Foot
        What the plane is described from.
    turn_sigma : float
        How well the foot's heading is known, in radians.

    Returns
    -------
    FrontLine or None
        None where no two tall edges line up.

    Notes
    -----
    Behind the front corners of the posts their rear corners form a line as straight, and as clear. The front is the
    line with the most tall edges on it, and with none of them just before it.
    """
    tall = np.abs(edges.vote) >= _TALL
    if tall.sum() < 2:
        return None
    right, depth = foot.local(places).T
    spread = np.sqrt(np.maximum(np.diag(covariance).reshape(-1, 2).sum(1), 0.0))
    found = _supported(right[tall], depth[tall], np.abs(edges.vote[tall]), _NEAR + 0.3 * spread[tall], turn_sigma)
    if found is None:
        return None
    turn, distance = found
    for _ in range(4):
        off = depth - right * np.tan(turn) - distance / np.cos(turn)
        members = tall & (np.abs(off) < 2.0 * (_NEAR + 0.3 * spread))
        if members.sum() < 2:
            return None
        turn, distance, information = _fitted(
            places[members], _part(covariance, members), foot, max(turn_sigma, _LOOSE_TURN)
        )
    posts = 1 + int((np.diff(np.sort(right[members])) > 0.4).sum())
    evidence = f"{int(members.sum())} vertical edges of {posts} upright{'s' * (posts > 1)}"
    return FrontLine(PlaneEstimate(UPRIGHTS, turn, distance, information, evidence), members, posts)


def _part(covariance: FloatArray, members: BoolArray) -> FloatArray:
    keep = np.repeat(members, 2)
    return covariance[np.ix_(keep, keep)]


def _supported(
    right: FloatArray, depth: FloatArray, weight: FloatArray, width: FloatArray, turn_sigma: float
) -> tuple[float, float] | None:
    """Return turn and distance of the line that tall edges support best.

    Tall edges just before a line speak against it: it would run through the rear corner of that post.
    """
    best: tuple[float, float, float] | None = None
    for turn in turn_sigma * _TURN_STEPS:
        surprise = _SURPRISE * float(turn / turn_sigma) ** 2
        along = np.cos(turn) * depth - np.sin(turn) * right
        for distance in along:
            off = along - distance
            support = float((weight * np.exp(-0.5 * (off / width) ** 2)).sum())
            against = float(weight[(off < -3 * width) & (off > -_POST_DEPTH)].sum())
            score = support - _AGAINST * against - surprise * float(weight.max())
            if support > _LEAST_SUPPORT * weight.max() and (best is None or score > best[0]):
                best = score, float(turn), float(distance)
    return None if best is None or best[0] <= 0 else best[1:]


def _fitted(
    places: FloatArray, covariance: FloatArray, foot: Foot, turn_sigma: float
) -> tuple[float, float, FloatArray]:
    """Return turn, distance and their information of the line through places, whose errors may correlate.

    The turn has a prior about the foot's, so that a single post gives its distance.
    """
    turn, distance = 0.0, 0.0
    information = np.eye(2)
    right, depth = foot.local(places).T
    for _ in range(6):
        into = np.array([np.cos(foot.yaw + turn), np.sin(foot.yaw + turn)])
        off, design = depth_residuals(right, depth, turn, distance)
        across = np.zeros((len(right), 2 * len(right)))
        for i in range(len(right)):
            across[i, 2 * i : 2 * i + 2] = into
        full = across @ covariance @ across.T + _BUILT_DEPTH**2 * np.eye(len(right))
        weighted = np.linalg.solve(full, design)
        information = design.T @ weighted
        prior = np.diag([1 / turn_sigma**2, 0.0])
        step = np.linalg.solve(information + prior, -weighted.T @ off - prior @ np.array([turn, distance]))
        turn, distance = turn + float(step[0]), distance + float(step[1])
    built = np.diag([_BUILT_TURN**2, _BUILT_DEPTH**2])
    total = np.linalg.inv(np.linalg.inv(information + np.diag([1 / turn_sigma**2, 0.0])) + built)
    return turn, distance, np.asarray(total)


def pallet_line(pallets: FloatArray, covariance: FloatArray, foot: Foot) -> PlaneEstimate | None:
    """Return the plane along the fronts of pallets, which stand neither flush nor straight.

    Parameters
    ----------
    pallets : (m, 3) array
        ``odom_from_pallet``: x, y, yaw.
    covariance : (3 m, 3 m) array
        Of these.
    foot : Foot
        What the plane is described from.

    Returns
    -------
    PlaneEstimate or None
        None where there is no pallet.
    """
    if not len(pallets):
        return None
    right, depth = foot.local(pallets[:, :2]).T
    turned = np.asarray(wrap_angle(pallets[:, 2] - foot.yaw))
    sigma = np.sqrt(np.maximum(np.diag(covariance), 0.0)).reshape(-1, 3)
    sigma = np.concatenate([np.hypot(_PALLET_DEPTH, sigma[:, :2].max(1)), np.hypot(_PALLET_TURN, sigma[:, 2])])

    def residuals(turn: float, distance: float) -> tuple[FloatArray, FloatArray]:
        off, design = depth_residuals(right, depth, turn, distance)
        by_turn = np.tile([-1.0, 0.0], (len(right), 1))
        return np.concatenate([off, turned - turn]), np.concatenate([design, by_turn])

    start = float(np.median(depth))
    turn, distance, information = robust_plane(residuals, sigma, np.zeros((2, 2)), start, HUBER, _ROUNDS)
    evidence = f"{len(pallets)} pallet{'s' * (len(pallets) > 1)}"
    return PlaneEstimate(PALLETS, turn, distance, information, evidence)
