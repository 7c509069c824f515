"""Tables for `cv2.remap` that say where each pixel of a plane lies in an image, by a coarse grid."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum
from typing import cast

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from palletloc.cameras.protocol import CameraModel, Projection
from palletloc.geometry import BoolArray, FloatArray, Image
from palletloc.plane import PlaneGrid

MAX_ERROR_PX = 0.05
"""How far a table may lie from the exact map, in pixels of the image."""

IndexArray = NDArray[np.intp]
"""Indices into an array."""
_TOLERANCE_PX = 0.8 * MAX_ERROR_PX
"""Bound of the error in pixels; it is estimated from second differences, which vary a little from node to node."""
_STEPS = (8, 4, 2)
"""Distances of the grid's nodes that are tried, in pixels of the view."""
_WORTH_HALVING = 1.5
"""A grid twice as fine costs (2 / step)^2 of the pixels and spares about two thirds of the rough ones."""
_REACH = 5
"""What the widest interpolation (Lanczos, 8 x 8) reads around a point, in pixels, and one to spare."""
_EXACT_CELLS = 1024
"""Cells that are mapped exactly at once: their arrays stay in the processor's cache."""


class Interpolation(StrEnum):
    """How grey values are read between the image's pixels."""

    NEAREST = "nearest"
    """The nearest pixel."""
    LINEAR = "linear"
    """Bilinear over 2 x 2 pixels."""
    CUBIC = "cubic"
    """Bicubic over 4 x 4 pixels."""
    LANCZOS = "lanczos"
    """Lanczos over 8 x 8 pixels."""


_FLAGS = dict(
    zip(Interpolation, (cv2.INTER_NEAREST, cv2.INTER_LINEAR, cv2.INTER_CUBIC, cv2.INTER_LANCZOS4), strict=True)
)
"""OpenCV's names."""
_NO_SECOND_MAP = cast("NDArray[np.float32]", None)
"""`cv2.remap` takes columns and rows in one array, which is faster to make than two. OpenCV's type stubs do not know
that the second may be None; an empty array instead takes twice as long."""


@dataclass(frozen=True, slots=True)
class ImageWindow:
    """The part of an image that a table reads; its columns may run on across the seam."""

    left: int
    """First column; negative, or with the width beyond the image's, where it crosses the seam."""
    top: int
    """First row."""
    columns: int
    """Width in pixels."""
    rows: int
    """Height in pixels."""

    def cut(self, image: Image) -> Image:
        """Return the window of an image: a view where it can be, a copy across the seam."""
        band = image[self.top : self.top + self.rows]
        width = image.shape[1]
        pieces = []
        column, end = self.left, self.left + self.columns
        while column < end:
            start = column % width
            stop = min(width, start + end - column)
            pieces.append(band[:, start:stop])
            column += stop - start
        return pieces[0] if len(pieces) == 1 else np.concatenate(pieces, axis=1)


@dataclass(frozen=True, slots=True)
class RemapTable:
    """Where every pixel of a plane view lies in the image; its arrays are read-only."""

    window: ImageWindow
    """What is read of the image."""
    places: NDArray[np.float32]
    """(rows, columns, 2) columns and rows inside the window; of no meaning where not valid."""
    valid: BoolArray
    """(rows, columns); False where the camera does not see the plane."""
    complete: bool
    """Whether every pixel is valid."""
    nbytes: int
    """Memory it takes, in bytes."""

    def pixels(self) -> FloatArray:
        """Return (rows, columns, 2) pixels of the image, NaN where not valid.

        Columns run on across the seam instead of jumping back.
        """
        pixels = self.places + np.array([self.window.left, self.window.top], dtype=np.float64)
        return np.where(self.valid[..., None], pixels, np.nan)

    def apply(self, image: Image, interpolation: Interpolation) -> Image:
        """Return the image's values at the table's places, 0 where not valid."""
        flag = _FLAGS[interpolation]
        part = self.window.cut(image)
        view = cv2.remap(part, self.places, _NO_SECOND_MAP, flag, borderMode=cv2.BORDER_REPLICATE)
        if not self.complete:
            view = cv2.copyTo(view, self.valid.view(np.uint8))
        return np.asarray(view, dtype=np.uint8)


def exact_map(camera: CameraModel, camera_from_plane: RigidTransform, grid: PlaneGrid) -> Projection:
    """Project every pixel of a grid on its own: what `build_table` approximates.

    Parameters
    ----------
    camera : CameraModel
        The camera.
    camera_from_plane : RigidTransform
        Where the plane is.
    grid : PlaneGrid
        Its sampling.

    Returns
    -------
    Projection
        (rows, columns, 2) pixels and (rows, columns) validity.
    """
    plane = _SeenPlane(camera, camera_from_plane.as_matrix(), grid)
    columns, rows = np.arange(float(grid.columns)), np.arange(float(grid.rows))
    return plane.project(columns[None, :], rows[:, None])


def build_table(camera: CameraModel, camera_from_plane: RigidTransform, grid: PlaneGrid) -> RemapTable:
    """Build a table: exact at the nodes of a coarse grid, bilinear between them.

    Cells whose second differences allow an error above `MAX_ERROR_PX`, and those at the border of what
    the camera or a lens sees, are computed pixel by pixel. The coarse grid becomes finer where that
    would be most of the view.

    Parameters
    ----------
    camera : CameraModel
        The camera.
    camera_from_plane : RigidTransform
        Where the plane is.
    grid : PlaneGrid
        Its sampling.

    Returns
    -------
    RemapTable
        For images of this camera.

    Notes
    -----
    What is seen through a gap narrower than a cell of the coarse grid, 8 pixels of the view at most, may
    be marked as not valid.
    """
    plane = _SeenPlane(camera, camera_from_plane.as_matrix(), grid)
    nodes = _coarse_nodes(plane)
    exact = _exact_pixels(plane, nodes)
    window = _window(camera, nodes, exact)
    origin = np.array([window.left, window.top], dtype=np.float64)
    valid = nodes.valid_pixels(grid)
    places = nodes.upsampled(origin)
    nbytes = places.nbytes + valid.nbytes
    places = places[nodes.step :, nodes.step :][: grid.rows, : grid.columns]
    if exact is not None:
        valid[exact.rows, exact.columns] = exact.valid
        places[exact.rows, exact.columns] = np.where(exact.valid[..., None], exact.pixels - origin, 0)
    places.flags.writeable = valid.flags.writeable = False
    return RemapTable(window, places, valid, bool(valid.all()), nbytes)


@dataclass(frozen=True, slots=True)
class _SeenPlane:
    """A plane before a camera."""

    camera: CameraModel
    camera_from_plane: FloatArray
    """(4, 4) matrix."""
    grid: PlaneGrid

    def project(self, columns: FloatArray | IndexArray, rows: FloatArray | IndexArray) -> Projection:
        """Project pixels of the grid, given by columns and rows of as many axes that broadcast together."""
        right = self.grid.left + columns * self.grid.resolution
        up = self.grid.top - rows * self.grid.resolution
        along_right, along_up, _, origin = self.camera_from_plane[:3].T
        # Coordinates first: the cameras read them one by one.
        across = np.multiply.outer(along_right, right)
        across += origin.reshape(3, *(1,) * right.ndim)
        points = across + np.multiply.outer(along_up, up)
        return self.camera.project(points.transpose(*range(1, points.ndim), 0))


@dataclass(frozen=True, slots=True)
class _Nodes:
    """The coarse grid: nodes around the view, so that every pixel lies in a cell between four of them."""

    step: int
    """Pixels of the view from node to node."""
    pixels: FloatArray
    """(n, m, 2) exact places in the image, unwrapped; NaN where not valid."""
    valid: BoolArray
    """(n, m)."""
    rough: BoolArray
    """(n - 1, m - 1) cells that have to be computed pixel by pixel."""
    reference: float
    """Column that the places were unwrapped around."""

    def upsampled(self, origin: FloatArray) -> NDArray[np.float32]:
        """Return the places relative to an origin, bilinear between the nodes, a step more on every side."""
        places = (self.pixels - origin).astype(np.float32)
        if not self.valid.all():
            places[~self.valid] = 0
        rows, columns = self.valid.shape
        # Node i falls on pixel (i + 0.5) step - 0.5 of the result: halfway between two of its pixels.
        size = (columns * self.step, rows * self.step)
        return np.asarray(cv2.resize(places, size, interpolation=cv2.INTER_LINEAR), dtype=np.float32)

    def valid_pixels(self, grid: PlaneGrid) -> BoolArray:
        """Return which pixels of the view lie between four valid nodes."""
        if self.valid.all():
            return np.ones((grid.rows, grid.columns), dtype=np.bool_)
        cells = ~_any_corner(~self.valid)
        half = self.step // 2
        cells = cells.repeat(self.step, axis=0)[half : half + grid.rows]
        return cells.repeat(self.step, axis=1)[:, half : half + grid.columns]


def _coarse_nodes(plane: _SeenPlane) -> _Nodes:
    """Project the nodes of the widest grid that leaves few cells to be computed pixel by pixel."""
    for step in _STEPS:
        columns = _node_places(plane.grid.columns, step)
        rows = _node_places(plane.grid.rows, step)
        pixels, valid = plane.project(columns[None, :], rows[:, None])
        reference = _reference_column(pixels, valid)
        _unwrap(pixels, reference, plane.camera.period_px)
        rough = _rough_cells(pixels, valid)
        if np.count_nonzero(rough) <= _WORTH_HALVING * (2 / step) ** 2 * rough.size:
            break
    return _Nodes(step, pixels, valid, rough, reference)


def _node_places(count: int, step: int) -> FloatArray:
    """Return where nodes lie along a side of ``count`` pixels: halfway between pixels, around them all."""
    return np.arange(-1.0, -(-count // step) + 1.0) * step + (step - 1) / 2


def _reference_column(pixels: FloatArray, valid: BoolArray) -> float:
    """Return the column of a node in the middle of those that are seen; 0 where none is."""
    seen = np.flatnonzero(valid)
    return float(pixels.reshape(-1, 2)[seen[seen.size // 2], 0]) if seen.size else 0.0


def _unwrap(pixels: FloatArray, reference: float, period: float | None) -> None:
    """Move columns by whole periods to within half a period of the reference, in place."""
    if period is not None:
        columns = pixels[..., 0]
        columns -= period * np.round((columns - reference) / period)


def _rough_cells(pixels: FloatArray, valid: BoolArray) -> BoolArray:
    """Return the cells in which bilinear interpolation may be off, or where the camera's view ends."""
    # Interpolation is off by at most an eighth of the second difference, along rows plus along columns.
    bend = np.zeros_like(pixels)
    bend[1:-1] = np.abs(pixels[2:] - 2 * pixels[1:-1] + pixels[:-2])
    bend[0], bend[-1] = bend[1], bend[-2]
    along = np.abs(pixels[:, 2:] - 2 * pixels[:, 1:-1] + pixels[:, :-2])
    bend[:, 1:-1] += along
    bend[:, 0] += along[:, 0]
    bend[:, -1] += along[:, -1]
    rough = ~(bend[..., 0] ** 2 + bend[..., 1] ** 2 <= (8 * _TOLERANCE_PX) ** 2)
    if not rough.any():
        return np.zeros((rough.shape[0] - 1, rough.shape[1] - 1), dtype=np.bool_)
    return _any_corner(rough) & _with_neighbours(_any_corner(valid))


def _any_corner(nodes: BoolArray) -> BoolArray:
    """Return the cells of which any corner is set."""
    cells: BoolArray = nodes[:-1, :-1] | nodes[1:, :-1] | nodes[:-1, 1:] | nodes[1:, 1:]
    return cells


def _with_neighbours(cells: BoolArray) -> BoolArray:
    """Return the cells that are set or touch one that is."""
    return np.asarray(cv2.dilate(cells.view(np.uint8), np.ones((3, 3), np.uint8)), dtype=np.bool_)


@dataclass(frozen=True, slots=True)
class _ExactPixels:
    """Pixels of the view that were computed on their own, in blocks of a cell."""

    rows: IndexArray
    """(k, step, 1)."""
    columns: IndexArray
    """(k, 1, step)."""
    pixels: FloatArray
    """(k, step, step, 2), unwrapped."""
    valid: BoolArray
    """(k, step, step)."""


def _exact_pixels(plane: _SeenPlane, nodes: _Nodes) -> _ExactPixels | None:
    """Compute the rough cells pixel by pixel, a number of cells at a time to stay in the CPU's cache."""
    cell_rows, cell_columns = np.nonzero(nodes.rough)
    if not cell_rows.size:
        return None
    block = np.arange(nodes.step) - nodes.step // 2
    # Cells reach beyond the view; their pixels there fall on its outermost ones, which does no harm.
    rows = np.clip(cell_rows[:, None, None] * nodes.step + block[:, None], 0, plane.grid.rows - 1)
    columns = np.clip(cell_columns[:, None, None] * nodes.step + block, 0, plane.grid.columns - 1)
    pixels = np.empty((len(rows), nodes.step, nodes.step, 2))
    valid = np.empty(pixels.shape[:-1], dtype=np.bool_)
    for start in range(0, len(rows), _EXACT_CELLS):
        part = slice(start, start + _EXACT_CELLS)
        pixels[part], valid[part] = plane.project(columns[part], rows[part])
    _unwrap(pixels, nodes.reference, plane.camera.period_px)
    return _ExactPixels(rows, columns, pixels, valid)


def _window(camera: CameraModel, nodes: _Nodes, exact: _ExactPixels | None) -> ImageWindow:
    """Return the whole image, or what the view needs of it where that crosses the seam."""
    whole = ImageWindow(0, 0, camera.width, camera.height)
    parts = [part for part in (nodes, exact) if part is not None and part.valid.any()]
    if camera.period_px is None or not parts:
        return whole
    left, right = _extent([part.pixels[..., 0] for part in parts])
    if left >= 0 and right < camera.width:
        return whole
    top, bottom = _extent([part.pixels[..., 1] for part in parts])
    top, bottom = max(top, 0), min(bottom, camera.height - 1)
    return ImageWindow(left, top, right - left + 1, bottom - top + 1)


def _extent(parts: list[FloatArray]) -> tuple[int, int]:
    """Return the first and the last column, or row, that interpolation reads."""
    first = min(float(np.fmin.reduce(part, axis=None)) for part in parts)
    last = max(float(np.fmax.reduce(part, axis=None)) for part in parts)
    return math.floor(first) - _REACH, math.ceil(last) + _REACH
