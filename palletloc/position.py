"""Position by a plane sweep (paper, section C).

With the yaw known, the front face is looked for on vertical planes at different distances. Parallel planes give
similar images, so one view serves the whole sweep: the template is scaled about the camera's foot point.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import RigidTransform

from palletloc.geometry import FloatArray, Image, LevelPose
from palletloc.matching import edge_energy
from palletloc.measurement import HeightPrior, Reason
from palletloc.pallet import PalletModel
from palletloc.plane import PALLET_FROM_VERTICAL, PlaneGrid, PlaneView
from palletloc.projection import Projector
from palletloc.template import FacePlacement, face_template, match_template


@dataclass(frozen=True, slots=True)
class PositionConfig:
    """How the position is measured."""

    sweep_resolution: float = 0.005
    """Metres per pixel of the view that is swept."""
    nearer: float = 0.12
    """How far before its start the face may stand, in metres."""
    farther: float = 0.12
    """How far behind its start the face may stand, in metres."""
    sideways: float = 0.10
    """How far along the shelf from the viewing ray the face may stand, in metres."""
    upward: float = 0.06
    """How far from its start's height the face may stand where no level is known, in metres."""
    min_score: float = 0.35
    """Least agreement of view and template at the sweep's best position."""


@dataclass(frozen=True, slots=True)
class Sweep:
    """The score of the face over the distance of the plane."""

    depth: FloatArray
    """(n,) shifts of the plane away from the camera against the start, in metres."""
    score: FloatArray
    """(n,) best agreement at each depth."""
    forklift_from_pallet: LevelPose
    """The best position."""
    best: float
    """Its agreement."""
    view: PlaneView
    """The view that was swept."""


def sweep(
    projector: Projector,
    image: Image,
    camera_from_forklift: RigidTransform,
    start: LevelPose,
    model: PalletModel,
    prior: HeightPrior | None,
    config: PositionConfig,
) -> Sweep | Reason:
    """Sweep the vertical plane back and forth and match the face's template.

    Parameters
    ----------
    projector : Projector
        Of the camera that took the image.
    image : Image
        The shot.
    camera_from_forklift : RigidTransform
        Inverse of the camera's mounting.
    start : LevelPose
        ``forklift_from_pallet`` with the measured yaw.
    model : PalletModel
        The pallet.
    prior : HeightPrior or None
        Where the lower edge is known to be; without it the height is searched, too.
    config : PositionConfig
        Parameters.

    Returns
    -------
    Sweep or Reason
        `Reason.NO_PEAK` where nothing matches, `Reason.BEHIND_FACE` or `Reason.OUT_OF_VIEW` where nothing can.
    """
    base = LevelPose(start.x, start.y, start.z if prior is None else prior.z, start.yaw)
    camera_from_plane = camera_from_forklift * base.transform() * PALLET_FROM_VERTICAL
    camera = np.asarray(camera_from_plane.inv().translation)
    distance = float(camera[2])
    if distance < 0.2:
        return Reason.BEHIND_FACE
    nearer = min(config.nearer, 0.5 * distance)
    grid = _sweep_grid(model, camera, nearer, prior, config)
    view = projector.view(image, camera_from_plane, grid)
    if view.valid.mean() < 0.5:
        return Reason.OUT_OF_VIEW
    window = (round(0.4 / grid.resolution) | 1, round(0.2 / grid.resolution) | 1)
    template = face_template(model, edge_energy(view.image, window), grid.resolution, camera)
    depth, placement = _placements(model, camera, nearer, prior, config)
    # moving along the viewing ray keeps the middle of the face where it is seen
    places = np.arange(-config.sideways, config.sideways + 1e-9, config.sweep_resolution)
    drift = -camera[0] * (placement.scale - 1)
    score = match_template(template, grid, camera, placement, places, drift)
    best = np.unravel_index(int(score.argmax()), score.shape)
    if score[best] < config.min_score:
        return Reason.NO_PEAK
    count = len(depth)
    by_depth = score.reshape(-1, count, len(places)).max(axis=(0, 2))
    i = best[0]
    place = np.array([places[best[1]] + drift[i, 0], placement.height[i, 0], -depth[i % count]])
    x, y, z = (base.transform() * PALLET_FROM_VERTICAL).apply(place)
    pose = LevelPose(float(x), float(y), float(z), base.yaw)
    return Sweep(depth, by_depth, pose, float(score[best]), view)


def _sweep_grid(
    model: PalletModel, camera: FloatArray, nearer: float, prior: HeightPrior | None, config: PositionConfig
) -> PlaneGrid:
    distance = camera[2]
    zoom = distance / (distance - nearer)
    half = (model.width / 2 + config.sideways) * zoom + 0.05
    shifts = [camera[1] * (1 - zoom), camera[1] * (1 - distance / (distance + config.farther)), 0.0]
    free = config.upward if prior is None else 0.0
    return PlaneGrid.spanning(
        -half,
        half,
        min(shifts) - free - 0.06,
        max(shifts) + model.height * zoom + free + 0.06,
        config.sweep_resolution,
    )


def _placements(
    model: PalletModel, camera: FloatArray, nearer: float, prior: HeightPrior | None, config: PositionConfig
) -> tuple[FloatArray, FacePlacement]:
    """Return the depths to try, and every combination with the heights: (n,) and (m * n, 1) arrays."""
    distance = float(camera[2])
    extent = max(model.width / 2, abs(camera[1]))
    step = 1.5 * config.sweep_resolution * distance / extent
    depth = np.arange(-nearer, config.farther + step, step)
    heights = np.zeros(1)
    if prior is None:
        heights = np.arange(-config.upward, config.upward + 1e-9, 2 * config.sweep_resolution)
    scale = np.tile(1 + depth / distance, len(heights))[:, None]
    height = np.repeat(heights, len(depth))[:, None]
    if prior is None:
        height = height - camera[1] * (scale - 1)
    return depth, FacePlacement(scale, np.zeros((1, 1)), height)
