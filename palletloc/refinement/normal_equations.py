"""The linear least squares behind the fit of a face: what a small motion does to its edges.

Unknowns are the motion of the face in its own frame (right, up, depth, yaw), six errors of the mounting, the errors
that edges share, as light and blur are alike for all of them, and those of the depths at which edges behind the face
lie. All but the motion are held by their sigmas: they can hardly be told from a motion, but they belong into its
covariance.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg.lapack import dposv

from palletloc.geometry import FloatArray, LevelPose
from palletloc.mounting import Mounting
from palletloc.pallet import PalletModel
from palletloc.plane import FACE_IN_PALLET
from palletloc.refinement.edges import SeenFace
from palletloc.robust import SIGMA_PER_MEDIAN, tukey_weights

USED_WEIGHT = 0.2
"""Weight from which on an edge counts as used."""
BLUR_PX, MOST_BLUR = 0.2, 0.0025
"""How far blur and the camera's tone curve move edges out of what is bright, in pixels, and at most in metres: what
is farther off is another edge. All edges have such an error in common, and each has its own.

It counts where the camera is level with the face: there, yaw and range come from small differences of upright edges.
"""
LEVEL, NOT_LEVEL = 0.075, 0.15
"""How far above or below a face a camera is level with it, and from where on it is not at all, in metres."""
DEPTH_ERROR = 0.004
"""How far the front or back of a row of blocks lies from its place (one standard deviation), in metres."""
_MOTION, _FIRST_SHARED, _FIRST_DEPTH = 4, 10, 13
"""How many unknowns are the motion, and where those that edges share and those of the depths begin; six errors of the
mounting stand between."""
_SHARED_PART = 0.7
"""Part of an upright edge's shift error that it shares with the others of its side, as a standard deviation."""
_TINY = 1e-9
"""How strongly every unknown is held at least, in its unit to the power of -2: the equations stay solvable."""


@dataclass(frozen=True, slots=True)
class FaceSolution:
    """The motion of a face that explains its edges."""

    motion: FloatArray
    """(4,) right, up, depth in metres and yaw in radians; depth is away from the viewer."""
    covariance: FloatArray
    """(4, 4) covariance of the motion."""
    shifts: FloatArray
    """(edges,) how far outward the motion shifts the images of the edges on the plane of the face, in metres."""
    weights: FloatArray
    """(edges,) weight of each edge's offset, 0 to 1."""
    residuals: FloatArray
    """(edges,) what the motion leaves of each edge's offset, in its standard deviations."""
    chi2: float
    """Mean squared normalised residual of the measurements that count."""
    unknowns: FloatArray
    """(unknowns,) all of them, the motion first."""
    information: FloatArray
    """(unknowns, unknowns) their inverse covariance."""

    @property
    def sigma(self) -> FloatArray:
        """(4,) standard deviations of the motion."""
        return np.sqrt(self.covariance.diagonal())


class FaceEquations:
    """Rows of the least squares; offsets of the edges come first.

    Parameters
    ----------
    seen : SeenFace
        The face with its measured edges.
    pose : LevelPose
        ``forklift_from_pallet`` where the face was measured.
    mounting : Mounting
        Of the camera.
    model : PalletModel
        The pallet.
    """

    def __init__(self, seen: SeenFace, pose: LevelPose, mounting: Mounting, model: PalletModel) -> None:
        self.seen = seen
        self._mounting = mounting
        depths = max(0, 2 * len(model.block_rows) - 1)
        self._unknowns = _FIRST_DEPTH + depths
        forklift_from_plane = pose.matrix() @ FACE_IN_PALLET
        self._axes, self._origin = forklift_from_plane[:3, :3], forklift_from_plane[:3, 3]
        numbers = np.array(
            [(*edge.edge.middle, *edge.edge.outward, edge.pixel, edge.sigma, edge.shift.sigma) for edge in seen.edges]
        )
        middles, outward, (pixel, measured, own) = numbers[:, :2], numbers[:, 2:4], numbers[:, 4:].T
        level = outward[:, 0] == 0
        motion = self._image_motion(np.concatenate([middles, _ends(middles[level, 1])]))
        self._level_slopes = _risen(motion[len(middles) :])
        shared = np.where(level, 0.0, _SHARED_PART * own)
        up = float(seen.plane_from_camera[1])
        beside = max(-up, up - model.height)
        blur = np.minimum(BLUR_PX * pixel, MOST_BLUR) * np.interp(beside, (LEVEL, NOT_LEVEL), (1.0, 0.0))
        sigma = np.sqrt(measured**2 + blur**2 + own**2 - shared**2)
        offsets = np.einsum("ni,nij->nj", outward, motion[: len(middles)])
        side = np.array([edge.shift.both_seen for edge in seen.edges], dtype=int)
        offsets[np.arange(len(side)), _FIRST_SHARED + side] = shared
        offsets[:, _FIRST_DEPTH - 1] = blur
        self._shifts = offsets[:, :_MOTION]
        self._rows = [offsets / sigma[:, None]]
        self._values = [np.array([edge.fit.offset for edge in seen.edges]) / sigma]
        self._robust = [np.ones(len(seen.edges), dtype=bool)]
        self._held, self._pull = np.full(self._unknowns, _TINY), np.zeros(self._unknowns)
        self._held[_MOTION:] += 1.0
        self._held[_MOTION:_FIRST_SHARED] = np.maximum(mounting.sigma, _TINY) ** -2

    def _image_motion(self, points: FloatArray) -> FloatArray:
        """Return what each unknown does to the images of points on the face's plane, (n, 2, unknowns).

        Points are (n, 3): right, up and towards the viewer; or (n, 2), on the plane.
        """
        nearer = points[:, 2] if points.shape[1] == 3 else np.zeros(len(points))
        in_forklift = self._origin + points @ self._axes[:, : points.shape[1]].T
        moved = np.zeros((len(points), 3, _FIRST_SHARED))
        moved[:, 0, 0] = moved[:, 1, 1] = 1.0
        moved[:, 0, 3], moved[:, 2, 3] = nearer, -points[:, 0]
        moved[:, 2, 2] = -1.0
        moved[:, :, _MOTION:] = self._axes.T @ apparent_motion(in_forklift, self._mounting.center)
        # what comes nearer to the camera moves away from its foot point on the plane
        camera = self.seen.plane_from_camera
        away = (camera[2] - nearer)[:, None, None]
        ray = (points[:, :2] - camera[:2])[:, :, None] / away
        motion = np.zeros((len(points), 2, self._unknowns))
        motion[..., :_FIRST_SHARED] = (moved[:, :2] + ray * moved[:, 2:]) * (camera[2] / away)
        return motion

    def motion_behind(self, places: FloatArray, depths: Sequence[int]) -> FloatArray:
        """Return how far to the right each unknown moves the images of edges behind the face on its plane.

        Parameters
        ----------
        places : (edges, 3) array
            Right, up and towards the viewer on the face, in metres.
        depths : sequence of int
            Which of the model's depths each has: edges of one depth share its error.

        Returns
        -------
        (edges, unknowns) array
            By the unknowns of a `FaceSolution`.
        """
        motion = self._image_motion(places)[:, 0]
        motion[np.arange(len(places)), _FIRST_DEPTH + np.array(depths)] = DEPTH_ERROR * motion[:, 2]
        return motion

    def add_offset(self, motion: FloatArray, offset: float, sigma: float) -> None:
        """Add a measured offset.

        Parameters
        ----------
        motion : (unknowns,) array
            What each unknown does to it, as from `motion_behind`.
        offset : float
            In metres.
        sigma : float
            Its standard deviation.
        """
        self._add(motion[None] / sigma, np.array([offset / sigma]), False)

    def _hold(self, unknown: int, value: float, sigma: float) -> None:
        """Add what is known of one unknown."""
        self._held[unknown] += sigma**-2
        self._pull[unknown] += value * sigma**-2

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
        level = [edge for edge in self.seen.edges if edge.edge.horizontal]
        if not level:
            return
        tilt = [math.sqrt(2.0) * error_px * edge.pixel / edge.edge.length for edge in level]
        sigma = np.hypot([edge.fit.sigma_slope for edge in level], tilt)
        sign = np.array([edge.edge.outward[1] for edge in level])
        values = np.array([edge.fit.slope for edge in level])
        self._add(self._level_slopes * (sign / sigma)[:, None], values / sigma, True)

    def add_height(self, rise: float, sigma: float) -> None:
        """Add what is known of the height: how far up the face should move, in metres."""
        self._hold(1, rise, sigma)

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
        slope = _risen(self._image_motion(_ends(np.array([up]))))
        self._add(slope / (slope[0, 3] * sigma), np.array([turn / sigma]), False)

    def add_turn(self, turn: float, sigma: float) -> None:
        """Add what is known of the yaw before any measurement, in radians."""
        self._hold(3, turn, sigma)

    def solve(self) -> FaceSolution:
        """Solve by iteratively reweighted least squares (Tukey's biweight on offsets and slopes)."""
        rows, values, robust = (np.concatenate(part) for part in (self._rows, self._values, self._robust))
        weights, held = np.ones(len(values)), np.diag(self._held)
        for _ in range(8):
            weighted = rows.T * weights
            normal = weighted @ rows + held
            solution = _solved(normal, weighted @ values + self._pull)
            residual = values - rows @ solution
            size = np.sort(np.abs(residual[robust]))
            spread = max(1.0, SIGMA_PER_MEDIAN * float(size[len(size) // 2]))
            update = np.where(robust, tukey_weights(residual, spread), 1.0)
            settled = np.abs(update - weights).max() < 0.01
            weights = update
            if settled:
                break
        used = robust & (weights > USED_WEIGHT)
        chi2 = float((weights * residual**2)[used].sum() / max(float(weights[used].sum()), 1.0))
        covariance = _solved(normal, np.eye(self._unknowns, _MOTION))[:_MOTION] * max(chi2, 1.0)
        own, left = (part[: len(self.seen.edges)] for part in (weights, residual))
        motion = solution[:_MOTION]
        return FaceSolution(motion, covariance, self._shifts @ motion, own, left, chi2, solution, normal)


def apparent_motion(points: FloatArray, center: FloatArray) -> FloatArray:
    """Return how points seem to move when the true mounting of the camera differs from the assumed one.

    Parameters
    ----------
    points : (n, 3) array
        In the forklift frame, in metres.
    center : (3,) array
        The camera's origin in the forklift frame, in metres.

    Returns
    -------
    (n, 3, 6) array
        Derivative of each apparent point by three translations and three rotations of the assumed mounting.
    """
    x, y, z = (points - center).T
    motion = np.zeros((len(points), 3, 6))
    motion[:, (0, 1, 2), (0, 1, 2)] = 1.0
    motion[:, 0, 4], motion[:, 0, 5] = z, -y
    motion[:, 1, 3], motion[:, 1, 5] = -z, x
    motion[:, 2, 3], motion[:, 2, 4] = y, -x
    return motion


def _solved(normal: FloatArray, values: FloatArray) -> FloatArray:
    """Solve normal equations, which are positive definite as all unknowns are held a little."""
    _, solution, failed = dposv(normal, values)
    if failed:
        raise np.linalg.LinAlgError(f"the normal equations of a face are not positive definite ({failed})")
    return np.asarray(solution)


def _ends(ups: FloatArray) -> FloatArray:
    """Return left and right ends of level lines at some heights on the face, (2 n, 2), in metres."""
    ends = np.empty((2, len(ups), 2))
    ends[0, :, 0], ends[1, :, 0], ends[..., 1] = -0.5, 0.5, ups
    return ends.reshape(-1, 2)


def _risen(motion: FloatArray) -> FloatArray:
    """Return what each unknown does to the slopes of level lines by what it does to their ends, (n, unknowns)."""
    left, right = motion[:, 1].reshape(2, -1, motion.shape[2])
    return np.asarray(right - left)
