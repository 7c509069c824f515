"""What is left of each corner after the fit: in degrees, in pixels, and in millimetres at two metres."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calibration.bearing_dlt import tangent_axes
from calibration.extrinsics import Extrinsics
from calibration.observations import TargetObservation
from palletloc.geometry import BoolArray, FloatArray

REFERENCE_RANGE = 2.0
"""Where angles are told as lengths, in metres."""


@dataclass(frozen=True, slots=True, eq=False)
class CornerResiduals:
    """Of one target in one shot."""

    target: str
    """Its name."""
    shot: str
    """The shot's file."""
    bearings: FloatArray
    """(n, 3) of its corners in the camera frame."""
    offsets: FloatArray
    """(n, 3) fitted minus measured unit vector, in radians."""
    pixel_angle: FloatArray
    """(n,) radians per pixel."""
    pixels: FloatArray
    """(n, 2) where the corners are seen."""
    used: BoolArray
    """(n,) whether the fit rests on it."""

    @property
    def angle(self) -> FloatArray:
        """(n,) angles between fitted and measured bearings, in radians."""
        return np.asarray(np.linalg.norm(self.offsets, axis=-1))

    @property
    def rms(self) -> float:
        """Root mean square of one component over the corners used, in radians."""
        return float(np.sqrt((self.angle[self.used] ** 2).mean() / 2)) if self.used.any() else float("nan")

    @property
    def rms_px(self) -> float:
        """The same in pixels."""
        scaled = (self.angle / self.pixel_angle)[self.used]
        return float(np.sqrt((scaled**2).mean() / 2)) if self.used.any() else float("nan")


def corner_residuals(
    solution: Extrinsics, observations: Sequence[TargetObservation], names: Sequence[str]
) -> tuple[CornerResiduals, ...]:
    """Return the residuals of all corners, those that the fit refused included.

    Parameters
    ----------
    solution : Extrinsics
        The fit.
    observations : sequence of TargetObservation
        Those that it rests on, in the same order.
    names : sequence of str
        Of the targets, in the fit's order.
    """
    residuals = []
    for observation, used in zip(observations, solution.kept, strict=True):
        corners, board = observation.corners, solution.poses.boards[names.index(observation.target)]
        points = np.column_stack([corners.points, np.zeros(len(corners.points))])
        rays = solution.poses.camera.inv().apply(board.apply(points)) - corners.origins
        rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
        across = tangent_axes(corners.bearings)
        offsets = np.einsum("nij,nik,nk->nj", across, across, rays)
        residuals.append(
            CornerResiduals(
                observation.target,
                observation.shot,
                corners.bearings,
                offsets,
                corners.pixel_angle,
                corners.pixels,
                used,
            )
        )
    return tuple(residuals)


def at_reference(angle: float) -> float:
    """Return an angle in radians as a length at `REFERENCE_RANGE`, in millimetres."""
    return 1000 * REFERENCE_RANGE * angle
