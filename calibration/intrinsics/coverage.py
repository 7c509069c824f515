"""Where in a lens's field corners are: sectors of rings around its axis."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calibration.lenses.fit import LensFit
from calibration.lenses.models import LensCamera
from palletloc.geometry import BoolArray, FloatArray

SECTORS = 12
"""Around the axis."""
_RING = np.radians(12.0)


@dataclass(frozen=True, slots=True, eq=False)
class Coverage:
    """Which sectors have a corner."""

    filled: BoolArray
    """(rings, sectors): from the axis outwards, from the image's right over its bottom."""
    max_angle: float
    """Largest angle off axis of any corner, in radians."""
    reach: float
    """How far out in the image corners come, as a share of half its width."""
    angle: FloatArray
    """(n,) of each used corner, off axis, in radians."""
    azimuth: FloatArray
    """(n,) around the axis, from the image's right to its bottom, in radians."""


def corner_rays(fit: LensFit, lens: int) -> FloatArray:
    """Return the directions of a lens's used corners in its own frame, (n, 3)."""
    rays = [
        fit.rig.lens_from_board(view).apply(view.points[used])
        for view, used in zip(fit.problem.views, fit.used, strict=True)
        if view.lens == lens
    ]
    return np.concatenate(rays)


def coverage_of(fit: LensFit, lens: int, camera: LensCamera, aperture: float) -> Coverage:
    """Return where the used corners of a lens are.

    Parameters
    ----------
    fit : LensFit
        The result.
    lens : int
        Its number.
    camera : LensCamera
        The lens.
    aperture : float
        Width of what it shows, in pixels.
    """
    rays = corner_rays(fit, lens)
    angle = np.arctan2(np.hypot(rays[:, 1], rays[:, 2]), rays[:, 0])
    azimuth = np.arctan2(-rays[:, 2], -rays[:, 1]) % (2 * np.pi)
    rings = max(1, round(float(angle.max()) / _RING))
    ring = np.minimum((angle / angle.max() * rings).astype(np.intp), rings - 1)
    sector = np.minimum((azimuth / (2 * np.pi) * SECTORS).astype(np.intp), SECTORS - 1)
    filled = np.zeros((rings, SECTORS), dtype=np.bool_)
    filled[ring, sector] = True
    pixels = np.concatenate(
        [v.pixels[used] for v, used in zip(fit.problem.views, fit.used, strict=True) if v.lens == lens]
    )
    radius = float(np.linalg.norm(pixels - (camera.cx, camera.cy), axis=-1).max())
    return Coverage(filled, float(angle.max()), radius / (aperture / 2), angle, azimuth)
