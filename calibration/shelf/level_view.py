"""A shot as seen on an upright cylinder around the camera: what is vertical in the world is a column there."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.targets.patches import pixel_density, sample
from palletloc.cameras.protocol import CameraModel
from palletloc.geometry import FloatArray, Image, wrap_angle
from palletloc.mounting import Mounting

REACH = float(np.radians(72.0))
"""How far from straight into the shelf is looked, in radians."""
_LOW, _HIGH = -1.3, 0.9
"""Tangents of elevation that the view spans: the floor from 1.5 m on, uprights above the camera."""
_ROW_STEP = 1.5
"""Steps of the tangent over those of the azimuth: along an upright less is needed than across."""
_SMOOTH_PX = 1.5
"""Blur along the rows before the slope is taken, in columns: below it is noise."""
_BESIDE = 0.6
"""What a ridge counts in the columns beside it: edges of several shots meet within one."""


@dataclass(frozen=True, slots=True, eq=False)
class LevelView:
    """The view: columns are azimuths in the forklift frame, rows tangents of elevation, both increasing."""

    first: float
    """Azimuth of the first column, in radians."""
    step: float
    """Radians per column."""
    row_step: float
    """Tangent of elevation per row; the first row lies at `LOWEST`."""
    slope: FloatArray
    """(rows, columns) derivative of brightness by azimuth, per column of a smoothed view."""
    ridge: FloatArray
    """(rows, columns) 1 or -1 where that is clear and steepest along its row, less beside it, zero elsewhere."""
    light: float
    """Median brightness."""
    camera: FloatArray
    """(3,) the camera's place in the forklift frame, in metres."""

    @property
    def clear(self) -> float:
        """Slope from which on an edge is clear."""
        return _clear_slope(self.light)

    @property
    def columns(self) -> int:
        """How many columns there are."""
        return int(self.slope.shape[1])

    def column(self, azimuth: FloatArray) -> FloatArray:
        """Return the columns of azimuths, as real numbers."""
        middle = self.first + self.step * self.columns / 2
        return np.asarray(wrap_angle(azimuth - middle) / self.step + self.columns / 2)

    def azimuth(self, column: FloatArray) -> FloatArray:
        """Return the azimuths of columns."""
        return np.asarray(wrap_angle(self.first + self.step * column))

    def row(self, height: FloatArray, distance: FloatArray) -> FloatArray:
        """Return the rows of heights over the floor at a distance on the floor, as real numbers."""
        return np.asarray(((height - self.camera[2]) / distance - _LOW) / self.row_step)


def level_view(camera: CameraModel, mounting: Mounting, image: Image, towards: float, distance: float) -> LevelView:
    """Unroll a shot.

    Parameters
    ----------
    camera : CameraModel
        Of the shot.
    mounting : Mounting
        Its mounting, which says what is vertical.
    image : (height, width) array of uint8
        The shot in gray.
    towards : float
        Heading into the shelf in the forklift frame, in radians.
    distance : float
        About how far the shelf's front is, in metres; matters only where lenses have several centres.
    """
    camera_from_forklift = mounting.camera_from_forklift
    turn = camera_from_forklift[:3, :3]
    ahead = turn @ np.array([np.cos(towards), np.sin(towards), -0.3])
    density = float(pixel_density(camera, ahead[None] / np.linalg.norm(ahead))[0])
    step = 1 / density if np.isfinite(density) else 2 * np.pi / camera.width
    azimuth = towards + np.arange(-REACH, REACH, step)
    row_step = _ROW_STEP * step
    tangent = np.arange(_LOW, _HIGH, row_step)
    # A plane of rays at a time: the front's distance along each.
    along = distance / np.maximum(np.cos(azimuth - towards), 0.2)
    points = np.empty((len(tangent), len(azimuth), 3))
    points[..., 0] = np.cos(azimuth) * along
    points[..., 1] = np.sin(azimuth) * along
    points[..., 2] = tangent[:, None] * along
    pixels, valid = camera.project(points @ turn.T)
    seen = sample(camera, image, pixels).astype(np.float32)
    smooth = cv2.GaussianBlur(seen, (0, 0), _SMOOTH_PX, sigmaY=0.8)
    slope = np.zeros(seen.shape, np.float32)
    slope[:, 1:-1] = (smooth[:, 2:] - smooth[:, :-2]) / 2
    blind = cv2.dilate((~valid).astype(np.uint8), np.ones((1, 13), np.uint8)) > 0
    slope[blind] = 0.0
    light = float(np.median(seen[valid])) if valid.any() else 0.0
    center = np.asarray(mounting.center, dtype=np.float64)
    ridge = _ridge(slope / np.float32(_clear_slope(light)))
    return LevelView(float(azimuth[0]), step, row_step, slope.astype(np.float64), ridge, light, center)


def _clear_slope(light: float) -> float:
    """Return the slope from which on an edge is clear: two parts in a hundred of the light."""
    return max(0.5, 0.02 * light)


def _ridge(slope: NDArray[np.float32]) -> FloatArray:
    """Return the slope, cut off at 1, where no neighbour in its row is steeper, and a part of it beside that."""
    even = cv2.sepFilter2D(slope, -1, np.ones(1), cv2.getGaussianKernel(15, 3.0))
    steep = np.abs(even)
    top = np.where(steep >= cv2.dilate(steep, np.ones((1, 7), np.uint8)), np.clip(even, -1, 1), 0.0)
    wide = top.copy()
    wide[:, 1:] += _BESIDE * top[:, :-1]
    wide[:, :-1] += _BESIDE * top[:, 1:]
    return np.clip(wide, -1, 1).astype(np.float64)
