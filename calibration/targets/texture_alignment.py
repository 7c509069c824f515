"""Corners to a few hundredths of a pixel: the shot is laid onto the paper and compared with what is printed.

Around each corner the shift, gain and offset are found that make the printed texture agree with the image
(B. Lucas, T. Kanade, "An iterative image registration technique", IJCAI 1981).
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from calibration.bearings import refine_pose
from calibration.targets.patches import AnyImage, pixel_density, sample
from calibration.targets.targets import CERTAIN, PrintedPattern, coverage, on_board
from palletloc.cameras.protocol import CameraModel
from palletloc.geometry import BoolArray, FloatArray, Image

Indices = NDArray[np.signedinteger]
"""Rows or columns of windows around corners."""

_BLURS = (0.5, 0.7, 1.0, 1.4, 2.0, 2.8)
"""Blurs of the print that are tried, standard deviations in cells: from a sharp lens to motion of some pixels."""
_ROUNDS, _STEPS = 2, 8
"""How often the shot is laid onto the paper, and steps of the shift each time; the second round starts at the pose
of the first."""
_MIN_NCC = 0.6
"""Corners whose image and print correlate less are refused: something covers them."""
_MIN_GAIN = 12.0
"""Corners between black and white that are fewer gray levels apart are refused."""
_MAX_SHIFT = 0.3
"""Corners that moved by more are refused, in squares: the next corner is one square away."""
_FLOOR_PX = 0.02
"""Least standard deviation of a corner, in pixels: neither prints nor lens models are truer."""
_FINER = 1.2
"""Cells of the paper per pixel of the shot."""
_LEAST_WINDOW, _LARGEST_WINDOW = 3, 24
"""Half sides of the smallest and the largest window around a corner, in cells."""


@dataclass(frozen=True, slots=True, eq=False)
class AlignedCorners:
    """Corners of one target in one shot."""

    points: FloatArray
    """(n, 2) where they are printed, in pattern coordinates."""
    pixels: FloatArray
    """(n, 2) where they are seen."""
    bearings: FloatArray
    """(n, 3) unit vectors in the camera frame."""
    origins: FloatArray
    """(n, 3) where the bearings start, in metres."""
    sigma: FloatArray
    """(n,) standard deviations of the bearings, in radians."""
    pixel_angle: FloatArray
    """(n,) how many radians a pixel is wide there."""
    correlation: FloatArray
    """(n,) normalised correlation of image and print, at most 1."""
    camera_from_board: RigidTransform
    """Pose of the target, from these corners alone."""


@dataclass(frozen=True, slots=True, eq=False)
class _Rectified:
    """The shot laid onto the paper."""

    image: FloatArray
    valid: BoolArray
    x: FloatArray
    y: FloatArray
    pitch: float

    def place(self, points: FloatArray) -> FloatArray:
        """Return the columns and rows of points of the pattern."""
        place: FloatArray = (points - [self.x[0], self.y[0]]) / self.pitch
        return place


def align_corners(
    camera: CameraModel, image: Image, pattern: PrintedPattern, camera_from_board: RigidTransform
) -> AlignedCorners | None:
    """Measure the corners of a target against its print.

    Parameters
    ----------
    camera, image
        As for `sphere_patches`.
    pattern : PrintedPattern
        What is printed.
    camera_from_board : RigidTransform
        Rough pose, a third of a square off at most.

    Returns
    -------
    AlignedCorners, optional
        None where fewer than four corners agree with the print.
    """
    aligned = None
    source = image.astype(np.float32)
    for _ in range(_ROUNDS):
        pitch = _pitch(camera, pattern, camera_from_board)
        if pitch is None:
            return None
        rectified = _rectify(camera, source, pattern, camera_from_board, pitch)
        shifts, sigma, correlation = _align(rectified, pattern)
        good = np.isfinite(sigma)
        if good.sum() < 4:
            return None
        seen = pattern.corners[good] + shifts[good]
        aligned = _bearings(camera, camera_from_board, pattern.corners[good], seen, sigma[good], correlation[good])
        if aligned is None:
            return None
        camera_from_board = aligned.camera_from_board
    return aligned


def _project(camera: CameraModel, pose: RigidTransform, points: FloatArray) -> FloatArray:
    flat = on_board(points).reshape(-1, 3)
    return camera.project(pose.apply(flat)).pixels.reshape(points.shape)


def _pitch(camera: CameraModel, pattern: PrintedPattern, pose: RigidTransform) -> float | None:
    """Return the width of a cell on the paper so that cells are a little finer than pixels are."""
    size = min(pattern.width, pattern.height) / 10
    middle = np.array([pattern.width, pattern.height]) / 2
    ends = middle + size * np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
    rays = pose.apply(on_board(np.concatenate([ends, middle[None]])))
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    # By angles, not by pixels: at the pole of a panorama, columns tell nothing.
    angle = float(np.linalg.norm(rays[[0, 2]] - rays[[1, 3]], axis=-1).min())
    length = angle * float(pixel_density(camera, rays[4:])[0])
    return 2 * size / (_FINER * length) if np.isfinite(length) and length > 1 else None


def _rectify(
    camera: CameraModel, image: AnyImage, pattern: PrintedPattern, pose: RigidTransform, pitch: float
) -> _Rectified:
    margin = pattern.window + 4 * pitch
    x = np.arange(-margin, pattern.width + margin, pitch)
    y = np.arange(-margin, pattern.height + margin, pitch)
    points = np.stack(np.meshgrid(x, y), axis=-1)
    pixels = _project(camera, pose, points)
    valid = np.isfinite(pixels).all(-1)
    seen = sample(camera, image, pixels).astype(np.float64)
    return _Rectified(seen, np.asarray(valid, dtype=np.bool_), x, y, pitch)


def _align(rectified: _Rectified, pattern: PrintedPattern) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return shifts in metres, their standard deviations (NaN where refused) and the correlations."""
    half = int(np.clip(pattern.window / rectified.pitch - 1, _LEAST_WINDOW, _LARGEST_WINDOW))
    print_ = 1 - coverage(pattern, rectified.x, rectified.y, rectified.pitch)
    place = np.round(rectified.place(pattern.corners)).astype(np.intp)
    offset = np.arange(-half, half + 1)
    rows = place[:, 1, None, None] + offset[:, None]
    columns = place[:, 0, None, None] + offset
    texture = _best_blur(print_, rectified, rows, columns)
    gradient = np.gradient(texture)
    windows = _Windows(texture[rows, columns], gradient[1][rows, columns], gradient[0][rows, columns])
    shift, gain, deviation, correlation = _descend(windows, rectified.image, rows, columns)
    sigma = np.maximum(deviation, _FLOOR_PX * _FINER) * rectified.pitch
    shifts = shift * rectified.pitch
    refused = ~rectified.valid[rows, columns].all((1, 2))
    refused |= (correlation < _MIN_NCC) | (gain < _MIN_GAIN)
    refused |= ~(np.linalg.norm(shifts, axis=-1) < _MAX_SHIFT * pattern.window / CERTAIN)
    sigma[refused] = np.nan
    return shifts, sigma, correlation


def _best_blur(print_: FloatArray, rectified: _Rectified, rows: Indices, columns: Indices) -> FloatArray:
    """Return the print with the blur that agrees best with the image around the corners."""
    seen = rectified.image[rows, columns]
    blurred = [np.asarray(cv2.GaussianBlur(print_, (0, 0), sigma), dtype=np.float64) for sigma in _BLURS]
    scores = [float(np.median(_correlation(print_[rows, columns], seen))) for print_ in blurred]
    return blurred[int(np.argmax(scores))]


def _correlation(a: FloatArray, b: FloatArray) -> FloatArray:
    a = a - a.mean((1, 2), keepdims=True)
    b = b - b.mean((1, 2), keepdims=True)
    size = np.sqrt((a * a).sum((1, 2)) * (b * b).sum((1, 2)))
    correlation: FloatArray = (a * b).sum((1, 2)) / np.maximum(size, 1e-9)
    return correlation


@dataclass(frozen=True, slots=True, eq=False)
class _Windows:
    """The print around each corner, (n, w, w), and its derivatives by column and row."""

    texture: FloatArray
    by_column: FloatArray
    by_row: FloatArray


def _descend(
    windows: _Windows, image: FloatArray, rows: Indices, columns: Indices
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return shift and its standard deviation in cells, gain, and correlation, of each corner."""
    count = len(windows.texture)
    flat = windows.texture.reshape(count, -1)
    ones = np.ones_like(flat)
    shift = np.zeros((count, 2))
    for _ in range(_STEPS):
        seen = _shifted(image, rows, columns, shift)
        # The shift acts on the print's derivatives times the gain, which is the last fit's.
        design = np.stack(
            [windows.by_column.reshape(count, -1), windows.by_row.reshape(count, -1), flat, ones], axis=-1
        )
        normal = np.einsum("nki,nkj->nij", design, design) + 1e-9 * np.eye(4)
        values = seen.reshape(count, -1)
        solution = np.linalg.solve(normal, np.einsum("nki,nk->ni", design, values)[..., None])[..., 0]
        gain = np.where(np.abs(solution[:, 2]) > 1e-6, solution[:, 2], np.nan)
        step = np.nan_to_num(solution[:, :2] / gain[:, None])
        shift += np.clip(-step, -1.0, 1.0)
    residual = values - np.einsum("nki,ni->nk", design, solution)
    variance = (residual**2).sum(1) / max(flat.shape[1] - 4, 1)
    spread = np.linalg.inv(normal)[:, (0, 1), (0, 1)].mean(1)
    deviation = np.sqrt(variance * spread) / np.abs(gain) * _FINER
    return shift, np.nan_to_num(gain), deviation, _correlation(windows.texture, seen)


def _shifted(image: FloatArray, rows: Indices, columns: Indices, shift: FloatArray) -> FloatArray:
    """Return the image around each corner, (n, w, w), read at a shift."""
    count, side = rows.shape[0], rows.shape[1]
    across = np.broadcast_to(columns + shift[:, 0, None, None], (count, side, side)).reshape(-1, side)
    down = np.broadcast_to(rows + shift[:, 1, None, None], (count, side, side)).reshape(-1, side)
    maps = (across.astype(np.float32), down.astype(np.float32))
    read = cv2.remap(image.astype(np.float32), *maps, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(read, dtype=np.float64).reshape(count, side, side)


def _bearings(
    camera: CameraModel,
    pose: RigidTransform,
    points: FloatArray,
    seen: FloatArray,
    sigma: FloatArray,
    correlation: FloatArray,
) -> AlignedCorners | None:
    """Return what the camera sees of places on the paper, and the pose that follows."""
    pixels = _project(camera, pose, seen)
    bearings, origins, valid = camera.unproject(pixels)
    if valid.sum() < 4:
        return None
    distance = np.linalg.norm(pose.apply(on_board(seen)) - origins, axis=-1)
    pixel_angle = _pixel_angle(camera, pixels)
    spread = np.maximum(sigma / distance, _FLOOR_PX * pixel_angle)
    at = on_board(points[valid])
    refined = refine_pose(pose, at, bearings[valid], origins[valid], spread[valid])
    return AlignedCorners(
        points[valid],
        pixels[valid],
        bearings[valid],
        origins[valid],
        spread[valid],
        pixel_angle[valid],
        correlation[valid],
        refined,
    )


def _pixel_angle(camera: CameraModel, pixels: FloatArray) -> FloatArray:
    """Return the side of a square as large as a pixel, in radians."""
    step = np.array([[[0.25, 0.0]], [[0.0, 0.25]]])
    right, down = camera.unproject(pixels + step).directions - camera.unproject(pixels - step).directions
    area = 4 * np.linalg.norm(np.cross(right, down), axis=-1)
    side: FloatArray = np.sqrt(np.nan_to_num(area, nan=float(np.nanmedian(area))))
    return side
