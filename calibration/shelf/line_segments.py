"""Straight edges of a shot as great circles: segments found on gnomonic patches, where straight is straight."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import cv2
import numpy as np

from calibration.targets.patches import cut_patch, pixel_density
from palletloc.cameras.protocol import CameraModel
from palletloc.geometry import FloatArray, Image
from palletloc.mounting import Mounting

_LEAST_PX = 40.0
"""Shorter segments turn too easily, in pixels: by 0.7 degrees at 40."""
_END_ERROR_PX = 0.35
"""Standard deviation of a segment's ends across it, in pixels."""
_CLEAN = 1.0
"""Blur before segments are looked for, in pixels: against noise and compression."""


@dataclass(frozen=True, slots=True, eq=False)
class Segments:
    """Segments of one shot."""

    normals: FloatArray
    """(n, 3) unit normals of the planes through the camera and each segment, in the forklift frame."""
    middles: FloatArray
    """(n, 3) unit vectors towards their middles, in the forklift frame."""
    lengths: FloatArray
    """(n,) angles that they subtend, in radians."""
    sigma: FloatArray
    """(n,) standard deviation of each normal's turn about its middle, in radians."""


def find_segments(
    camera: CameraModel, mounting: Mounting, image: Image, directions: Iterable[FloatArray]
) -> Segments:
    """Find the segments around some directions.

    Parameters
    ----------
    camera : CameraModel
        Of the shot.
    mounting : Mounting
        Its mounting, for the frame of the result.
    image : (height, width) array of uint8
        The shot in gray.
    directions : iterable of (3,) arrays
        Where patches of 60 degrees look, in the forklift frame.

    Returns
    -------
    Segments
        Those at least 40 pixels long.
    """
    turn = mounting.camera_from_forklift[:3, :3]
    found = [_in_patch(camera, image, turn @ (ahead / np.linalg.norm(ahead))) for ahead in directions]
    normals, middles, lengths, sigma = (np.concatenate(parts) for parts in zip(*found, strict=True))
    return Segments(normals @ turn, middles @ turn, lengths, sigma)


def _in_patch(
    camera: CameraModel, image: Image, ahead: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    nothing = np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0), np.zeros(0)
    density = float(pixel_density(camera, ahead[None])[0])
    if not np.isfinite(density):
        return nothing
    patch, valid = cut_patch(camera, image, ahead, density)
    clean = cv2.GaussianBlur(patch.image, (0, 0), _CLEAN)
    detector = cv2.createLineSegmentDetector(cv2.LSD_REFINE_STD, 1.0)  # at full scale: shrinking shifts the ends
    lines: object = detector.detect(clean)[0]
    if lines is None:  # none found
        return nothing
    ends = np.asarray(lines, dtype=np.float64).reshape(-1, 2, 2)
    side = patch.image.shape[0]
    seen = cv2.erode(valid.astype(np.uint8), np.ones((7, 7), np.uint8))
    at = np.clip(np.rint(ends), 0, side - 1).astype(int)
    inside = (seen[at[..., 1], at[..., 0]] > 0).all(axis=1)
    length = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    ends, length = ends[inside & (length >= _LEAST_PX)], length[inside & (length >= _LEAST_PX)]
    rays = patch.directions(ends)
    normals = np.cross(rays[:, 0], rays[:, 1])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    middles = rays.sum(axis=1)
    middles /= np.linalg.norm(middles, axis=1, keepdims=True)
    angles = np.arccos(np.clip((rays[:, 0] * rays[:, 1]).sum(axis=1), -1, 1))
    return normals, middles, angles, np.sqrt(2) * _END_ERROR_PX / length
