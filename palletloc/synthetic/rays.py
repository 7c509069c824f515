"""The rays of an image, kept in tiles so that a solid is tested only where it can be seen."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from palletloc.cameras.protocol import CameraModel
from palletloc.geometry import BoolArray, FloatArray
from palletloc.synthetic.samples import Indices, Samples, lengths

_TILE_ROWS, _TILE_COLUMNS = 32, 64
"""Of a tile, in pixels: small cones miss most solids, few tiles cost little to test."""
_ROUNDING = 1e-3
"""By which a tile's cone is wider than its rays, in radians: float32 keeps small angles to 4e-4 by their cosine."""
_SAMPLED = 20_000
"""How many neighbours give the typical angle between pixels: enough for its 90 % quantile."""
_PART = 1 << 20
"""Pixels that are followed together: fewer take less memory, more take less time."""


@dataclass(frozen=True, slots=True)
class TiledRays:
    """Rays in the order of their tiles, in the frame of their owner."""

    origins: Samples
    """(3, N), or (3, 1) where all start at one point, in metres."""
    directions: Samples
    """(3, N) unit vectors."""
    starts: Indices
    """(T + 1,) the rays of tile ``t`` are ``starts[t]`` to ``starts[t + 1] - 1``."""
    tile_origins: FloatArray
    """(T, 3) where the rays of a tile start, in metres."""
    tile_axes: FloatArray
    """(T, 3) unit vectors: the middle of each tile."""
    tile_angles: FloatArray
    """(T,) how far a tile's rays turn away from its middle, in radians."""
    tile_spreads: FloatArray
    """(T,) how far from the tile's origin its rays start, in metres."""

    @property
    def count(self) -> int:
        """How many rays there are."""
        return int(self.directions.shape[1])

    def moved(self, rotation: FloatArray, translation: FloatArray) -> TiledRays:
        """Return the rays in another frame: by rotation, (3, 3), and translation, (3,), of ``target_from_source``."""
        turn, shift = rotation.astype(np.float32), translation.astype(np.float32)[:, None]
        return TiledRays(
            turn @ self.origins + shift,
            turn @ self.directions,
            self.starts,
            self.tile_origins @ rotation.T + translation,
            self.tile_axes @ rotation.T,
            self.tile_angles,
            self.tile_spreads,
        )

    def points(self, chosen: Indices, distances: Samples) -> Samples:
        """Return the (3, N) points at distances along chosen rays."""
        points: Samples = self.directions.take(chosen, axis=1)
        points *= distances
        points += self.origins if self.origins.shape[1] == 1 else self.origins.take(chosen, axis=1)
        return points


@dataclass(frozen=True, slots=True)
class PixelRays:
    """The rays of a part of a camera's pixels, in the camera frame."""

    pixels: Indices
    """(N,) pixel of each ray, counted row by row."""
    rays: TiledRays
    """The rays."""


@dataclass(frozen=True, slots=True)
class CameraRays:
    """The rays of all pixels of a camera, in parts that are small enough to be quick."""

    camera: CameraModel
    """The camera."""
    parts: tuple[PixelRays, ...]
    """Together one ray through the centre of every pixel that sees something."""
    angle: float
    """Typical angle between neighbouring pixels, in radians."""


def camera_rays(camera: CameraModel) -> CameraRays:
    """Return one ray through the centre of every pixel that sees something.

    Parameters
    ----------
    camera : CameraModel
        Any camera.

    Raises
    ------
    ValueError
        If it sees nothing.
    """
    rows, columns = np.arange(camera.height) // _TILE_ROWS, np.arange(camera.width) // _TILE_COLUMNS
    tile = (rows[:, None] * (columns[-1] + 1) + columns[None, :]).ravel()
    order = np.argsort(tile, kind="stable")
    ends = np.searchsorted(tile[order], np.arange(tile[-1] + 2))
    each = max(_PART // (_TILE_ROWS * _TILE_COLUMNS), 1)
    parts = []
    for first in range(0, tile[-1] + 1, each):
        last = min(first + each, tile[-1] + 1)
        pixels = order[ends[first] : ends[last]]
        origins, directions, valid = _unproject(camera, pixels, np.zeros(2))
        pixels = pixels[valid]
        if len(pixels):
            starts = np.searchsorted(tile[pixels], np.arange(first, last + 1)).astype(np.intp)
            parts.append(PixelRays(pixels, _tiled(origins[:, valid], directions[:, valid], starts)))
    if not parts:
        raise ValueError("a camera that sees nothing has no rays")
    return CameraRays(camera, tuple(parts), max(_pixel_angle(part) for part in parts))


def _pixel_angle(part: PixelRays) -> float:
    """Return the typical angle between neighbouring pixels of one row, in radians."""
    following = np.flatnonzero(np.diff(part.pixels) == 1)
    following = following[:: max(len(following) // _SAMPLED, 1)]
    directions = part.rays.directions
    if not len(following):
        return 0.0
    return float(np.percentile(lengths(directions[:, following] - directions[:, following + 1]), 90))


def finer_rays(camera: CameraModel, part: PixelRays, chosen: BoolArray, offsets: FloatArray) -> TiledRays:
    """Return several rays through each of some pixels.

    Parameters
    ----------
    camera : CameraModel
        The camera.
    part : PixelRays
        Some of its rays.
    chosen : (N,) array
        Which of them to replace.
    offsets : (S, 2) array
        Where in a pixel, in pixels from its centre.

    Returns
    -------
    TiledRays
        In the order of the chosen pixels, the S rays of one pixel next to each other; where the camera sees
        nothing, that of the pixel's centre.
    """
    kept = np.flatnonzero(chosen)
    count = len(offsets)
    origins = np.repeat(_expanded(part.rays.origins, kept), count, axis=1)
    directions = np.repeat(part.rays.directions[:, kept], count, axis=1)
    for index, offset in enumerate(offsets):
        o, d, valid = _unproject(camera, part.pixels[kept], offset)
        places = np.flatnonzero(valid) * count + index
        directions[:, places] = d[:, valid]
        origins[:, places] = o[:, valid]
    starts = np.searchsorted(kept, part.rays.starts).astype(np.intp) * count
    return _tiled(origins, directions, starts)


def _expanded(origins: Samples, kept: Indices) -> Samples:
    return origins[:, kept] if origins.shape[1] > 1 else np.repeat(origins, len(kept), axis=1)


def _unproject(camera: CameraModel, pixels: Indices, offset: FloatArray) -> tuple[Samples, Samples, BoolArray]:
    """Return (3, N) origins, (3, N) directions and (N,) validity."""
    places = np.stack([pixels % camera.width, pixels // camera.width], -1) + offset
    directions, origins, valid = camera.unproject(places.astype(np.float64))
    return (
        np.ascontiguousarray(np.moveaxis(origins, -1, 0), np.float32),
        np.ascontiguousarray(np.moveaxis(directions, -1, 0), np.float32),
        valid,
    )


def _tiled(origins: Samples, directions: Samples, starts: Indices) -> TiledRays:
    """Return rays with the cone of each tile."""
    filled = np.flatnonzero(np.diff(starts))
    if origins.shape[1] and not np.ptp(origins, axis=1).any():
        origins = np.ascontiguousarray(origins[:, :1])
    tiles = len(starts) - 1
    axes, angles = np.tile([1.0, 0.0, 0.0], (tiles, 1)), np.full(tiles, -np.pi)
    centers, spreads = np.zeros((tiles, 3)), np.zeros(tiles)
    counts = np.diff(starts)[filled]
    if len(filled):
        axes[filled] = (np.add.reduceat(directions, starts[filled], axis=1) / counts).T
        axes /= np.maximum(np.linalg.norm(axes, axis=1, keepdims=True), 1e-12)
        cosines = np.einsum("ij,ij->j", directions, np.repeat(axes[filled].T, counts, axis=1))
        least = np.minimum.reduceat(cosines, starts[filled])
        angles[filled] = np.arccos(np.clip(least, -1.0, 1.0)) + _ROUNDING
        if origins.shape[1] == 1:
            centers[:] = origins[:, 0]
        else:
            centers[filled] = (np.add.reduceat(origins, starts[filled], axis=1) / counts).T
            distances = np.linalg.norm(origins - np.repeat(centers[filled].T, counts, axis=1), axis=0)
            spreads[filled] = np.maximum.reduceat(distances, starts[filled])
    return TiledRays(origins, directions, starts, centers, axes, angles, spreads)
