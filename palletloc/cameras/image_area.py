"""What the camera models share about their image: its size and which pixels lie on it."""

from __future__ import annotations

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
