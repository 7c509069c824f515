"""Profiles of the image across the lines of a face, read straight from the shot through any camera."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from palletloc.cameras.protocol import CameraModel
from palletloc.geometry import BoolArray, FloatArray
from palletloc.refinement.cuts import FaceCuts
from palletloc.shot import Shot

STEP_PX = 0.5
"""Samples of a profile lie at most this far apart, in pixels of the image."""
MARGIN = 2
"""Samples beyond the reach at each end of a profile: a peak needs neighbours."""
MOST_SAMPLES = 40
"""Most samples within the reach on each side."""
SMOOTHING_PX = 0.6
"""Standard deviation of the smoothing across a line, in pixels of the image."""

Samples = NDArray[np.float32]
"""Float32 array."""
_SUM = np.ones((1, 3), np.float32)


@dataclass(frozen=True, slots=True)
class Profiles:
    """The image along each cut."""

    cuts: FaceCuts
    """The cuts."""
    sampled: Samples
    """(n, samples) or (n, samples, 3) gray levels or colours."""
    offsets: FloatArray
    """(samples,) positions along a cut, in parts of the reach."""
    valid: BoolArray
    """(n,) whether the camera sees the whole cut."""
    reach: FloatArray
    """(lines,) how far cuts go to each side, in metres."""
    pixel: FloatArray
    """(lines, 2) size of a pixel across and along each line, the same for all lines of a direction, in metres."""

    def gradient(self, along_px: float) -> Samples:
        """Return how fast the image changes across each line.

        Parameters
        ----------
        along_px : float
            Standard deviation of the smoothing along a line, in pixels of the image.

        Returns
        -------
        (n, samples) array
            Absolute derivative, the norm over the colour channels, in gray levels per sample.
        """
        gradient = np.empty(self.sampled.shape[:2], np.float32)
        step = float(self.offsets[1] - self.offsets[0])
        for kind in self.cuts.kinds:
            reach = self.reach[kind.lines]
            across, along = self.pixel[kind.lines][0].tolist()
            smooth = SMOOTHING_PX * across / (step * float(reach.sum()) / len(reach)), along_px * along / kind.spacing
            gradient[kind.cuts] = _derivative(self.sampled[kind.cuts], *smooth)
        return gradient


def cut_profiles(
    shot: Shot,
    camera_from_face: FloatArray,
    cuts: FaceCuts,
    shift: FloatArray,
    reach: FloatArray,
    pixel: FloatArray,
) -> Profiles:
    """Sample the image along cuts.

    Parameters
    ----------
    shot : Shot
        The shot.
    camera_from_face : (4, 4) array
        The face's plane: x right, y up.
    cuts : FaceCuts
        Where to cut.
    shift : (lines,) array
        How far outward of each drawn line its cuts have their middle, in metres.
    reach : (lines,) array
        How far cuts go to each side, in metres.
    pixel : (lines, 2) array
        Size of a pixel across and along each line, in metres.

    Returns
    -------
    Profiles
        A row for each cut.
    """
    half = min(max(math.ceil(float((reach / pixel[:, 0]).max()) / STEP_PX), 4), MOST_SAMPLES)
    steps = np.arange(-half - MARGIN, half + MARGIN + 1) / half
    middle, away, valid = _places(shot.camera, camera_from_face, cuts, shift, reach)
    first, way, parts = (part.astype(np.float32) for part in (middle, away, steps))
    columns, rows = (first[:, axis, None] + parts * way[:, axis, None] for axis in (0, 1))
    border = cv2.BORDER_REPLICATE if shot.camera.period_px is None else cv2.BORDER_WRAP
    sampled = np.asarray(cv2.remap(shot.image, columns, rows, cv2.INTER_LINEAR, borderMode=border), dtype=np.float32)
    return Profiles(cuts, sampled, steps, valid, reach, pixel)


def _places(
    camera: CameraModel, camera_from_face: FloatArray, cuts: FaceCuts, shift: FloatArray, reach: FloatArray
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Return the pixels of the cuts' middles, the way from there to the ends of their reach, and what is seen."""
    outwards = np.array([shift, shift + reach])[:, cuts.line, None]
    both = cuts.points + outwards * cuts.outward
    seen = camera.project(both @ camera_from_face[:3, :2].T + camera_from_face[:3, 3])
    valid = seen.valid[0] & seen.valid[1]
    middle, away = seen.pixels[0], seen.pixels[1] - seen.pixels[0]
    if camera.period_px is not None and np.abs(away[:, 0]).max() > camera.period_px / 2:
        away[:, 0] -= camera.period_px * np.rint(away[:, 0] / camera.period_px)
    if not valid.all():
        middle, away = (np.where(valid[:, None], part, 0.0) for part in (middle, away))
    return middle, away, valid


def _derivative(sampled: Samples, across: float, along: float) -> Samples:
    """Return the absolute derivative of smoothed profiles along their samples, the norm over the channels."""
    radius, width = max(1, round(3 * across)), max(1, round(2.5 * along))
    at = np.arange(-float(radius), radius + 1)
    slope = at * cv2.getGaussianKernel(len(at), max(across, 0.5))[:, 0]
    slope /= slope @ at
    smooth = cv2.getGaussianKernel(2 * width + 1, max(along, 0.2))
    change = cv2.sepFilter2D(sampled, cv2.CV_32F, slope, smooth, borderType=cv2.BORDER_REPLICATE)
    if change.ndim == 2:
        return np.asarray(np.abs(change), dtype=np.float32)
    return np.sqrt(np.asarray(cv2.transform(change * change, _SUM), dtype=np.float32))
