"""Vertical edges measured in each shot, triangulated, and cleared of what does not fit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from calibration.shelf.level_view import REACH, LevelView
from calibration.shelf.problem import EdgeObservation
from calibration.shelf.upright_edges import BAND, BANDS, FARTHEST, NEAREST, Edges, seen_from
from palletloc.geometry import FloatArray, wrap_angle

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


def measure_edges(views: Sequence[LevelView], poses: FloatArray, edges: Edges, into: float) -> list[EdgeObservation]:
    """Measure where each edge is seen in each shot from its side.

    Parameters
    ----------
    views : sequence of LevelView
        One for each shot.
    poses : (n, 3) array
        ``odom_from_forklift`` at the shots.
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
        azimuth, distance = seen_from(view, pose, edges.places)
        bearing = np.asarray(wrap_angle(azimuth + pose[2] - into))
        seen = (bearing * edges.side > 0) & (np.abs(bearing) < REACH - 0.05)
        seen &= (distance > NEAREST) & (distance < FARTHEST)
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
    for height in BANDS:
        ends = (round(float(view.row(np.array(z), np.array(distance)))) for z in (height, height + BAND))
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
