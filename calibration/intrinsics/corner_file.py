"""Corners that were found by another program: our CSV, or OpenCV's storage with objectPoints and imagePoints."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from calibration.formats.fields import StorageFile
from calibration.lenses.problem import BoardView
from palletloc.geometry import FloatArray
from palletloc.io.reading import InputError, read_text

_SIGMA_PX = 0.02
"""No corners are better than this; the fit says how much worse."""
_COLUMNS = ("shot", "board", "lens", "x_m", "y_m", "z_m", "u_px", "v_px")
"""Of the table of corners."""
_FEWEST = 4
"""Corners of a view at least: they give its pose."""


def read_corners(path: Path, size: tuple[int, int], lenses: int, *, fixed: bool) -> list[BoardView]:
    """Return the boards that a file of corners holds.

    Parameters
    ----------
    path : Path
        Ends in ``.csv``, or in ``.xml``, ``.yml``, ``.yaml`` or ``.json`` as OpenCV writes them.
    size : (int, int)
        Width and height of the shots, in pixels.
    lenses : int
        How many the camera has.
    fixed : bool
        Whether the boards keep their places against each other.

    Raises
    ------
    InputError
        If the file is missing or does not hold corners; names the line or the key.
    """
    if path.suffix.lower() == ".csv":
        return _from_table(path, size, lenses, fixed=fixed)
    return _from_storage(path, size)


def _from_table(path: Path, size: tuple[int, int], lenses: int, *, fixed: bool) -> list[BoardView]:
    lines = read_text(path).splitlines()
    if not lines or tuple(cell.strip() for cell in lines[0].split(",")) != _COLUMNS:
        raise InputError(f"{path}, line 1: expected the columns {','.join(_COLUMNS)}")
    groups: dict[tuple[str, str, int], list[FloatArray]] = {}
    for number, line in enumerate(lines[1:], start=2):
        if not line.strip():
            continue
        cells = [cell.strip() for cell in line.split(",")]
        try:
            lens, values = int(cells[2]), np.array([float(cell) for cell in cells[3:]])
        except (ValueError, IndexError):
            raise InputError(f"{path}, line {number}: expected two names, a lens and five numbers") from None
        if len(values) != 5 or not np.isfinite(values).all():
            raise InputError(f"{path}, line {number}: expected {len(_COLUMNS)} cells with finite numbers")
        if not 0 <= lens < lenses:
            raise InputError(f"{path}, line {number}: lens {lens} does not exist; expected 0 to {lenses - 1}")
        groups.setdefault((cells[0], cells[1], lens), []).append(values)
    shots = list(dict.fromkeys(key[0] if fixed else key[:2] for key in groups))
    boards = list(dict.fromkeys(key[1] for key in groups))
    views = []
    for (shot, board, lens), rows in groups.items():
        table = np.array(rows)
        name = shot + (f" {board}" if len(boards) > 1 else "") + (f" lens {lens}" if lenses > 1 else "")
        number = shots.index(shot if fixed else (shot, board))
        views.append(_view(path, name, number, boards.index(board) if fixed else 0, lens, table, size))
    return views


def _view(
    path: Path, name: str, shot: int, board: int, lens: int, table: FloatArray, size: tuple[int, int]
) -> BoardView:
    if len(table) < _FEWEST:
        raise InputError(f"{path}: {name}: has {len(table)} corners, expected {_FEWEST} at least")
    pixels = table[:, 3:]
    if (pixels < -1).any() or (pixels > size).any():
        raise InputError(f"{path}: {name}: has corners off the image of {size[0]} x {size[1]} px")
    return BoardView(name, shot, board, lens, table[:, :3], pixels, np.full(len(table), _SIGMA_PX))


def _from_storage(path: Path, size: tuple[int, int]) -> list[BoardView]:
    storage = StorageFile(path)
    points, pixels = storage.node("objectPoints"), storage.node("imagePoints")
    if not (points.isSeq() and pixels.isSeq() and points.size() == pixels.size() > 0):
        raise InputError(f"{path}: objectPoints and imagePoints: expected two lists of the same length")
    stated = storage.numbers("imageSize")
    if stated is not None and tuple(stated) != size:
        raise InputError(
            f"{path}: imageSize: is {' x '.join(f'{side:g}' for side in stated)} px, the camera is"
            f" {size[0]} x {size[1]} px"
        )
    views = []
    for i in range(points.size()):
        board, seen = _rows(path, "objectPoints", i, points.at(i), 3), _rows(path, "imagePoints", i, pixels.at(i), 2)
        if len(board) != len(seen):
            raise InputError(f"{path}: imagePoints[{i}]: has {len(seen)} corners, objectPoints has {len(board)}")
        views.append(_view(path, f"view {i + 1}", i, 0, 0, np.concatenate([board, seen], axis=1), size))
    return views


def _rows(path: Path, key: str, i: int, node: cv2.FileNode, width: int) -> FloatArray:
    """Return a list of points that is stored as a matrix with channels or columns."""
    values = np.empty(0) if node.empty() or not node.isMap() else np.asarray(node.mat(), dtype=np.float64)
    if not values.size or values.size % width or not np.isfinite(values).all():
        raise InputError(f"{path}: {key}[{i}]: expected points of {width} finite numbers")
    return values.reshape(-1, width)
