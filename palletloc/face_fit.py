"""Position and yaw from the edges of the front face, to a fraction of a pixel, with their covariance.

Each edge is measured across itself on a view of the face where the sweep found it. One linear least-squares fit
explains the offsets by a small motion of the face; what is known of height and yaw enters as observations, what
is not known of the mounting as parameters with their own sigmas.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from palletloc.face_system import USED_WEIGHT, FaceSolution, FaceSystem
from palletloc.face_view import FaceView, measure_edges, view_face, visible_lines
from palletloc.geometry import FloatArray, Image, LevelPose, wrap_angle
from palletloc.measurement import HeightPrior, Reason
from palletloc.mounting import Mounting
from palletloc.pallet import PalletModel
from palletloc.projection import Projector


@dataclass(frozen=True, slots=True)
class FaceFitConfig:
    """How the edges of the face are measured and combined."""

    resolution: float = 0.003
    """Metres per pixel of the view of the face."""
    reach: float = 0.011
    """How far from its place an edge is looked for, in metres."""
    reach_px: float = 1.5
    """The same in pixels of the camera's image: the larger holds."""
    first_reach: float = 0.022
    """How far upright edges, which have no neighbours, are looked for at first, in metres."""
    iterations: int = 5
    """Most views of the face, each placed where the last fit says."""
    min_coverage: float = 0.3
    """Least part of an edge that must be seen for it to count."""
    max_doubt: float = 1.5
    """Up to how many missing or contradicting edges a pose is taken without trying another."""
    min_edges: int = 5
    """Fewest edges that must be seen."""
    max_sigma: float = 0.5
    """Largest standard deviation of a position that is worth reporting, in metres."""
    small_motion: float = 0.003
    """Below which motion, in metres and radians, the face is not viewed again."""
    slope_error_px: float = 0.15
    """How far each end of a level edge may lie off where its slope gives the yaw, in pixels of the camera's image."""


@dataclass(frozen=True, slots=True)
class YawPrior:
    """The yaw as the horizontal plane gives it."""

    sigma: float
    """Standard deviation of the start's yaw, in radians."""
    up: float
    """Height on the face of the edge that gave it, in metres."""


@dataclass(frozen=True, slots=True)
class FaceEstimate:
    """The pose of a face from its edges."""

    forklift_from_pallet: LevelPose
    """The pose."""
    covariance: FloatArray
    """(4, 4) covariance of (x, y, z, yaw) in the forklift frame, in metres and radians."""
    seen: FaceView
    """The face as it was last viewed, with its edges."""
    weights: FloatArray
    """(edges,) weight of each edge in the robust fit, 0 to 1."""
    coverage: float
    """Part of the face's edges that lies where the pose says, 0 to 1, by length."""
    chi2: float
    """Mean squared normalised residual of the edges that count."""

    @property
    def doubt(self) -> float:
        """How many edges are missing or contradict the others; below about 1 the pose is the right one."""
        certain = self.weights[[not self.seen.loaded(one.edge) for one in self.seen.edges]]
        return float(self.seen.expected - certain.sum() + max(self.chi2 - 1.0, 0.0))


def fit_face(
    projector: Projector,
    image: Image,
    mounting: Mounting,
    start: LevelPose,
    model: PalletModel,
    height: HeightPrior,
    yaw: YawPrior | None,
    yaw_spread: float,
    config: FaceFitConfig,
) -> FaceEstimate | Reason:
    """Fit the pose of a face to its edges.

    Parameters
    ----------
    projector : Projector
        Of the camera that took the image.
    image : Image
        The shot.
    mounting : Mounting
        Of the camera.
    start : LevelPose
        ``forklift_from_pallet``, right to some millimetres where edges are.
    model : PalletModel
        The pallet.
    height : HeightPrior
        Of the face's lower edge.
    yaw : YawPrior or None
        What the horizontal plane says; None where the slopes of the face's level edges have to give the yaw.
    yaw_spread : float
        Standard deviation of the start's yaw where ``yaw`` is None, in radians.
    config : FaceFitConfig
        Parameters.

    Returns
    -------
    FaceEstimate or Reason
        `Reason.FEW_EDGES` where too little of the face is seen.
    """
    camera_from_forklift = mounting.forklift_from_camera.inv()
    pose, estimate = start, None
    for i in range(config.iterations):
        seen = view_face(projector, image, camera_from_forklift, pose, model, config.resolution)
        if isinstance(seen, Reason):
            return seen
        reach = max(config.reach, config.first_reach / 2**i)
        edges = measure_edges(projector, seen, model, config.reach, reach, config.reach_px)
        seen = replace(seen, edges=tuple(one for one in edges if one.fit.coverage >= config.min_coverage))
        if len(seen.edges) < config.min_edges:
            return Reason.FEW_EDGES
        system = FaceSystem(seen, pose, mounting)
        system.add_height(height.z - pose.z, height.sigma)
        turned = wrap_angle(pose.yaw - start.yaw)
        if yaw is not None:
            system.add_yaw(-turned, yaw.sigma, yaw.up)
        else:
            system.add_slopes(config.slope_error_px)
            system.add_turn(-turned, yaw_spread)
        solution = system.solve()
        if float(np.sqrt(solution.covariance[:3, :3].diagonal().max())) > config.max_sigma:
            return Reason.FEW_EDGES
        estimate = _estimate(seen, pose, model, solution)
        pose = estimate.forklift_from_pallet
        if np.abs(solution.motion).max() < config.small_motion and reach <= config.reach:
            break
    return Reason.FEW_EDGES if estimate is None else estimate


def _estimate(seen: FaceView, pose: LevelPose, model: PalletModel, solution: FaceSolution) -> FaceEstimate:
    right, up, depth, turn = (float(value) for value in solution.motion)
    cos, sin = float(np.cos(pose.yaw)), float(np.sin(pose.yaw))
    moved = LevelPose(
        pose.x + cos * depth + sin * right,
        pose.y + sin * depth - cos * right,
        pose.z + up,
        wrap_angle(pose.yaw + turn),
    )
    forklift_from_face = np.array([[sin, 0, cos, 0], [-cos, 0, sin, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
    covariance = forklift_from_face @ solution.covariance @ forklift_from_face.T
    return FaceEstimate(moved, covariance, seen, solution.weights, _coverage(seen, model, solution), solution.chi2)


def _coverage(seen: FaceView, model: PalletModel, solution: FaceSolution) -> float:
    lines = [line.whole for line in visible_lines(model, seen.plane_from_camera) if not seen.loaded(line.whole)]
    covered = sum(
        one.edge.length * one.fit.coverage
        for one, weight in zip(seen.edges, solution.weights, strict=True)
        if weight > USED_WEIGHT and not seen.loaded(one.edge)
    )
    return float(covered / sum(line.length for line in lines))
