"""What the camera models share about their image: its size and which pixels lie on it."""

from __future__ import annotations

import math

import numpy as np

from palletloc.geometry import BoolArray, FloatArray


def check_size(width: int, height: int) -> None:
    """Refuse an image without pixels.

    Raises
    ------
    ValueError
        If a side is not positive.
    """
    if not (width > 0 and height > 0):
        raise ValueError(f"an image needs a positive width and height in pixels, got {width} x {height}")


def check_lens(fx: float, fy: float, others: tuple[float, ...]) -> None:
    """Refuse focal lengths that are not positive, and parameters that are not finite numbers.

    Raises
    ------
    ValueError
        If one of them is.
    """
    if not (0 < fx < math.inf and 0 < fy < math.inf):
        raise ValueError(f"focal lengths must be positive, in pixels, got fx {fx}, fy {fy}")
    if not all(math.isfinite(value) for value in others):
        raise ValueError(f"lens parameters must be finite numbers, got {others}")


def check_angle(max_angle: float) -> None:
    """Refuse a largest angle off axis that is none.

    Raises
    ------
    ValueError
        If it is not in (0, pi].
    """
    if not 0 < max_angle <= math.pi:
        raise ValueError(f"max_angle must be in (0, pi] radians, got {max_angle}")


def inside_image(pixels: FloatArray, width: int, height: int) -> BoolArray:
    """Return which pixel coordinates lie on the image, whose outermost pixels end half a pixel further out.

    Parameters
    ----------
    pixels : (..., 2) array
        Columns and rows; NaN lies outside.
    width, height : int
        Size of the image in pixels.

    Returns
    -------
    (...) array of bool
    """
    u, v = pixels[..., 0], pixels[..., 1]
    inside: BoolArray = (u >= -0.5) & (u <= width - 0.5) & (v >= -0.5) & (v <= height - 0.5)
    return inside


def blank_invalid(values: FloatArray, valid: BoolArray) -> None:
    """Set the rows of ``values``, (..., n), that are not valid to NaN, in place."""
    if not valid.all():
        values[~valid] = np.nan
