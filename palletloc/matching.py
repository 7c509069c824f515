"""What an image of a plane says about edges: energy to match templates with, gradients to measure on."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from palletloc.geometry import Image

Energy = NDArray[np.float32]
"""(rows, columns) float32 image."""


@dataclass(frozen=True, slots=True)
class EdgeEnergy:
    """How much edge there is at each pixel of a plane view, 0 to 1, by direction."""

    level: Energy
    """(rows, columns) energy of edges that run along the rows."""
    upright: Energy
    """(rows, columns) energy of edges that run along the columns."""


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
    smooth = cv2.GaussianBlur(image, (3, 3), 0.8)
    across = cv2.Sobel(smooth, cv2.CV_32F, 1, 0, ksize=1, scale=0.5)
    down = cv2.Sobel(smooth, cv2.CV_32F, 0, 1, ksize=1, scale=0.5)
    return _strongest(np.asarray(across)), _strongest(np.asarray(down))


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
    return np.asarray(cv2.sqrt(cv2.transform(gradient * gradient, np.ones((1, 3), np.float32))), dtype=np.float32)


def _strongest(gradient: NDArray[Any]) -> Energy:
    magnitude = np.abs(gradient.astype(np.float32, copy=False))
    if magnitude.ndim == 2:
        return magnitude
    blue, green, red = cv2.split(magnitude)
    return np.asarray(cv2.max(cv2.max(blue, green), red), dtype=np.float32)


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
        Both directions, 0 to 1.
    """
    along_rows, along_columns = component_gradients(image)
    magnitude = cv2.magnitude(along_rows, along_columns)
    # Below about two gray levels there is noise, not edges, however dark the neighbourhood.
    local = cv2.boxFilter(magnitude, cv2.CV_32F, window, borderType=cv2.BORDER_REPLICATE) + 1.0
    scale = 1.0 / (np.maximum(magnitude, 1e-6) * local * saturation)
    width = 2 * dilation + 1
    level = np.minimum(along_columns * along_columns * scale, 1.0)
    upright = np.minimum(along_rows * along_rows * scale, 1.0)
    if dilation:
        level = cv2.dilate(level, np.ones((width, 1), np.uint8))
        upright = cv2.dilate(upright, np.ones((1, width), np.uint8))
    return EdgeEnergy(level, upright)
