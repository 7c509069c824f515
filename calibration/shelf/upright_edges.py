"""Vertical edges near a shelf's front: found by what many shots agree on, measured in each shot, and triangulated.

A post is a box. Seen from its left, its left outline is its rear corner and its right outline its front corner; seen
from its right the other way round. Edges are therefore looked for among the shots from either side separately.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.drive import compose, relative
from calibration.shelf.level_view import REACH, LevelView
from calibration.shelf.problem import EdgeObservation
from palletloc.geometry import FloatArray, wrap_angle
from palletloc.shelf import ShelfPlane

_BANDS = np.arange(0.1, 2.6, 0.25)
"""Lower ends of the height bands that an upright passes through, in metres."""
_BAND = 0.25
"""Height of a band, in metres."""
_NEAREST, _FARTHEST = 0.5, 4.6
"""Between which distances edges are looked for, in metres."""
_CELL = 0.007
"""Side of a cell, in metres: two pixels of 3840 around, at 2 m."""
_ALONG = 3.2
"""How far beyond the ends of the way cells reach, in metres: what is seen at 60 degrees."""
_LEAST_SHOTS = 3
"""Shots that must see a cell."""
_LEAST_SPREAD = float(np.radians(10.0))
"""Angle between its bearings at least, in radians: below, its depth is open."""
_LEAST_VOTE = 0.3
"""Part of the height bands that an edge must be clear in: lower ones are pallets and loads."""
_MOST = 40
"""Edges that are kept from each side: more than there are uprights in view."""
_BOOST = 1.25
"""Factor on the vote of a band: an edge that is not quite upright is clear in part of its rows."""
_SEARCH_PX = 5
"""How far from where it is expected an edge is looked for, in columns: what odometry adds between shots."""
_LEAST_BANDS = 3
"""Height bands that must show an edge: fewer may be a label."""
_LEAST_SIGHTS = 3
"""Shots that must agree on a place: two always cross."""
_SAME = 0.015
"""Edges nearer to each other are one, in metres: far less than a post is wide."""
_PIXEL_ERROR = 0.25
"""Standard deviation of the column of an edge that all bands agree on, at least."""
_POSE_ERROR = 0.0007
"""What the forklift may turn between odometry and shot, one standard deviation, in radians: 0.04 degrees."""
_OUTLIER = 4.0
"""A bearing that misses the place by more standard deviations is left out."""


@dataclass(frozen=True, slots=True, eq=False)
class Edges:
    """Vertical edges, each as seen from one side."""

    places: FloatArray
    """(k, 2) in odom, in metres."""
    vote: FloatArray
    """(k,) how tall and clear they are, -1 to 1; positive where it gets lighter to the left."""
    side: FloatArray
    """(k,) 1 where they are seen to the left of straight into the shelf, -1 where to the right."""

    @classmethod
    def none(cls) -> Edges:
        """Return no edges."""
        return cls(np.zeros((0, 2)), np.zeros(0), np.zeros(0))


def find_edges(views: Sequence[LevelView], poses: FloatArray, plane: ShelfPlane, depth: float) -> Edges:
    """Find edges that stand upright near a plane.

    Parameters
    ----------
    views : sequence of LevelView
        One for each shot.
    poses : (n, 3) array
        ``odom_from_forklift`` at the shots.
    plane : ShelfPlane
        Roughly the front, in odom.
    depth : float
        How far before and behind it edges are looked for, in metres.

    Returns
    -------
    Edges
        The tallest, at most 40 from each side.
    """
    cells = _cells(views, poses, plane, depth)
    sides = _votes(views, poses, cells, plane.yaw)
    found = [_peaks(cells, vote, side) for vote, side in zip(sides, (1.0, -1.0), strict=True)]
    joined = (np.concatenate(parts) for parts in zip(*((e.places, e.vote, e.side) for e in found), strict=True))
    return Edges(*joined)


def _cells(views: Sequence[LevelView], poses: FloatArray, plane: ShelfPlane, depth: float) -> FloatArray:
    """Return (along, deep, 2) places around the plane, in odom."""
    into = np.array([np.cos(plane.yaw), np.sin(plane.yaw)])
    right = np.array([np.sin(plane.yaw), -np.cos(plane.yaw)])
    places = np.array([[*view.camera[:2], 0.0] for view in views])
    middle = np.array([plane.x, plane.y])
    ends = (compose(poses, places)[:, :2] - middle) @ right
    along = np.arange(ends.min() - _ALONG, ends.max() + _ALONG, _CELL)
    deep = np.arange(-depth, depth + _CELL / 2, _CELL)
    return np.asarray(middle + along[:, None, None] * right + deep[None, :, None] * into)


def _peaks(cells: FloatArray, vote: FloatArray, side: float) -> Edges:
    strength = np.abs(vote).astype(np.float32)
    near = np.ones((2 * round(0.02 / _CELL) + 1, 2 * round(0.03 / _CELL) + 1), np.uint8)
    peak = (strength >= cv2.dilate(strength, near)) & (strength >= _LEAST_VOTE)
    peak[:, [0, -1]] = False
    row, column = np.nonzero(peak)
    order = np.argsort(-strength[row, column], kind="stable")[:_MOST]
    row, column = row[order], column[order]
    return Edges(cells[row, column], vote[row, column], np.full(len(row), side))


def _votes(
    views: Sequence[LevelView], poses: FloatArray, cells: FloatArray, into: float
) -> tuple[FloatArray, FloatArray]:
    """Return the mean vote for each cell, of the shots that see it on the left and of those on the right."""
    shape = (2, *cells.shape[:2])
    total, count = np.zeros(shape), np.zeros(shape)
    least, most = np.full(shape, np.inf), np.full(shape, -np.inf)
    for view, pose in zip(views, poses, strict=True):
        azimuth, distance = _seen_from(view, pose, cells)
        bearing = np.asarray(wrap_angle(azimuth + pose[2] - into))
        seen = (distance > _NEAREST) & (distance < _FARTHEST) & (np.abs(bearing) < REACH - 0.05)
        share = np.where(seen, _clear_part(view, azimuth, distance), 0.0)
        for i, here in enumerate((seen & (bearing > 0), seen & (bearing < 0))):
            total[i] += np.where(here, share, 0.0)
            count[i] += here
            least[i] = np.where(here, np.minimum(least[i], bearing), least[i])
            most[i] = np.where(here, np.maximum(most[i], bearing), most[i])
    enough = (count >= _LEAST_SHOTS) & (most - least >= _LEAST_SPREAD)
    vote = np.where(enough, total / np.maximum(count, 1), 0.0)
    return vote[0], vote[1]


def _seen_from(view: LevelView, pose: FloatArray, points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the azimuths in the forklift frame and the distances on the floor at which the camera sees points."""
    at = np.concatenate([points, np.zeros((*points.shape[:-1], 1))], axis=-1)
    local = relative(pose, at)
    x, y = local[..., 0] - view.camera[0], local[..., 1] - view.camera[1]
    return np.arctan2(y, x), np.hypot(x, y)


def _clear_part(view: LevelView, azimuth: FloatArray, distance: FloatArray) -> FloatArray:
    """Return the part of the height bands in which an edge is clear, signed, (...)."""
    summed = np.concatenate([np.zeros((1, view.columns)), np.cumsum(view.ridge, axis=0)])
    column = np.clip(np.rint(view.column(azimuth)), 0, view.columns - 1).astype(np.intp)
    total = np.zeros(azimuth.shape)
    for height in _BANDS:
        low, high = (
            np.clip(np.rint(view.row(z, distance)), 0, len(view.ridge)).astype(np.intp)
            for z in (np.array(height), np.array(height + _BAND))
        )
        mean = (summed[high, column] - summed[low, column]) / np.maximum(high - low, 1)
        total += np.where(high - low > 2, _BOOST * mean, 0.0)
    return np.clip(total / len(_BANDS), -1.0, 1.0)


def measure_edges(views: Sequence[LevelView], poses: FloatArray, edges: Edges, into: float) -> list[EdgeObservation]:
    """Measure where each edge is seen in each shot from its side.

    Parameters
    ----------
    views, poses
        As for `find_edges`.
    edges : Edges
        Where they are about.
    into : float
        Heading into the shelf in odom, in radians.

    Returns
    -------
    list of EdgeObservation
        Only of shots that show the edge clearly.
    """
    sights: list[EdgeObservation] = []
    for shot, (view, pose) in enumerate(zip(views, poses, strict=True)):
        azimuth, distance = _seen_from(view, pose, edges.places)
        bearing = np.asarray(wrap_angle(azimuth + pose[2] - into))
        seen = (bearing * edges.side > 0) & (np.abs(bearing) < REACH - 0.05)
        seen &= (distance > _NEAREST) & (distance < _FARTHEST)
        for i in np.flatnonzero(seen):
            found = _refined(view, float(view.column(azimuth[i])), float(distance[i]), float(np.sign(edges.vote[i])))
            if found is not None:
                column, sigma = found
                sights.append(EdgeObservation(shot, int(i), float(view.azimuth(np.array(column))), sigma * view.step))
    return sights


def _refined(view: LevelView, column: float, distance: float, sign: float) -> tuple[float, float] | None:
    """Return the column of an edge and its standard deviation, from the bands that show it; None where too few do."""
    first = round(column) - _SEARCH_PX
    if first < 1 or first + 2 * _SEARCH_PX + 1 >= view.columns:
        return None
    columns = np.arange(first, first + 2 * _SEARCH_PX + 1)
    places: list[float] = []
    for height in _BANDS:
        ends = (round(float(view.row(np.array(z), np.array(distance)))) for z in (height, height + _BAND))
        low, high = (min(max(end, 0), len(view.slope)) for end in ends)
        if high - low < 3:
            continue
        place = _steepest(sign * view.slope[low:high, columns].mean(axis=0), view.clear)
        if place is not None:
            places.append(first + place)
    at = np.array(places)
    good = at[np.abs(at - np.median(at)) < 1.0] if len(at) else at
    if len(good) < max(_LEAST_BANDS, 0.6 * len(at)):
        return None
    return float(np.median(good)), float(np.hypot(_PIXEL_ERROR, 1.5 * good.std() / np.sqrt(len(good))))


def _steepest(profile: FloatArray, clear: float) -> float | None:
    """Return where a profile is highest, between its samples; None where that is at an end or not clear."""
    best = int(profile.argmax())
    if not 0 < best < len(profile) - 1 or profile[best] < clear:
        return None
    left, middle, right = profile[best - 1 : best + 2]
    bend = left - 2 * middle + right
    return best + (0.5 * (left - right) / bend if bend < 0 else 0.0)


def triangulated(
    views: Sequence[LevelView], poses: FloatArray, edges: Edges, sights: Sequence[EdgeObservation]
) -> tuple[Edges, list[EdgeObservation]]:
    """Place each edge where its sights cross, leave out sights that miss it, and join edges that are the same.

    Parameters
    ----------
    views, poses, edges
        As for `measure_edges`.
    sights : sequence of EdgeObservation
        From it.

    Returns
    -------
    edges : Edges
        Those that at least three shots agree on.
    sights : list of EdgeObservation
        Theirs, numbered anew.
    """
    kept: list[tuple[FloatArray, list[EdgeObservation], int]] = []
    for i in np.argsort(-np.abs(edges.vote), kind="stable"):
        mine = [sight for sight in sights if sight.edge == i]
        place, mine = _crossing(views, poses, edges.places[i], mine)
        if place is None:
            continue
        same = [
            k
            for k, (other, _, j) in enumerate(kept)
            if np.hypot(*(other - place)) < _SAME and edges.side[i] == edges.side[j]
        ]
        if not same:
            kept.append((place, mine, int(i)))
        elif len(mine) > len(kept[same[0]][1]):
            kept[same[0]] = (place, mine, int(i))
    index = np.array([i for _, _, i in kept], np.intp)
    places = np.array([place for place, _, _ in kept]).reshape(-1, 2)
    renumbered = [replace(sight, edge=k) for k, (_, mine, _) in enumerate(kept) for sight in mine]
    return Edges(places, edges.vote[index], edges.side[index]), renumbered


def _crossing(
    views: Sequence[LevelView], poses: FloatArray, start: FloatArray, sights: Sequence[EdgeObservation]
) -> tuple[FloatArray | None, list[EdgeObservation]]:
    """Return where bearings cross and those that pass there; None where fewer than three do."""
    mine = list(sights)
    place = start
    while len(mine) >= _LEAST_SIGHTS:
        normal, offset, weight = _lines(views, poses, place, mine)
        place = np.asarray(np.linalg.lstsq(normal * weight[:, None], offset * weight, rcond=None)[0], np.float64)
        miss = np.abs((normal @ place - offset) * weight)
        worst = int(miss.argmax())
        if np.hypot(*(place - start)) > 0.5:
            return None, []
        if miss[worst] < _OUTLIER:
            return place, mine
        del mine[worst]
    return None, []


def _lines(
    views: Sequence[LevelView], poses: FloatArray, place: FloatArray, sights: Sequence[EdgeObservation]
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return each bearing as a line on the floor: its normal, its offset, and one over its error there."""
    shots: NDArray[np.intp] = np.array([sight.shot for sight in sights])
    azimuth = np.array([sight.azimuth for sight in sights]) + poses[shots, 2]
    local = np.array([views[shot].camera[:2] for shot in shots])
    cos, sin = np.cos(poses[shots, 2]), np.sin(poses[shots, 2])
    camera = poses[shots, :2] + np.stack(
        [cos * local[:, 0] - sin * local[:, 1], sin * local[:, 0] + cos * local[:, 1]], axis=1
    )
    normal = np.stack([-np.sin(azimuth), np.cos(azimuth)], axis=1)
    error = np.hypot([sight.sigma for sight in sights], _POSE_ERROR) * np.hypot(*(place - camera).T)
    return normal, (normal * camera).sum(1), 1 / error
