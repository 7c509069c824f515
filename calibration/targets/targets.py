"""Printed targets: what black squares a board or a tag has, and which of its corners are measured.

PrintedPattern coordinates are in metres on the paper, seen from its front: x to the right, y down, from the upper
left corner of the pattern, which is the outer edge of its outermost squares. With z into the paper they are
the right-handed board frame.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from palletloc.errors import PalletLocError, nearest_name
from palletloc.geometry import FloatArray


class TargetError(PalletLocError):
    """A target that cannot exist: an unknown dictionary, too few markers in it, or sizes that do not fit."""


@dataclass(frozen=True, slots=True)
class CharucoBoard:
    """A chessboard with a marker in each white square."""

    columns: int
    """Squares side by side."""
    rows: int
    """Squares one above the other."""
    square: float
    """Side of a square, in metres."""
    marker: float
    """Side of a marker, its black border included, in metres."""
    dictionary: str
    """As OpenCV names it, such as ``DICT_4X4_250``."""
    first_id: int = 0
    """Of the marker at the upper left; the others count on, row by row."""


@dataclass(frozen=True, slots=True)
class SingleTag:
    """One ArUco or AprilTag marker."""

    size: float
    """Side of the black border's outer edge, in metres."""
    dictionary: str
    """As OpenCV names it, such as ``DICT_APRILTAG_36h11``."""
    id: int
    """Its number in the dictionary."""


@dataclass(frozen=True, slots=True)
class AprilGrid:
    """Kalibr's grid of AprilTags, with a small black square wherever four of them meet.

    As ``kalibr_create_target_pdf`` prints it: ids count from the lower left, row by row, and tags are turned by 180
    degrees against OpenCV's.
    """

    columns: int
    """Tags side by side."""
    rows: int
    """Tags one above the other."""
    tag: float
    """Side of a tag's black border, in metres."""
    spacing: float
    """Room between tags, as a part of their side."""
    first_id: int = 0
    """Of the tag at the lower left."""
    border: int = 2
    """Width of the black border, in modules."""
    dictionary: str = "DICT_APRILTAG_36h11"
    """As OpenCV names it."""


Target = CharucoBoard | SingleTag | AprilGrid
"""Any target."""


@dataclass(frozen=True, slots=True, eq=False)
class PrintedPattern:
    """What is printed, in pattern coordinates."""

    width: float
    """In metres."""
    height: float
    """In metres."""
    dictionary: str
    """Of its markers."""
    marker_ids: NDArray[np.int64]
    """(m,) numbers of the markers."""
    marker_corners: FloatArray
    """(m, 4, 2): upper left, upper right, lower right, lower left of each marker."""
    corners: FloatArray
    """(n, 2) points that are measured against the texture."""
    black: FloatArray
    """(k, 4) black rectangles: left, top, right, bottom."""
    window: float
    """Half side of the texture around a corner that is known for certain, in metres."""
    legacy: bool = False
    """Whether the marker squares begin at the upper left, as boards with even rows had it before OpenCV 4.6."""

    @property
    def outline(self) -> FloatArray:
        """(3, 2) the corners that a survey gives: upper left, upper right, lower left."""
        return np.array([[0.0, 0.0], [self.width, 0.0], [0.0, self.height]])


_UNIT = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
"""Corners of a square of side one, clockwise from the upper left."""
CERTAIN = 0.8
"""Half side of the texture around a board's corner that is known for certain, in squares: beyond are others."""


def known_dictionaries() -> tuple[str, ...]:
    """Return the names of all dictionaries of markers."""
    return tuple(sorted(name for name in dir(cv2.aruco) if name.startswith("DICT_")))


def marker_dictionary(name: str) -> cv2.aruco.Dictionary:
    """Return the dictionary of this name.

    Raises
    ------
    TargetError
        If there is none; the message names the nearest one.
    """
    known = known_dictionaries()
    if name not in known:
        raise TargetError(f"unknown dictionary '{name}'{nearest_name(name, known)}")
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))


def patterns(target: Target) -> tuple[PrintedPattern, ...]:
    """Return what may be printed for a target: its pattern, and the legacy one where that is another.

    Raises
    ------
    TargetError
        If the target cannot exist.
    """
    if isinstance(target, SingleTag):
        return (_tag_pattern(target),)
    if isinstance(target, AprilGrid):
        return (_grid_pattern(target),)
    standard = board_pattern(target)
    return (standard,) if target.rows % 2 else (standard, board_pattern(target, legacy=True))


def board_pattern(board: CharucoBoard, *, legacy: bool = False) -> PrintedPattern:
    """Return the pattern of a board.

    Parameters
    ----------
    board : CharucoBoard
        The board.
    legacy : bool
        Whether a marker, not a black square, is at the upper left of a board with even rows.

    Raises
    ------
    TargetError
        If its dictionary is unknown or too small, or its sizes do not fit.
    """
    dictionary = marker_dictionary(board.dictionary)
    _check_board(board)
    size, shift = board.square, 1 if legacy and board.rows % 2 == 0 else 0
    cells = [(x, y) for y in range(board.rows) for x in range(board.columns)]
    white = [cell for cell in cells if (sum(cell) + shift) % 2]
    _check_ids(dictionary, board.dictionary, board.first_id, len(white))
    margin = (size - board.marker) / 2
    corner = np.array([(x * size + margin, y * size + margin) for x, y in white])
    ids = board.first_id + np.arange(len(white))
    squares = [(x * size, y * size, (x + 1) * size, (y + 1) * size) for x, y in cells if (x, y) not in set(white)]
    bits = [
        _marker_rectangles(dictionary, int(i), board.marker) + np.tile(c, 2) for i, c in zip(ids, corner, strict=True)
    ]
    inner = [(x * size, y * size) for y in range(1, board.rows) for x in range(1, board.columns)]
    return PrintedPattern(
        board.columns * size,
        board.rows * size,
        board.dictionary,
        ids,
        corner[:, None] + board.marker * _UNIT,
        np.array(inner),
        np.concatenate([np.array(squares), *bits]),
        CERTAIN * size,
        legacy,
    )


def _tag_pattern(tag: SingleTag) -> PrintedPattern:
    dictionary = marker_dictionary(tag.dictionary)
    _check_ids(dictionary, tag.dictionary, tag.id, 1)
    if not tag.size > 0:
        raise TargetError(f"a tag needs a positive size in metres, got {tag.size:g}")
    corners = tag.size * _UNIT
    return PrintedPattern(
        tag.size,
        tag.size,
        tag.dictionary,
        np.array([tag.id]),
        corners[None],
        corners,
        _marker_rectangles(dictionary, tag.id, tag.size),
        tag.size / (dictionary.markerSize + 2),  # the white margin is one module wide at least
    )


def _grid_pattern(grid: AprilGrid) -> PrintedPattern:
    dictionary = marker_dictionary(grid.dictionary)
    if not (grid.columns > 0 and grid.rows > 0 and grid.tag > 0 and 0 < grid.spacing <= 1 and grid.border > 0):
        raise TargetError(
            f"a grid needs columns, rows, a size and a spacing up to 1, got {grid.columns} x {grid.rows} tags of"
            f" {grid.tag:g} m with a spacing of {grid.spacing:g}"
        )
    count, gap = grid.columns * grid.rows, grid.spacing * grid.tag
    _check_ids(dictionary, grid.dictionary, grid.first_id, count)
    pitch = grid.tag + gap
    up, across = np.divmod(np.arange(count), grid.columns)
    corner = np.stack([gap + across * pitch, gap + (grid.rows - 1 - up) * pitch], axis=-1)
    ids = grid.first_id + np.arange(count)
    squares = [
        (x * pitch, y * pitch, x * pitch + gap, y * pitch + gap)
        for y in range(grid.rows + 1)
        for x in range(grid.columns + 1)
    ]
    bits = [
        grid.tag - _marker_rectangles(dictionary, int(i), grid.tag, grid.border)[:, [2, 3, 0, 1]] + np.tile(c, 2)
        for i, c in zip(ids, corner, strict=True)
    ]
    corners = corner[:, None] + grid.tag * np.roll(_UNIT, 2, axis=0)
    return PrintedPattern(
        grid.columns * pitch + gap,
        grid.rows * pitch + gap,
        grid.dictionary,
        ids,
        corners,
        corners.reshape(-1, 2),
        np.concatenate([np.array(squares), *bits]),
        CERTAIN * gap,
    )


def border_of(target: Target) -> int:
    """Return how many modules wide the black border of a target's markers is."""
    return target.border if isinstance(target, AprilGrid) else 1


def _marker_rectangles(dictionary: cv2.aruco.Dictionary, number: int, side: float, border: int = 1) -> FloatArray:
    """Return the black runs of a marker's rows, (k, 4), from its own upper left corner."""
    modules = dictionary.markerSize + 2 * border
    black = np.asarray(dictionary.generateImageMarker(number, modules, borderBits=border)) == 0
    edges = np.diff(np.pad(black, ((0, 0), (1, 1))).astype(np.int8), axis=1)
    rows, starts = np.nonzero(edges == 1)
    _, ends = np.nonzero(edges == -1)
    runs = np.stack([starts, rows, ends, rows + 1], axis=-1).astype(np.float64)
    return runs * (side / modules)


def _check_board(board: CharucoBoard) -> None:
    if board.columns < 2 or board.rows < 2:
        raise TargetError(f"a board needs 2 columns and 2 rows at least, got {board.columns} x {board.rows}")
    if not 0 < board.marker < board.square:
        raise TargetError(
            f"a marker must be smaller than its square, got {board.marker:g} m in a square of {board.square:g} m"
        )


def _check_ids(dictionary: cv2.aruco.Dictionary, name: str, first: int, count: int) -> None:
    size = len(dictionary.bytesList)
    if first < 0 or first + count > size:
        raise TargetError(f"{name} has the ids 0 to {size - 1}; the target needs {first} to {first + count - 1}")


def on_board(points: FloatArray) -> FloatArray:
    """Return points of a pattern, (..., 2), in the board frame, (..., 3)."""
    return np.concatenate([points, np.zeros((*points.shape[:-1], 1))], axis=-1)


def facing(place: FloatArray, eye: FloatArray, turn: float = 0.0, tilt: float = 0.0) -> RigidTransform:
    """Return the pose of a board whose upper left corner is at a place and that faces an eye.

    Parameters
    ----------
    place, eye : (3,) arrays
        In a frame with z up, in metres.
    turn, tilt : float
        About the vertical and about the board's own level axis, in radians.
    """
    heading = np.arctan2(*(place - eye)[1::-1]) + turn
    level = np.array([np.cos(heading), np.sin(heading), 0.0])
    into = np.cos(tilt) * level + np.sin(tilt) * np.array([0.0, 0.0, 1.0])
    right = np.cross(level, [0.0, 0.0, 1.0])
    axes = np.stack([right, np.cross(into, right), into], axis=1)
    return RigidTransform.from_components(place, Rotation.from_matrix(axes))


def coverage(pattern: PrintedPattern, x: FloatArray, y: FloatArray, pitch: float) -> FloatArray:
    """Return how much of each cell of a grid is black, by exact areas.

    Parameters
    ----------
    pattern : PrintedPattern
        What is printed.
    x, y : (columns,) and (rows,) arrays
        Middles of the cells, in metres.
    pitch : float
        Side of a cell, in metres.

    Returns
    -------
    (rows, columns) array
        0 where all is white paper, 1 where all is black.
    """
    left, top, right, bottom = (edge[:, None] for edge in pattern.black.T)
    across = _overlap(left, right, x, pitch)
    down = _overlap(top, bottom, y, pitch)
    return down.T @ across


def _overlap(start: FloatArray, end: FloatArray, middle: FloatArray, pitch: float) -> FloatArray:
    shared = np.minimum(end, middle + pitch / 2) - np.maximum(start, middle - pitch / 2)
    return np.clip(shared / pitch, 0.0, 1.0)
