"""Arrays with one column per ray or point: the renderer's currency."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

Samples = NDArray[np.float32]
"""Float32 array with one column per ray or point: (N,), or (3, N) for vectors."""
Indices = NDArray[np.intp]
"""(N,) indices of rays, tiles or solids."""

_ROW = 2048
"""Width in which places are laid out for `cv2.remap`, whose sides end at 32 767."""


def lengths(vectors: Samples) -> Samples:
    """Return the (N,) lengths of (3, N) vectors."""
    squared: Samples = np.einsum("ij,ij->j", vectors, vectors)
    return np.sqrt(squared)


def lookup(image: Samples, columns: Samples, rows: Samples, outside: float = 0.0) -> Samples:
    """Read an image at any number of places, linearly between its pixels.

    Parameters
    ----------
    image : (height, width) array
        The image.
    columns, rows : (N,) array
        Where, in pixels.
    outside : float
        What lies beyond its border.
    """
    count = len(columns)
    width = min(count, _ROW)
    height = -(-count // width) if count else 0
    if not height:
        return np.zeros(0, np.float32)
    padded = np.zeros((2, height * width), np.float32)
    padded[0, :count] = columns
    padded[1, :count] = rows
    maps = padded.reshape(2, height, width)
    read = cv2.remap(image, maps[0], maps[1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=outside)
    return np.asarray(read, np.float32).reshape(-1)[:count]
