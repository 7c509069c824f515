"""Plain chessboards in shots: OpenCV's sector-based detector, which needs no lens model."""

from __future__ import annotations

import cv2
import numpy as np

from calibration.intrinsics.task import Chessboard
from palletloc.geometry import FloatArray, Image

SIGMA_PX = 0.03
"""The detector's corners are not better than this; the fit says how much worse."""


def find_chessboard(image: Image, board: Chessboard) -> FloatArray | None:
    """Return the pixels of a board's inner corners, (n, 2), row by row; None where it is not seen whole.

    Parameters
    ----------
    image : (height, width) array of uint8
        In gray.
    board : Chessboard
        What to look for.
    """
    flags = cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY | cv2.CALIB_CB_NORMALIZE_IMAGE
    found, corners = cv2.findChessboardCornersSB(image, (board.columns, board.rows), flags=flags)
    return np.asarray(corners, dtype=np.float64).reshape(-1, 2) if found else None
