"""What straight lines on the floor say: seen through a tilted camera they seem to run beside their direction.

Painted lines and joints count that run about along the shelf or square to it. Marks of tyres have no direction that
anybody knows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.check.tilt_sources import fit_with_prior
from calibration.shelf.gravity_lines import Tilt
from calibration.shelf.line_segments import Segments
from palletloc.geometry import FloatArray, wrap_angle
from palletloc.shelf import ShelfPlane

_FARTHEST = 8.0
"""Lines farther on the floor, in metres, are seen too flatly."""
_CLEAR = 0.15
"""How far before the front a line must lie, in metres: behind may be a load."""
_LEAST_DEPRESSION = float(np.radians(8.0))
"""Segments nearer to the horizon, in radians, may stand on anything."""
_WINDOW = float(np.radians(1.2))
"""Lines that point by less off the shelf, or square to it, in radians, count: marks of tyres point anywhere."""
_SAME_TURN, _SAME_PLACE, _LEAST_SIGHTS = float(np.radians(1.5)), 0.12, 3
"""Segments are one line within this turn and this place, in radians and metres, if as many shots see it."""
_BUILT, _SQUARE, _EVEN = (float(np.radians(angle)) for angle in (0.4, 0.2, 0.1))
"""One standard deviation of a line's heading, of both kinds against each other, and of the floor's level, in
radians."""
_FAINT = 1e-3
"""Information that keeps unknowns of which nothing is told where they are, in per square radian."""
_TOLD = 1 / float(np.radians(2.0)) ** 2
"""An axis that is known to 2 degrees is told, in per square radian; the floor says nothing of others."""


@dataclass(frozen=True, slots=True, eq=False)
class FloorSegments:
    """Segments on the floor; one row for each."""

    normals: FloatArray
    """(n, 3) normals of the planes through the camera and each segment, in the forklift frame."""
    sigma: FloatArray
    """(n,) how far each is turned about its middle, one standard deviation, in radians."""
    azimuth: FloatArray
    """(n,) where such a line should point, in the forklift frame, in radians."""
    way: FloatArray
    """(n,) 1 where it should run along the shelf, 0 where square to it."""
    turned: FloatArray
    """(n,) by how much it seems turned against that, in radians."""
    place: FloatArray
    """(n,) where it crosses the other direction, from odom's origin, in metres."""
    shot: FloatArray
    """(n,) in which shot it is seen."""


def floor_segments(
    shots: Sequence[Segments], poses: FloatArray, center: FloatArray, front: ShelfPlane
) -> FloorSegments:
    """Cut segments with the floor and keep those that may lie on it.

    Parameters
    ----------
    shots : sequence of Segments
        In the forklift frame.
    poses : (n, 3) array
        ``odom_from_forklift`` at each of them.
    center : (3,) array
        The camera's place in the forklift frame, in metres.
    front : ShelfPlane
        The shelf's front in odom. Only the aisle counts, no farther to either side of the camera than the front: what
        seems to be on the floor there may be a load.
    """
    parts = [
        _on_floor(segments, pose, center, front, i)
        for i, (segments, pose) in enumerate(zip(shots, poses, strict=True))
    ]
    if not parts:
        return FloorSegments(np.zeros((0, 3)), *(np.zeros(0) for _ in range(6)))
    joined = [np.concatenate(columns) for columns in zip(*parts, strict=True)]
    return FloorSegments(*joined)


def _on_floor(
    segments: Segments, pose: FloatArray, center: FloatArray, front: ShelfPlane, shot: int
) -> tuple[FloatArray, ...]:
    down = segments.middles[:, 2] < -np.sin(_LEAST_DEPRESSION)
    normals, middles, sigma = segments.normals[down], segments.middles[down], segments.sigma[down]
    reach = center[2] / -middles[:, 2]
    local = center[:2] + middles[:, :2] * reach[:, None]
    cos, sin = np.cos(pose[2]), np.sin(pose[2])
    turn = np.array([[cos, -sin], [sin, cos]])
    places = pose[:2] + local @ turn.T
    along = np.stack([normals[:, 1], -normals[:, 0]], axis=1)
    level = np.hypot(*along.T)
    camera = pose[:2] + turn @ center[:2]
    into = np.array([np.cos(front.yaw), np.sin(front.yaw)])
    room = (np.array([front.x, front.y]) - camera) @ into - _CLEAR
    used = (np.abs((places - camera) @ into) < room) & (np.hypot(*(local - center[:2]).T) < _FARTHEST) & (level > 0.1)
    along = (along[used] / level[used, None]) @ turn.T
    heading = np.arctan2(along[:, 1], along[:, 0])
    square = np.rint((heading - front.yaw) / (np.pi / 2))
    heading = np.asarray(wrap_angle(heading - front.yaw - square * (np.pi / 2)))
    way = np.mod(square, 2)
    across = front.yaw + (way + 1) * np.pi / 2
    place = np.cos(across) * places[used, 0] + np.sin(across) * places[used, 1]
    near = np.abs(heading) < _WINDOW
    azimuth = np.asarray(front.yaw + way * (np.pi / 2) - pose[2])
    count = int(near.sum())
    return (
        normals[used][near],
        sigma[used][near],
        azimuth[near],
        way[near],
        heading[near],
        place[near],
        np.full(count, float(shot)),
    )


def floor_tilt(sights: FloorSegments) -> Tilt | None:
    """Return the tilt that lets lines on the floor run along the shelf and square to it.

    Parameters
    ----------
    sights : FloorSegments
        Of all shots.

    Returns
    -------
    Tilt or None
        About one axis only where all lines run alike; None where no line is seen in three shots.

    Notes
    -----
    The plane through the camera and a line contains the line's direction d, turned by the tilt w: m (d + w x d) = 0.
    Each line may be off by 0.4 degrees in its heading, and the floor under it by 0.1 degrees; lines seen right below
    the camera, m level, therefore tell nothing.
    """
    line = _same_lines(sights)
    used = np.flatnonzero(line >= 0)
    if not len(used):
        return None
    line, way = line[used], sights.way[used].astype(np.intp)
    lines = int(line.max()) + 1
    normals = sights.normals[used]
    cos, sin = np.cos(sights.azimuth[used]), np.sin(sights.azimuth[used])
    across = normals[:, 1] * cos - normals[:, 0] * sin
    design = np.zeros((len(used), 4 + 2 * lines))
    design[:, 0], design[:, 1] = normals[:, 2] * sin, -normals[:, 2] * cos
    rows = np.arange(len(used))
    design[rows, 2 + way] = across
    design[rows, 4 + line] = across
    design[rows, 4 + lines + line] = normals[:, 2]
    priors = [0.0, 0.0, *np.full(2, _SQUARE**-2), *np.full(lines, _BUILT**-2), *np.full(lines, _EVEN**-2)]
    values = -(normals[:, 0] * cos + normals[:, 1] * sin)
    return _told(
        *fit_with_prior(design, values, sights.sigma[used], np.diag(priors) + _FAINT * np.eye(len(priors))), len(used)
    )


def _told(solution: FloatArray, normal: FloatArray, segments: int) -> Tilt | None:
    """Return what the solution says of the tilt, without the axis about which it says nothing."""
    rest = np.linalg.solve(normal[2:, 2:], normal[2:, :2])
    information = normal[:2, :2] - normal[:2, 2:] @ rest
    values, axes = np.linalg.eigh((information + information.T) / 2)
    told = values > _TOLD
    if not told.any():
        return None
    known = axes[:, told]
    return Tilt(known @ (known.T @ solution[:2]), (known * values[told]) @ known.T, segments)


def _same_lines(sights: FloorSegments) -> NDArray[np.intp]:
    """Return which line each segment shows; -1 where fewer than three shots show it at one place.

    Both borders of a painted line are one: what is wrong with its direction they have in common.
    """
    line = np.full(len(sights.turned), -1, np.intp)
    number = 0
    for i in np.argsort(sights.sigma, kind="stable"):
        if line[i] >= 0:
            continue
        same = (line < 0) & (sights.way == sights.way[i]) & (np.abs(sights.turned - sights.turned[i]) < _SAME_TURN)
        same &= np.abs(sights.place - sights.place[i]) < _SAME_PLACE
        if len(np.unique(sights.shot[same])) >= _LEAST_SIGHTS:
            line[same] = number
            number += 1
    return line
