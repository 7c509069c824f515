"""The front face as a template: stretches of edges, and blocks without any."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np

from palletloc.face import edge_shift, face_edges
from palletloc.geometry import FloatArray
from palletloc.matching import EdgeEnergy, Energy
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
    field: Energy
    """(rows, columns) edge energy averaged over a stretch of its size."""
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
    pieces: list[TemplatePiece] = []
    for edge in face_edges(model):
        shift = 0.0 if plane_from_camera is None else edge_shift(edge, plane_from_camera, model).mean
        right, up = (m + shift * n for m, n in zip(edge.middle, edge.outward, strict=True))
        if edge.horizontal:
            count = max(1, int(np.ceil(edge.length / PIECE_LENGTH)))
            size = edge.length / count
            field = _averaged(energy.level, size, 0.0, resolution)
            pieces += [
                TemplatePiece(right + (i + 0.5 - count / 2) * size, up, field, size) for i in range(count)
            ]
        else:
            field = _averaged(energy.upright, 0.0, edge.length, resolution)
            pieces.append(TemplatePiece(right, up, field, UPRIGHT_WEIGHT * edge.length))
    total = sum(piece.weight for piece in pieces)
    pieces = [piece._replace(weight=piece.weight / total) for piece in pieces]
    return pieces + _blocks(model, energy, resolution)


def _blocks(model: PalletModel, energy: EdgeEnergy, resolution: float) -> list[TemplatePiece]:
    """Return the solid parts beside and between the openings, without their margins."""
    margin = 3 * resolution
    ends = [-model.width / 2]
    for opening in model.openings:
        ends += [opening.center - opening.width / 2, opening.center + opening.width / 2]
    ends.append(model.width / 2)
    solids = [(left + margin, right - margin) for left, right in zip(ends[::2], ends[1::2], strict=True)]
    low = min(opening.bottom for opening in model.openings)
    high = max(opening.bottom + opening.height for opening in model.openings)
    solids = [(left, right) for left, right in solids if right - left > resolution]
    either = np.asarray(cv2.max(energy.level, energy.upright), dtype=np.float32)
    return [
        TemplatePiece(
            (left + right) / 2,
            (low + high) / 2,
            _averaged(either, right - left, high - low - 2 * margin, resolution),
            -BLOCK_WEIGHT / len(solids),
        )
        for left, right in solids
    ]


def _averaged(energy: Energy, width: float, height: float, resolution: float) -> Energy:
    size = (max(1, round(width / resolution)), max(1, round(height / resolution)))
    return np.asarray(
        cv2.boxFilter(energy, cv2.CV_32F, size, borderType=cv2.BORDER_REPLICATE), dtype=np.float32
    )


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
    shape = (len(placement.scale), len(places))
    shear = placement.yaw / distance
    origin = (grid.left - right) / grid.resolution
    first = (places + drift - right) / grid.resolution
    total = np.zeros(shape, dtype=np.float32)
    for piece in template:
        inverse = 1.0 / (placement.scale + piece.right * shear)
        at = up + (placement.height + piece.up - up) * inverse
        row = np.clip(np.rint((grid.top - at) / grid.resolution), 0, grid.rows - 1)
        column = np.rint(first * inverse + (piece.right / grid.resolution * inverse - origin))
        np.clip(column, 0, grid.columns - 1, out=column)
        index = (column + row * grid.columns).astype(np.int32)
        total += np.float32(piece.weight) * piece.field.ravel().take(index.ravel()).reshape(shape)
    return total.astype(np.float64)
