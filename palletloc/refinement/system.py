"""The linear least squares behind the fit of a face: what a small motion does to its edges.

Unknowns are the motion of the face in its own frame (right, up, depth, yaw), six errors of the mounting and the
errors that upright edges share, as light falls on all of them alike. All but the motion are held by their sigmas:
they can hardly be told from a motion, but they belong into its covariance.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from palletloc.edge_fit import TUKEY
from palletloc.geometry import FloatArray, LevelPose
from palletloc.mounting import Mounting
from palletloc.plane import PALLET_FROM_VERTICAL
from palletloc.refinement.edges import SeenFace

USED_WEIGHT = 0.2
"""Weight from which on an edge counts as used."""
_MOTION, _MOUNTING, _SHARED = 4, 6, 2
_UNKNOWNS = _MOTION + _MOUNTING + _SHARED
_SHARED_PART = 0.7
"""Part of an upright edge's shift error that it shares with the others of its side, as a standard deviation."""
_TINY = 1e-9


@dataclass(frozen=True, slots=True)
class FaceSolution:
    """The motion of a face that explains its edges."""

    motion: FloatArray
    """(4,) right, up, depth in metres and yaw in radians; depth is away from the viewer."""
    covariance: FloatArray
    """(4, 4) covariance of the motion."""
    weights: FloatArray
    """(edges,) weight of each edge's offset, 0 to 1."""
    chi2: float
    """Mean squared normalised residual of the measurements that count."""


class FaceSystem:
    """Rows of the least squares; offsets of the edges come first.

    Parameters
    ----------
    seen : SeenFace
        The face with its measured edges.
    pose : LevelPose
        ``forklift_from_pallet`` where the face was measured.
    mounting : Mounting
        Of the camera.
    """

    def __init__(self, seen: SeenFace, pose: LevelPose, mounting: Mounting) -> None:
        self.seen = seen
        self._mounting = mounting
        forklift_from_plane = pose.matrix() @ PALLET_FROM_VERTICAL.as_matrix()
        self._axes, self._origin = forklift_from_plane[:3, :3], forklift_from_plane[:3, 3]
        middles = np.array([one.edge.middle for one in seen.edges])
        outward = np.array([one.edge.outward for one in seen.edges])
        shared = np.array([0.0 if one.edge.horizontal else _SHARED_PART * one.shift.sigma for one in seen.edges])
        own = np.array([one.shift.sigma for one in seen.edges])
        sigma = np.sqrt(np.array([one.sigma for one in seen.edges]) ** 2 + own**2 - shared**2)
        offsets = np.einsum("ni,nij->nj", outward, self._image_motion(middles))
        side = np.array([one.shift.both_seen for one in seen.edges], dtype=int)
        offsets[np.arange(len(side)), _MOTION + _MOUNTING + side] = shared
        self._rows = [offsets / sigma[:, None]]
        self._values = [np.array([one.fit.offset for one in seen.edges]) / sigma]
        self._robust = [np.ones(len(seen.edges), dtype=bool)]
        held = np.concatenate([np.maximum(mounting.sigma, _TINY), np.ones(_SHARED)])
        self._add(np.eye(_UNKNOWNS)[_MOTION:] / held[:, None], np.zeros(len(held)), False)

    def _image_motion(self, points: FloatArray) -> FloatArray:
        """Return what each unknown does to the images of face points on the plane, (n, 2, unknowns)."""
        apparent = self._mounting.apparent_motion(self._origin + points @ self._axes[:, :2].T)
        moved = np.zeros((len(points), 3, _UNKNOWNS))
        moved[:, 0, 0] = moved[:, 1, 1] = 1.0
        moved[:, 2, 2], moved[:, 2, 3] = -1.0, -points[:, 0]
        moved[:, :, _MOTION : _MOTION + _MOUNTING] = self._axes.T @ apparent
        # what comes nearer to the camera moves away from its foot point on the plane
        camera = self.seen.plane_from_camera
        ray = (points - camera[:2]) / camera[2]
        return np.asarray(moved[:, :2] + ray[:, :, None] * moved[:, 2:3])

    def _slopes(self, ups: FloatArray) -> FloatArray:
        """Return what each unknown does to the slopes of level lines, (n, unknowns)."""
        ends = [self._image_motion(np.stack([np.full_like(ups, right), ups], axis=1)) for right in (-0.5, 0.5)]
        return np.asarray(ends[1][:, 1] - ends[0][:, 1])

    def _add(self, rows: FloatArray, values: FloatArray, robust: bool) -> None:
        self._rows.append(rows)
        self._values.append(values)
        self._robust.append(np.full(len(values), robust))

    def add_slopes(self, error_px: float) -> None:
        """Add the slope of each level edge.

        Parameters
        ----------
        error_px : float
            How far each end of an edge may lie off, in pixels of the camera's image.
        """
        level = [one for one in self.seen.edges if one.edge.horizontal]
        if not level:
            return
        tilt = [np.sqrt(2.0) * error_px * one.pixel / one.edge.length for one in level]
        sigma = np.hypot([one.fit.sigma_slope for one in level], tilt)
        sign = np.array([one.edge.outward[1] for one in level])
        rows = self._slopes(np.array([one.edge.middle[1] for one in level]))
        values = np.array([one.fit.slope for one in level])
        self._add(rows * (sign / sigma)[:, None], values / sigma, True)

    def add_height(self, rise: float, sigma: float) -> None:
        """Add what is known of the height: how far up the face should move, in metres."""
        self._add(np.eye(_UNKNOWNS)[1:2] / sigma, np.array([rise / sigma]), False)

    def add_yaw(self, turn: float, sigma: float, up: float) -> None:
        """Add the yaw that a line gave, which errors of the mounting falsify as they do a line on the face.

        Parameters
        ----------
        turn : float
            How far the face should turn, in radians.
        sigma : float
            Standard deviation, in radians.
        up : float
            Height of the line on the face, in metres.
        """
        slope = self._slopes(np.array([up]))
        self._add(slope / (slope[0, 3] * sigma), np.array([turn / sigma]), False)

    def add_turn(self, turn: float, sigma: float) -> None:
        """Add what is known of the yaw before any measurement, in radians."""
        self._add(np.eye(_UNKNOWNS)[3:4] / sigma, np.array([turn / sigma]), False)

    def solve(self) -> FaceSolution:
        """Solve by iteratively reweighted least squares (Tukey's biweight on offsets and slopes)."""
        rows, values, robust = (np.concatenate(part) for part in (self._rows, self._values, self._robust))
        weights = np.ones(len(values))
        for _ in range(8):
            normal = rows.T @ (weights[:, None] * rows) + _TINY * np.eye(_UNKNOWNS)
            solution = np.linalg.solve(normal, rows.T @ (weights * values))
            residual = values - rows @ solution
            size = np.sort(np.abs(residual[robust]))
            spread = max(1.0, 1.4826 * float(size[len(size) // 2]))
            update = np.where(robust, np.clip(1 - (residual / (TUKEY * spread)) ** 2, 0, None) ** 2, 1.0)
            settled = np.abs(update - weights).max() < 0.01
            weights = update
            if settled:
                break
        used = robust & (weights > USED_WEIGHT)
        chi2 = float((weights * residual**2)[used].sum() / max(float(weights[used].sum()), 1.0))
        covariance = np.linalg.inv(normal)[:_MOTION, :_MOTION] * max(chi2, 1.0)
        return FaceSolution(solution[:_MOTION], covariance, weights[: len(self.seen.edges)], chi2)
