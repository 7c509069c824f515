"""Position by a plane sweep (paper, section C).

With the yaw known, the front face is looked for on vertical planes at different distances. Parallel planes give
similar images, so one view serves the whole sweep: the template is scaled about the camera's foot point.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from palletloc.geometry import FloatArray, LevelPose, wrap_angle
from palletloc.matching import edge_energy
from palletloc.measurement import HeightPrior, Reason
from palletloc.pallet import PalletModel
from palletloc.plane import PALLET_FROM_VERTICAL, PlaneView
from palletloc.shot import MIN_DISTANCE, Extent, Shot
from palletloc.template import FacePlacement, face_template, match_template


@dataclass(frozen=True, slots=True)
class PositionConfig:
    """How the position is measured."""

    sweep_resolution: float = 0.004
    """Metres per pixel of the view that is swept."""
    nearer: float = 0.12
    """How far before its start the face may stand, in metres."""
    farther: float = 0.12
    """How far behind its start the face may stand, in metres."""
    sideways: float = 0.10
    """How far along the shelf from the viewing ray the face may stand, in metres."""
    upward: float = 0.06
    """How far from its start's height the face may stand where no level is known, in metres."""
    face_yaw_deg: float = 5.0
    """How far the yaw may be off where no horizontal plane gives it, in degrees."""
    face_slack: float = 0.10
    """How much farther the face may stand off its start there, in metres."""
    peaks: int = 4
    """Most positions to try in turn."""
    min_score: float = 0.20
    """Least agreement of view and template at the sweep's best position."""


@dataclass(frozen=True, slots=True)
class Sweep:
    """The score of the face over the distance of the plane."""

    depth: FloatArray
    """(n,) shifts of the plane away from the camera against the start, in metres."""
    score: FloatArray
    """(n,) best agreement at each depth."""
    peaks: tuple[LevelPose, ...]
    """The best positions, well apart, as ``forklift_from_pallet``; the best first."""
    agreement: tuple[float, ...]
    """Agreement at each of them."""
    view: PlaneView
    """The view that was swept."""

    @property
    def best(self) -> float:
        """Agreement at the first peak."""
        return self.agreement[0]


def sweep(
    shot: Shot,
    start: LevelPose,
    model: PalletModel,
    prior: HeightPrior | None,
    yaw_known: bool,
    config: PositionConfig,
) -> Sweep | Reason:
    """Sweep the vertical plane back and forth and match the face's template.

    Parameters
    ----------
    shot : Shot
        The shot.
    start : LevelPose
        ``forklift_from_pallet`` with the measured yaw.
    model : PalletModel
        The pallet.
    prior : HeightPrior or None
        Where the lower edge is known to be; without it the height is searched, too.
    yaw_known : bool
        Whether the start's yaw was measured; if not, it is searched, and the distance more widely.
    config : PositionConfig
        Parameters.

    Returns
    -------
    Sweep or Reason
        `Reason.NO_PEAK` where nothing matches, `Reason.BEHIND_FACE` or `Reason.OUT_OF_VIEW` where nothing can.
    """
    base = LevelPose(start.x, start.y, start.z if prior is None else prior.z, start.yaw)
    camera = shot.camera_in(base)
    distance = float(camera[2])
    if distance < MIN_DISTANCE:
        return Reason.BEHIND_FACE
    slack = 0.0 if yaw_known else config.face_slack
    reach = (min(config.nearer + slack, 0.4 * distance), config.farther + slack)
    view = shot.vertical_view(base, _swept_extent(model, camera, reach, prior, config), config.sweep_resolution)
    grid, camera = view.grid, view.plane_from_camera
    if view.valid.mean() < 0.5:
        return Reason.OUT_OF_VIEW
    window = (round(0.4 / grid.resolution) | 1, round(0.2 / grid.resolution) | 1)
    template = face_template(model, edge_energy(view.image, window, dilation=0), grid.resolution, camera)
    yaw_reach = 0.0 if yaw_known else float(np.radians(config.face_yaw_deg))
    depth, placement = _placements(model, camera, reach, yaw_reach, prior, config)
    # moving along the viewing ray keeps the middle of the face where it is seen
    places = np.arange(-config.sideways, config.sideways + 1e-9, config.sweep_resolution)
    drift = -camera[0] * (placement.scale - 1)
    score = match_template(template, grid, camera, placement, places, drift)
    if score.max() < config.min_score:
        return Reason.NO_PEAK
    forklift_from_plane = base.transform() * PALLET_FROM_VERTICAL
    peaks, agreement = [], []
    for i, k in _peaks(score, placement, distance, places, config):
        agreement.append(float(score[i, k]))
        away = (float(placement.scale[i, 0]) - 1) * distance
        place = np.array([places[k] + drift[i, 0], placement.height[i, 0], -away])
        x, y, z = forklift_from_plane.apply(place)
        turned = wrap_angle(base.yaw + float(placement.yaw[i, 0]))
        peaks.append(LevelPose(float(x), float(y), float(z), turned))
    by_depth = score.reshape(-1, len(depth), len(places)).max(axis=(0, 2))
    return Sweep(depth, by_depth, tuple(peaks), tuple(agreement), view)


def _peaks(
    score: FloatArray, placement: FacePlacement, distance: float, places: FloatArray, config: PositionConfig
) -> list[tuple[int, int]]:
    """Return the best hypotheses that differ by more than a fit of the edges would bridge."""
    count, resolution = len(placement.scale), config.sweep_resolution
    depth = (placement.scale[:, 0] - 1) * distance
    yaw = np.broadcast_to(placement.yaw[:, 0], count)
    height = np.broadcast_to(placement.height[:, 0], count)
    remaining = score.copy()
    found: list[tuple[int, int]] = []
    while len(found) < config.peaks:
        i, k = (int(index) for index in np.unravel_index(int(remaining.argmax()), score.shape))
        if remaining[i, k] < max(config.min_score, 0.7 * score.max()):
            break
        found.append((i, k))
        near = (np.abs(depth - depth[i]) < 5 * resolution) & (np.abs(yaw - yaw[i]) < np.radians(1.5))
        near &= np.abs(height - height[i]) < 5 * resolution
        remaining[np.ix_(near, np.abs(places - places[k]) < 4 * resolution)] = -np.inf
    return found


def _swept_extent(
    model: PalletModel,
    camera: FloatArray,
    reach: tuple[float, float],
    prior: HeightPrior | None,
    config: PositionConfig,
) -> Extent:
    """Return the part of the plane on which the face appears at every depth."""
    distance = camera[2]
    zoom = distance / (distance - reach[0])
    half = (model.width / 2 + config.sideways) * zoom + 0.05
    shifts = [camera[1] * (1 - zoom), camera[1] * (1 - distance / (distance + reach[1])), 0.0]
    free = config.upward if prior is None else 0.0
    return -half, half, min(shifts) - free - 0.06, max(shifts) + model.height * zoom + free + 0.06


def _placements(
    model: PalletModel,
    camera: FloatArray,
    reach: tuple[float, float],
    yaw_reach: float,
    prior: HeightPrior | None,
    config: PositionConfig,
) -> tuple[FloatArray, FacePlacement]:
    """Return the depths to try, and every combination with heights and yaws: (n,) and (m * n, 1) arrays."""
    distance = float(camera[2])
    extent = max(model.width / 2, abs(camera[1]))
    step = config.sweep_resolution * distance / extent
    depth = np.arange(-reach[0], reach[1] + step, step)
    heights = np.zeros(1)
    if prior is None:
        heights = np.arange(-config.upward, config.upward + 1e-9, 2 * config.sweep_resolution)
    # turning the face changes its width as it is seen, the more the farther it is beside the camera
    lever = max(extent, abs(float(camera[0])))
    turn = 4 * config.sweep_resolution * distance / (model.width / 2 * lever)
    count = int(np.ceil(yaw_reach / turn))
    yaws = np.linspace(-yaw_reach, yaw_reach, 2 * count + 1) if count else np.zeros(1)
    yaw, height, deeper = (grid.reshape(-1, 1) for grid in np.meshgrid(yaws, heights, depth, indexing="ij"))
    scale = 1 + deeper / distance
    if prior is None:
        height = height - camera[1] * (scale - 1)
    return depth, FacePlacement(scale, yaw, height)
