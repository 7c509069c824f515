"""Vertical edges near a shelf's front: found by what many shots agree on.

A post is a box. Seen from its left, its left outline is its rear corner and its right outline its front corner; seen
from its right the other way round. Edges are therefore looked for among the shots from either side separately.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from calibration.drive import compose, relative
from calibration.shelf.level_view import REACH, LevelView
from palletloc.geometry import FloatArray, wrap_angle
from palletloc.shelf import ShelfPlane

BANDS = np.arange(0.1, 2.6, 0.25)
"""Lower ends of the height bands that an upright passes through, in metres."""
BAND = 0.25
"""Height of a band, in metres."""
NEAREST, FARTHEST = 0.5, 4.6
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
        azimuth, distance = seen_from(view, pose, cells)
        bearing = np.asarray(wrap_angle(azimuth + pose[2] - into))
        seen = (distance > NEAREST) & (distance < FARTHEST) & (np.abs(bearing) < REACH - 0.05)
        share = np.where(seen, _clear_part(view, azimuth, distance), 0.0)
        for i, here in enumerate((seen & (bearing > 0), seen & (bearing < 0))):
            total[i] += np.where(here, share, 0.0)
            count[i] += here
            least[i] = np.where(here, np.minimum(least[i], bearing), least[i])
            most[i] = np.where(here, np.maximum(most[i], bearing), most[i])
    enough = (count >= _LEAST_SHOTS) & (most - least >= _LEAST_SPREAD)
    vote = np.where(enough, total / np.maximum(count, 1), 0.0)
    return vote[0], vote[1]


def seen_from(view: LevelView, pose: FloatArray, points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the azimuths in the forklift frame and the distances on the floor at which the camera sees points.

    Parameters
    ----------
    view : LevelView
        Of the shot.
    pose : (3,) array
        ``odom_from_forklift``.
    points : (..., 2) array
        In odom, in metres.
    """
    at = np.concatenate([points, np.zeros((*points.shape[:-1], 1))], axis=-1)
    local = relative(pose, at)
    x, y = local[..., 0] - view.camera[0], local[..., 1] - view.camera[1]
    return np.arctan2(y, x), np.hypot(x, y)


def _clear_part(view: LevelView, azimuth: FloatArray, distance: FloatArray) -> FloatArray:
    """Return the part of the height bands in which an edge is clear, signed, (...)."""
    summed = np.concatenate([np.zeros((1, view.columns)), np.cumsum(view.ridge, axis=0)])
    column = np.clip(np.rint(view.column(azimuth)), 0, view.columns - 1).astype(np.intp)
    total = np.zeros(azimuth.shape)
    for height in BANDS:
        low, high = (
            np.clip(np.rint(view.row(z, distance)), 0, len(view.ridge)).astype(np.intp)
            for z in (np.array(height), np.array(height + BAND))
        )
        mean = (summed[high, column] - summed[low, column]) / np.maximum(high - low, 1)
        total += np.where(high - low > 2, _BOOST * mean, 0.0)
    return np.clip(total / len(BANDS), -1.0, 1.0)
