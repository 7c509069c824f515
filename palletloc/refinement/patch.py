"""The surroundings of a face on a vertical plane, with what an edge of any direction would find there."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

from palletloc.geometry import BoolArray, FloatArray, Image, LevelPose
from palletloc.matching import Energy, channel_sum, smoothed
from palletloc.measurement import Reason
from palletloc.plane import PlaneView
from palletloc.shot import MIN_DISTANCE, Extent, Shot

WINDOW = (0.4, 0.2)
"""Width and height of the neighbourhood that an edge is compared with, in metres."""
SATURATION = 2.5
"""Multiple of the neighbourhood's mean gradient that counts as a full edge."""
SLOPE_STEP = 0.2
"""Level lines whose slopes differ by less are looked for alike."""
NOISE = 1.0
"""Gradients of this size are noise, in gray levels per pixel."""


@dataclass(frozen=True, slots=True)
class FacePatch:
    """A view of a vertical plane, on which faces at any pose nearby appear by central projection."""

    base: LevelPose
    """``forklift_from_pallet`` of a face that would lie on the plane with its origin at the plane's."""
    plane_from_camera: FloatArray
    """(3,) the camera's centre: right, up, towards the viewer, in metres."""
    view: PlaneView
    """The image."""
    smooth: Image
    """The image without what noise and grain do to colours."""
    tensor: tuple[Energy, Energy, Energy]
    """The structure tensor's elements (across columns, mixed, across rows), normalised by the neighbourhood."""
    upright: Energy
    """How much edge runs upright, 0 to 1, widened by a pixel."""
    any_direction: Energy
    """How much edge there is of any direction, 0 to 1."""
    _kept: dict[float, Energy] = field(default_factory=dict, repr=False, compare=False)

    def along_level(self, slope: float) -> Energy:
        """Return how much edge runs along lines of about a slope (up per right), 0 to 1, widened by a pixel."""
        rung = round(slope / SLOPE_STEP) * SLOPE_STEP
        if rung not in self._kept:
            # rows count downwards: the normal of such a line in pixels is (slope, 1) over its length
            xx, xy, yy = self.tensor
            energy = yy if rung == 0 else (yy + 2 * rung * xy + rung**2 * xx) / np.float32(1 + rung**2)
            self._kept[rung] = _widened(energy, (1, 3))
        return self._kept[rung]

    def fields_along(self, slopes: FloatArray) -> Iterator[tuple[NDArray[np.intp], Energy]]:
        """Yield which of several slopes are looked for alike, each time with what `along_level` returns for them."""
        rungs = np.rint(slopes / SLOPE_STEP)
        for rung in sorted(set(rungs.tolist())):
            yield np.flatnonzero(rungs == rung), self.along_level(rung * SLOPE_STEP)

    def appearing(self, pose: LevelPose, points: FloatArray) -> FloatArray:
        """Return where points of a face at a pose appear on the plane.

        Parameters
        ----------
        pose : LevelPose
            ``forklift_from_pallet``.
        points : (n, 2) array
            Right and up on the face, in metres.

        Returns
        -------
        (n, 2) array
            Right and up on the plane, in metres.
        """
        turn = pose.yaw - self.base.yaw
        cos, sin = math.cos(self.base.yaw), math.sin(self.base.yaw)
        x, y = pose.x - self.base.x, pose.y - self.base.y
        right, depth = sin * x - cos * y, cos * x + sin * y
        aside, above, away = self.plane_from_camera.tolist()
        across, up = points.T
        nearer = away / (away + depth + math.sin(turn) * across)
        seen = np.empty_like(points)
        seen[:, 0] = aside + (right - aside + math.cos(turn) * across) * nearer
        seen[:, 1] = above + (pose.z - self.base.z - above + up) * nearer
        return seen

    def colours(self, pose: LevelPose, points: FloatArray) -> tuple[FloatArray, BoolArray]:
        """Return what the smoothed image shows at points of a face.

        Parameters
        ----------
        pose : LevelPose
            ``forklift_from_pallet``.
        points : (n, 2) array
            Right and up on the face, in metres.

        Returns
        -------
        colours : (n, channels) array
            Of the nearest pixels; without meaning where a point is not seen.
        seen : (n,) array of bool
            Whether the view shows them.
        """
        column, row = np.rint(self.view.grid.pixels(self.appearing(pose, points))).astype(np.intp).T
        rows, columns = self.smooth.shape[:2]
        seen = (column >= 0) & (row >= 0) & (column < columns) & (row < rows)
        row, column = row.clip(0, rows - 1), column.clip(0, columns - 1)
        found = self.smooth[row, column].reshape(len(points), -1).astype(np.float64)
        return found, np.asarray(seen & self.view.valid[row, column])


def view_patch(shot: Shot, base: LevelPose, extent: Extent, resolution: float) -> FacePatch | Reason:
    """Project the surroundings of a face on its plane.

    Parameters
    ----------
    shot : Shot
        The shot.
    base : LevelPose
        ``forklift_from_pallet`` of a face on the plane.
    extent : (left, right, low, high)
        What to view around the face's origin, in metres.
    resolution : float
        Metres per pixel.

    Returns
    -------
    FacePatch or Reason
        `Reason.BEHIND_FACE` where the camera is not before the plane, `Reason.OUT_OF_VIEW` where it sees little.
    """
    camera = shot.camera_in(base)
    if camera[2] < MIN_DISTANCE:
        return Reason.BEHIND_FACE
    view = shot.vertical_view(base, extent, resolution)
    seen = np.count_nonzero(view.valid)
    if seen < 0.5 * view.valid.size:
        return Reason.OUT_OF_VIEW
    tensor = _tensor(view.image, resolution)
    if seen < view.valid.size:  # where the image ends there is no edge
        inside = cv2.erode(view.valid.astype(np.float32), np.ones((7, 7), np.uint8), borderValue=1.0)
        tensor = tensor[0] * inside, tensor[1] * inside, tensor[2] * inside
    upright, edges = _widened(tensor[0], (3, 1)), np.minimum(tensor[0] + tensor[2], np.float32(1.0))
    return FacePatch(base, camera, view, smoothed(view.image, resolution), tensor, upright, edges)


def _widened(energy: Energy, columns_rows: tuple[int, int]) -> Energy:
    """Return energy, at most 1, that reaches the neighbouring pixels, too."""
    kernel = np.ones(columns_rows[::-1], np.uint8)
    return np.asarray(cv2.dilate(np.minimum(energy, np.float32(1.0)), kernel), dtype=np.float32)


def _tensor(image: Image, resolution: float) -> tuple[Energy, Energy, Energy]:
    smooth = cv2.GaussianBlur(image, (3, 3), 0.8)
    across = np.asarray(cv2.Sobel(smooth, cv2.CV_32F, 1, 0, ksize=1, scale=0.5))
    down = np.asarray(cv2.Sobel(smooth, cv2.CV_32F, 0, 1, ksize=1, scale=0.5))
    if image.ndim == 3:
        xx, xy, yy = (channel_sum(a * b) for a, b in ((across, across), (across, down), (down, down)))
    else:
        xx, xy, yy = across * across, across * down, down * down
    size = np.sqrt(xx + yy)
    window = tuple(round(part / resolution) | 1 for part in WINDOW)
    local = cv2.boxFilter(size, cv2.CV_32F, window, borderType=cv2.BORDER_REPLICATE) + np.float32(NOISE)
    scale = 1.0 / (np.maximum(size, np.float32(1e-6)) * local * np.float32(SATURATION))
    return xx * scale, xy * scale, yy * scale
