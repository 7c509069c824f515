"""What an image of a plane says about edges: energy to match templates with, gradients to measure on."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from palletloc.geometry import Image

Energy = NDArray[np.float32]
"""(rows, columns) float32 image."""
FULL = 255
"""Energy of a full edge: a byte holds it finely enough, and bytes are averaged and looked up fastest."""
NOISE = 1.0
"""Part of the local mean that is always there, in gray levels per pixel: below about twice that there is noise, not
edges, however dark the neighbourhood."""
SMOOTHING = 0.006
"""Standard deviation of the smoothing before colours are compared, in metres: the grain of wood is finer."""
_CHANNEL_SUM = np.ones((1, 3), np.float32)
"""Adds up three channels."""


@dataclass(frozen=True, slots=True)
class EdgeEnergy:
    """How much edge there is at each pixel of a plane view, 0 to `FULL`, by direction."""

    level: Image
    """(rows, columns) energy of edges that run along the rows."""
    upright: Image
    """(rows, columns) energy of edges that run along the columns."""


def smoothed(image: Image, resolution: float) -> Image:
    """Return a view's image, of so many metres per pixel, without what noise and grain do to colours."""
    return np.asarray(cv2.GaussianBlur(image, (0, 0), max(SMOOTHING / resolution, 0.5)), dtype=np.uint8)


def component_gradients(image: Image) -> tuple[Energy, Energy]:
    """Return the absolute gradients along columns and rows, the larger of the colour channels.

    Parameters
    ----------
    image : (rows, columns) or (rows, columns, 3) array
        Gray or colour.

    Returns
    -------
    along_rows, along_columns : (rows, columns) float32 arrays
        Gray levels per pixel: the change from column to column, and from row to row.
    """
    across, down = _differences(image)
    return np.multiply(across, np.float32(0.5)), np.multiply(down, np.float32(0.5))


def _differences(image: Image) -> tuple[Image, Image]:
    """Return the absolute differences of the neighbours in the row and in the column, the larger of the channels.

    They are twice the gradients, and 0 on the border.
    """
    across, down = np.zeros(image.shape[:2], np.uint8), np.zeros(image.shape[:2], np.uint8)
    for channel in [image] if image.ndim == 2 else cv2.split(image):
        smooth = cv2.GaussianBlur(channel, (3, 3), 0.8)
        beside, above = across[:, 1:-1], down[1:-1]
        np.maximum(beside, cv2.absdiff(smooth[:, 2:], smooth[:, :-2]), out=beside)
        np.maximum(above, cv2.absdiff(smooth[2:], smooth[:-2]), out=above)
    return across, down


def gradient_across(image: Image, horizontal: bool, across_px: float, along_px: float) -> Energy:
    """Return the absolute gradient across edges of one direction, smoothed along them.

    The smoothing averages noise and texture before the sign is lost; a Gaussian as wide as the camera's pixels
    keeps the peaks of an enlarged view from following its interpolation.

    Parameters
    ----------
    image : (rows, columns) or (rows, columns, 3) array
        Gray or colour.
    horizontal : bool
        Whether the edges run along the rows.
    across_px, along_px : float
        Standard deviations of the smoothing, in pixels of the view.

    Returns
    -------
    (rows, columns) float32 array
        Norm over the colour channels, in gray levels per pixel.
    """
    sigma = (along_px, across_px) if horizontal else (across_px, along_px)
    smooth = cv2.GaussianBlur(image.astype(np.float32), (0, 0), max(sigma[0], 0.3), sigmaY=max(sigma[1], 0.3))
    order = (0, 1) if horizontal else (1, 0)
    gradient = cv2.Sobel(smooth, cv2.CV_32F, *order, ksize=1, scale=0.5)
    if gradient.ndim == 2:
        return np.abs(gradient)
    return np.asarray(cv2.sqrt(channel_sum(gradient * gradient)), dtype=np.float32)


def channel_sum(channels: NDArray[np.float32]) -> Energy:
    """Return the sum over three colour channels, the last axis."""
    return np.asarray(cv2.transform(channels, _CHANNEL_SUM), dtype=np.float32)


def edge_energy(image: Image, window: tuple[int, int], saturation: float = 2.5, dilation: int = 1) -> EdgeEnergy:
    """Return edge energy that does not depend on light and contrast.

    Each gradient is split by direction, divided by the local mean, saturated and widened by ``dilation`` pixels,
    so that one strong edge counts no more than a clear weak one.

    Parameters
    ----------
    image : (rows, columns) or (rows, columns, 3) array
        View of a plane.
    window : (int, int)
        Columns and rows of the neighbourhood for the local mean.
    saturation : float
        Multiple of the local mean that counts as a full edge.
    dilation : int
        Pixels by which edges are widened across their direction.

    Returns
    -------
    EdgeEnergy
        Both directions, 0 to `FULL`.
    """
    along_rows, along_columns = (twice.astype(np.float32) for twice in _differences(image))
    # in place: the pages of new arrays cost more than the arithmetic
    full = np.asarray(cv2.magnitude(along_rows, along_columns), dtype=np.float32)
    local = np.asarray(cv2.boxFilter(full, cv2.CV_32F, window, borderType=cv2.BORDER_REPLICATE), dtype=np.float32)
    local += np.float32(2 * NOISE)
    full *= local
    np.maximum(full, np.float32(1e-6), out=full)
    width, scale = 2 * dilation + 1, FULL / saturation
    level = cv2.divide(cv2.multiply(along_columns, along_columns, dst=along_columns), full, None, scale, cv2.CV_8U)
    upright = cv2.divide(cv2.multiply(along_rows, along_rows, dst=along_rows), full, None, scale, cv2.CV_8U)
    if dilation:
        level = cv2.dilate(level, np.ones((width, 1), np.uint8))
        upright = cv2.dilate(upright, np.ones((1, width), np.uint8))
    return EdgeEnergy(np.asarray(level, dtype=np.uint8), np.asarray(upright, dtype=np.uint8))
