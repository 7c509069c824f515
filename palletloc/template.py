"""The front face as a template: stretches of edges, and blocks without any."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np

from palletloc.face import edge_shift, face_edges
from palletloc.geometry import FloatArray, Image
from palletloc.matching import FULL, EdgeEnergy, Energy
from palletloc.pallet import PalletModel
from palletloc.plane import PlaneGrid

PIECE_LENGTH = 0.28
"""Longest stretch of a level edge that is matched in one piece, in metres: a turned face shears longer ones."""
UPRIGHT_WEIGHT = 2.0
"""Weight of an upright edge's length: short as they are, they alone tell one opening from the next."""
BLOCK_WEIGHT = 0.35
"""Weight of the edge energy inside the blocks, which counts against a place."""


class TemplatePiece(NamedTuple):
    """A stretch of the template and the energy to look it up in."""

    right: float
    """Its middle in the face's coordinates, in metres."""
    up: float
    """Its middle, in metres."""
    field: Image
    """(rows, columns) edge energy averaged over a stretch of its size, 0 to `palletloc.matching.FULL`."""
    weight: float
    """Its part in the score; the positive ones add up to 1."""


def face_template(
    model: PalletModel, energy: EdgeEnergy, resolution: float, plane_from_camera: FloatArray | None = None
) -> list[TemplatePiece]:
    """Prepare a model's face for matching with a view of given energy.

    Parameters
    ----------
    model : PalletModel
        The pallet.
    energy : EdgeEnergy
        Of the view.
    resolution : float
        Metres per pixel of the view.
    plane_from_camera : (3,) array or None
        The camera's centre in the face's coordinates, in metres: where it is known, edges stand where a camera
        sees rounded ones.

    Returns
    -------
    list of TemplatePiece
        Edges with positive weights that add up to 1, blocks with negative ones.
    """
    averaged = _Averages(energy, resolution)
    pieces: list[TemplatePiece] = []
    for edge in face_edges(model):
        shift = 0.0 if plane_from_camera is None else edge_shift(edge, plane_from_camera, model).mean
        right, up = (m + shift * n for m, n in zip(edge.middle, edge.outward, strict=True))
        if edge.horizontal:
            count = max(1, int(np.ceil(edge.length / PIECE_LENGTH)))
            size = edge.length / count
            field = averaged.along_level(size)
            pieces += [TemplatePiece(right + (i + 0.5 - count / 2) * size, up, field, size) for i in range(count)]
        else:
            field = averaged.along_upright(edge.length)
            pieces.append(TemplatePiece(right, up, field, UPRIGHT_WEIGHT * edge.length))
    total = sum(piece.weight for piece in pieces)
    pieces = [piece._replace(weight=piece.weight / total) for piece in pieces]
    return pieces + _blocks(model, averaged, 3 * resolution)


def _blocks(model: PalletModel, averaged: _Averages, margin: float) -> list[TemplatePiece]:
    """Return the solid parts beside and between the openings, without their margins."""
    low = min(opening.bottom for opening in model.openings)
    high = max(opening.top for opening in model.openings)
    solids = [(left + margin, right - margin) for left, right in model.blocks if right - left > 3 * margin]
    return [
        TemplatePiece(
            (left + right) / 2,
            (low + high) / 2,
            averaged.over_block(right - left, high - low - 2 * margin),
            -BLOCK_WEIGHT / len(solids),
        )
        for left, right in solids
    ]


class _Averages:
    """Edge energy averaged over stretches, computed once for each size."""

    def __init__(self, energy: EdgeEnergy, resolution: float) -> None:
        self._energy = energy
        self._resolution = resolution
        self._fields: dict[tuple[str, int, int], Image] = {}

    def along_level(self, length: float) -> Image:
        return self._averaged("level", length, 0.0)

    def along_upright(self, length: float) -> Image:
        return self._averaged("upright", 0.0, length)

    def over_block(self, width: float, height: float) -> Image:
        return self._averaged("either", width, height)

    def _averaged(self, kind: str, width: float, height: float) -> Image:
        columns, rows = (max(1, round(size / self._resolution)) for size in (width, height))
        if (kind, columns, rows) not in self._fields:
            field = cv2.blur(self._source(kind), (columns, rows), borderType=cv2.BORDER_REPLICATE)
            self._fields[kind, columns, rows] = np.asarray(field, dtype=np.uint8)
        return self._fields[kind, columns, rows]

    def _source(self, kind: str) -> Image:
        if kind == "level":
            return self._energy.level
        if kind == "upright":
            return self._energy.upright
        return np.asarray(cv2.max(self._energy.level, self._energy.upright), dtype=np.uint8)


class WeightedSums:
    """The score of a face at many places, summed up piece by piece; pieces of one weight are added as bytes.

    Parameters
    ----------
    shape : (int, int)
        Of the places.
    """

    def __init__(self, shape: tuple[int, int]) -> None:
        self._shape = shape
        self._sums: dict[float, Energy] = {}

    def add(self, energy: Image, weight: float) -> None:
        """Add a piece's energy, 0 to `palletloc.matching.FULL`, at all places."""
        if weight not in self._sums:
            self._sums[weight] = np.zeros(self._shape, np.float32)
        cv2.accumulate(energy, self._sums[weight])

    def total(self) -> Energy:
        """Return the scores."""
        total = np.zeros(self._shape, np.float32)
        for weight, energy in self._sums.items():
            cv2.scaleAdd(energy, weight / FULL, total, dst=total)
        return total


class FacePlacement(NamedTuple):
    """Where a face may stand, told by how it appears on a vertical plane through a nominal place.

    Fields broadcast to (n, 1).
    """

    scale: FloatArray
    """Distance of the true plane from the camera over the viewed plane's."""
    yaw: FloatArray
    """Yaw against the viewed plane's, in radians."""
    height: FloatArray
    """Height of the face's lower edge, in the plane's ``up`` coordinate, in metres."""


def match_template(
    template: Sequence[TemplatePiece],
    grid: PlaneGrid,
    plane_from_camera: FloatArray,
    placement: FacePlacement,
    places: FloatArray,
    drift: FloatArray | float = 0.0,
) -> FloatArray:
    """Score a face at many placements on one view of a vertical plane.

    Parallel planes give similar images: a face at another distance appears scaled about the camera's foot point,
    one at another yaw with a scale that changes along it. So one view serves every placement.

    Parameters
    ----------
    template : sequence of TemplatePiece
        From `face_template`.
    grid : PlaneGrid
        Of the view.
    plane_from_camera : (3,) array
        The camera's centre in the plane's coordinates: right, up, towards the viewer, in metres.
    placement : FacePlacement
        (n, 1) hypotheses.
    places : (m,) array
        Middles of the face along the true plane, in metres to the right.
    drift : (n, 1) array or float
        What each placement adds to the places, in metres.

    Returns
    -------
    (n, m) array
        Agreement, 1 where every edge is seen and nothing inside the blocks.
    """
    right, up, distance = plane_from_camera
    shape = (len(places), len(placement.scale))
    whole = FacePlacement(*(np.broadcast_to(values, (shape[1], 1))[:, 0] for values in placement))
    offset, above = (np.array([[piece[axis]] for piece in template]) for axis in (0, 1))
    inverse = 1.0 / (whole.scale + offset * (whole.yaw / distance))
    at = up + (whole.height + above - up) * inverse
    row = np.clip(np.rint((grid.top - at) / grid.resolution), 0, grid.rows - 1).astype(np.intp) * grid.columns
    # half a pixel rounds where the conversion to integers truncates
    shift = offset / grid.resolution * inverse + ((right - grid.left) / grid.resolution + 0.5)
    ratio, shift = inverse.astype(np.float32), shift.astype(np.float32)
    # placements, of which there are more, lie along the rows
    first, column = np.empty(shape, np.float32), np.empty(shape, np.float32)
    first[:] = np.atleast_2d((places + drift - right) / grid.resolution).T
    index, energy = np.empty(shape, np.intp), np.empty(shape, np.uint8)
    sums = WeightedSums(shape)
    for i, piece in enumerate(template):
        np.multiply(first, ratio[i], out=column)
        np.add(column, shift[i], out=column)
        np.clip(column, 0, grid.columns - 1, out=column)
        np.copyto(index, column, casting="unsafe")
        np.add(index, row[i], out=index)
        piece.field.ravel().take(index, out=energy, mode="clip")
        sums.add(energy, piece.weight)
    return sums.total().T.astype(np.float64)
