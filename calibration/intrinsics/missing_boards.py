"""Why a shot shows no board: one of another size, or one that was printed as its mirror image or its negative."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from calibration.intrinsics.task import Chessboard, CodedBoard
from calibration.targets.board_detection import INVERTED, MIRRORED
from calibration.targets.chessboard import sees_chessboard
from palletloc.geometry import Image

_OTHER_SIZES = ((-1, -1), (1, 1), (-1, 0), (0, -1), (1, 0), (0, 1))
"""Corners more than stated, side by side and one above the other: squares taken for corners, or one miscounted."""
_LEAST = 3
"""Corners of a row at least: OpenCV knows no smaller boards."""


def why_no_board(
    image: Image, boards: Mapping[str, Chessboard | CodedBoard], sees_markers: Callable[[Image], bool]
) -> str:
    """Return why none of the boards is seen in a shot; empty where nothing can be said.

    Parameters
    ----------
    image : (height, width) array of uint8
        The shot in gray.
    boards : mapping of str to board
        Those that are looked for.
    sees_markers : callable
        Whether a shot shows one of the boards with markers.
    """
    if any(not isinstance(board, Chessboard) for board in boards.values()):
        if sees_markers(np.ascontiguousarray(image[:, ::-1])):
            return MIRRORED
        if sees_markers(np.asarray(255 - image)):
            return INVERTED
    for name, board in boards.items():
        if isinstance(board, Chessboard):
            for across, down in _OTHER_SIZES:
                columns, rows = board.columns + across, board.rows + down
                if min(columns, rows) >= _LEAST and sees_chessboard(image, columns, rows):
                    return (
                        f"it shows {columns} x {rows} inner corners, board {name} has {board.columns} x {board.rows}:"
                        " inner corners are counted, not squares"
                    )
    return ""
