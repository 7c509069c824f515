"""The baseline of the paper ([10] there): yaw and distance searched jointly in the vertical projection alone.

Every hypothesis needs a view of its own. The score is a ridge along which yaw and distance trade off.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from palletloc.geometry import FloatArray, LevelPose, wrap_angle
from palletloc.matching import edge_energy
from palletloc.measurement import Reason
from palletloc.pallet import PalletModel
from palletloc.plane import PALLET_FROM_VERTICAL
from palletloc.shot import MIN_DISTANCE, Shot
from palletloc.template import FacePlacement, face_template, match_template


@dataclass(frozen=True, slots=True)
class JointSearchConfig:
    """What is searched, and how finely."""

    resolution: float = 0.005
    """Metres per pixel of each view."""
    max_turn_deg: float = 6.0
    """Largest correction of the start's yaw, in degrees."""
    turns: int = 25
    """Number of yaws."""
    nearer: float = 0.10
    """How far before its start the face may stand, in metres."""
    farther: float = 0.10
    """How far behind its start the face may stand, in metres."""
    depths: int = 21
    """Number of distances."""
    sideways: float = 0.10
    """How far along the shelf the face may stand, in metres."""
    upward: float = 0.03
    """How far up or down the face may stand, in metres."""
    min_score: float = 0.35
    """Least agreement of view and template."""


@dataclass(frozen=True, slots=True)
class JointSearch:
    """The score of the face over yaw and distance."""

    turns: FloatArray
    """(n,) corrections of the yaw, in radians."""
    depths: FloatArray
    """(m,) shifts away from the camera, in metres."""
    score: FloatArray
    """(n, m) best agreement."""
    poses: FloatArray
    """(n, m, 4) where on each plane that is: (x, y, z, yaw) of ``forklift_from_pallet``."""
    forklift_from_pallet: LevelPose
    """The best pose."""
    best: float
    """Its agreement."""


def search_jointly(
    shot: Shot, start: LevelPose, model: PalletModel, config: JointSearchConfig
) -> JointSearch | Reason:
    """Search yaw and distance together.

    Parameters
    ----------
    shot : Shot
        The shot.
    start : LevelPose
        ``forklift_from_pallet``.
    model : PalletModel
        The pallet.
    config : JointSearchConfig
        Parameters.

    Returns
    -------
    JointSearch or Reason
        `Reason.NO_PEAK` where nothing matches, `Reason.BEHIND_FACE` where nothing can.
    """
    turns = np.radians(np.linspace(-config.max_turn_deg, config.max_turn_deg, config.turns))
    depths = np.linspace(-config.nearer, config.farther, config.depths)
    score = np.full((len(turns), len(depths)), -np.inf)
    poses = np.zeros((*score.shape, 4))
    best, pose = -np.inf, start
    for i, turn in enumerate(turns):
        for k, depth in enumerate(depths):
            base = _slid(start, shot.mounting.center, float(turn), float(depth))
            if base is None:
                return Reason.BEHIND_FACE
            score[i, k], place = _match(shot, base, model, config)
            poses[i, k] = place.as_array()
            if score[i, k] > best:
                best, pose = score[i, k], place
    if best < config.min_score:
        return Reason.NO_PEAK
    return JointSearch(turns, depths, score, poses, pose, float(best))


def _slid(start: LevelPose, center: FloatArray, turn: float, depth: float) -> LevelPose | None:
    """Return the start moved along its viewing ray and turned; None where that leaves the camera's front."""
    point = np.array([start.x, start.y, start.z])
    distance = (point - center)[:2] @ np.array([np.cos(start.yaw), np.sin(start.yaw)])
    if distance + depth < MIN_DISTANCE:
        return None
    x, y, z = center + (point - center) * (1 + depth / distance)
    return LevelPose(float(x), float(y), float(z), wrap_angle(start.yaw + turn))


def _match(shot: Shot, base: LevelPose, model: PalletModel, config: JointSearchConfig) -> tuple[float, LevelPose]:
    """Return the best score of one hypothesis over small shifts on its plane, and the shifted pose."""
    half = model.width / 2 + config.sideways + 0.05
    low, high = -config.upward - 0.05, model.height + config.upward + 0.05
    view = shot.vertical_view(base, (-half, half, low, high), config.resolution)
    grid, camera = view.grid, view.plane_from_camera
    window = (round(0.4 / grid.resolution) | 1, round(0.2 / grid.resolution) | 1)
    template = face_template(model, edge_energy(view.image, window), grid.resolution, camera)
    heights = np.arange(-config.upward, config.upward + 1e-9, 2 * config.resolution)[:, None]
    places = np.arange(-config.sideways, config.sideways + 1e-9, config.resolution)
    placement = FacePlacement(np.ones_like(heights), np.zeros((1, 1)), heights)
    score = match_template(template, grid, camera, placement, places)
    row, column = np.unravel_index(int(score.argmax()), score.shape)
    place = np.array([places[column], heights[row, 0], 0.0])
    x, y, z = (base.transform() * PALLET_FROM_VERTICAL).apply(place)
    return float(score[row, column]), LevelPose(float(x), float(y), float(z), base.yaw)
