"""Boundary lines on a horizontal view: the paper's two ways, edges or two regions, each with a Hough transform."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from skimage.feature import canny
from skimage.filters import threshold_otsu
from skimage.transform import hough_line, hough_line_peaks

from palletloc.geometry import BoolArray, Image
from palletloc.plane import PlaneView

MIN_VOTES = 0.3
"""Least part of the view's width that a line must cover."""
PEAKS = 8
"""Most lines to return."""


@dataclass(frozen=True, slots=True)
class BoundaryLine:
    """A line on a horizontal view, nearly along its rows."""

    turn: float
    """Its angle to the view's rows: the correction of the yaw, in radians."""
    up: float
    """Where it crosses the view's centre line, in the plane's ``up`` coordinate, in metres."""
    votes: int
    """Pixels on the line."""


def boundary_lines(view: PlaneView, two_region: bool, max_turn: float, step: float) -> list[BoundaryLine]:
    """Find lines by a Hough transform.

    Parameters
    ----------
    view : PlaneView
        Horizontal plane.
    two_region : bool
        Take the boundary between two regions instead of edges.
    max_turn : float
        Largest angle to the view's rows, in radians.
    step : float
        Step of the angle, in radians.

    Returns
    -------
    list of BoundaryLine
        By votes, most first; empty where there is none.
    """
    gray = view.image
    if gray.ndim == 3:
        gray = np.asarray(cv2.cvtColor(gray, cv2.COLOR_BGR2GRAY), dtype=np.uint8)
    points = _two_region_boundary(gray) if two_region else canny(gray, sigma=1.5)
    points &= view.valid
    count = int(np.ceil(max_turn / step))
    # hough_line's angle is that of the line's normal: a line along the rows has 90 degrees
    angles = np.pi / 2 + np.arange(-count, count + 1) * step
    space, angles, distances = hough_line(points, theta=angles)
    least = MIN_VOTES * view.grid.columns
    votes, normals, rhos = hough_line_peaks(
        space, angles, distances, min_distance=3, min_angle=4, threshold=least, num_peaks=PEAKS
    )
    return [_line(view, float(n), float(r), int(v)) for v, n, r in zip(votes, normals, rhos, strict=True)]


def _line(view: PlaneView, normal: float, rho: float, votes: int) -> BoundaryLine:
    center = -view.grid.left / view.grid.resolution
    row = (rho - center * np.cos(normal)) / np.sin(normal)
    return BoundaryLine(np.pi / 2 - normal, float(view.grid.top - row * view.grid.resolution), votes)


def _two_region_boundary(gray: Image) -> BoolArray:
    """Return the first pixel of the far region in each column, scanned from the aisle."""
    far = gray > threshold_otsu(gray)
    near_is_bright = far[-gray.shape[0] // 4 :].mean() > 0.5
    region = ~far if near_is_bright else far
    region = cv2.medianBlur(region.astype(np.uint8), 5) > 0
    rows = gray.shape[0] - 1 - region[::-1].argmax(axis=0)
    boundary = np.zeros(gray.shape, dtype=bool)
    seen = region.any(axis=0)
    boundary[rows[seen], np.flatnonzero(seen)] = True
    return boundary
