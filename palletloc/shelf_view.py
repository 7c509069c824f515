"""The shelf's nominal front plane as the camera sees it, and how far the truth may lie off it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import RigidTransform

from palletloc.errors import PalletLocError
from palletloc.geometry import FloatArray, LevelPose, wrap_angle
from palletloc.pallet import PalletModel
from palletloc.plane import PALLET_FROM_VERTICAL, PlaneGrid, PlaneView, place_plane
from palletloc.projection import Interpolation, coarse_table
from palletloc.shelf import ShelfPlane
from palletloc.shot import Shot

MIN_DISTANCE = 0.3
"""Least distance of the camera from the shelf's plane, in metres: nearer, a face is seen at a grazing angle."""


class ShelfPlaneError(PalletLocError):
    """The shelf's plane cannot be seen from the camera."""


@dataclass(frozen=True, slots=True)
class DetectionConfig:
    """How pallets are looked for."""

    resolution: float = 0.012
    """Metres per pixel of the shelf-plane view where levels are known."""
    coarse_resolution: float = 0.014
    """Metres per pixel of the view where the whole plane is searched."""
    max_range: float = 5.2
    """Farthest pallet from the camera, in metres."""
    max_bearing_deg: float = 120.0
    """Largest angle from straight ahead at which pallets are looked for, in degrees."""
    plane_depth: float = 0.08
    """How far the nominal plane may be off, in metres."""
    plane_yaw_deg: float = 1.5
    """How far its heading may be off, in degrees."""
    pallet_depth: float = 0.06
    """How far a face may stand before or behind the shelf's front, in metres."""
    pallet_yaw_deg: float = 3.0
    """How far a pallet's yaw may be off the shelf's, in degrees."""
    heights: tuple[float, float] = (-0.02, 3.5)
    """Between which heights pallets are looked for where no levels are known, in metres."""
    min_score: float = 0.31
    """Least agreement of view and template, 0 to 1."""
    min_spacing: float = 0.25
    """Least distance along the shelf between two candidates, in metres."""
    min_depth_spacing: float = 0.10
    """Least distance in depth between two candidates in one place, in metres."""
    max_candidates: int = 16
    """Most candidates of one model on one level, or on the whole plane."""
    max_looks: int = 48
    """Most places on a known level that are looked at closely, with turned faces and for openings."""
    max_places: int = 200
    """Most places on the whole plane that are looked at closely, where no levels are known."""


@dataclass(frozen=True, slots=True)
class ShelfView:
    """The nominal plane, or a band of it, as the camera sees it."""

    forklift_from_plane: RigidTransform
    """The plane: its origin lies on the floor, straight beside the camera."""
    yaw: float
    """Heading into the shelf, in radians."""
    camera_height: float
    """Height of the camera above the plane's origin, in metres."""
    distance: float
    """Distance of the camera from the plane, in metres."""
    columns: tuple[float, float]
    """Between which ``right`` coordinates the middle of a face is looked for, in metres."""
    anchor: float
    """``right`` coordinate of the shelf's given point, in metres."""
    drift: float
    """How far the heading may have drifted, in radians."""
    level: float | None
    """The known height that is looked at, in metres; None for the whole plane."""
    view: PlaneView
    """The image."""


def view_shelf(
    shot: Shot, shelf: ShelfPlane, models: Sequence[PalletModel], config: DetectionConfig
) -> list[ShelfView]:
    """Project the shot on the nominal plane: a band around each known level, or all of it.

    Parameters are those of `detect`.

    Returns
    -------
    list of ShelfView
        Wide and high enough for every position that is searched.

    Raises
    ------
    ShelfPlaneError
        If the camera is not before the plane.
    """
    forklift_from_camera = shot.mounting.forklift_from_camera
    camera = forklift_from_camera.translation
    yaw = shelf.yaw
    into = np.array([np.cos(yaw), np.sin(yaw)])
    rightward = np.array([np.sin(yaw), -np.cos(yaw)])
    from_camera = np.array([shelf.x, shelf.y]) - camera[:2]
    distance = float(from_camera @ into)
    if distance < MIN_DISTANCE:
        where = "behind" if distance < 0 else f"{distance:.2f} m from"
        raise ShelfPlaneError(
            f"shelf: the camera is {where} the plane through ({shelf.x:.2f}, {shelf.y:.2f}) m facing "
            f"{np.degrees(shelf.facing):.1f} deg in the forklift frame; expected at least {MIN_DISTANCE} m before it"
        )
    foot = camera[:2] + distance * into
    beside = LevelPose(foot[0], foot[1], 0.0, yaw)
    matrix = beside.matrix() @ PALLET_FROM_VERTICAL.as_matrix()
    forklift_from_plane = RigidTransform(matrix, normalize=False, copy=False)
    camera_from_plane = place_plane(shot.mounting.to_camera, beside, PALLET_FROM_VERTICAL)
    columns = _searched(distance, into, rightward, forklift_from_camera, config)
    anchor = float(from_camera @ rightward)
    reach = depth_reach(np.array(columns), anchor, yaw_reach(shelf.drift, config), config)
    nearest = np.maximum(1 - reach / distance, 0.6)
    views: list[ShelfView] = []
    for level in shelf.levels or (None,):
        grid = _grid(columns, nearest, float(camera[2]), models, level, config)
        table = coarse_table(shot.projector, camera_from_plane, grid)
        view = PlaneView(table.apply(shot.image, Interpolation.LINEAR), table.valid, grid, camera_from_plane)
        views.append(
            ShelfView(forklift_from_plane, yaw, float(camera[2]), distance, columns, anchor, shelf.drift, level, view)
        )
    return views


def _searched(
    distance: float,
    into: FloatArray,
    rightward: FloatArray,
    forklift_from_camera: RigidTransform,
    config: DetectionConfig,
) -> tuple[float, float]:
    """Return the stretch of the plane that lies within range and bearing, in metres to the right.

    The bearing counts from the forklift's forward axis or the camera's, whichever is nearer.
    """
    reach = np.sqrt(max(config.max_range**2 - distance**2, 0.01))
    right = np.linspace(-reach, reach, 201)
    towards = distance * into + right[:, None] * rightward
    bearing = np.arctan2(towards[:, 1], towards[:, 0])
    ahead = forklift_from_camera.as_matrix()[:2, 0]
    turned = wrap_angle(bearing - np.arctan2(ahead[1], ahead[0]))
    seen = np.minimum(np.abs(bearing), np.abs(turned)) <= np.radians(config.max_bearing_deg)
    if not seen.any():
        return (0.0, 0.0)
    return float(right[seen].min()), float(right[seen].max())


def _grid(
    columns: tuple[float, float],
    nearest: FloatArray,
    camera_height: float,
    models: Sequence[PalletModel],
    level: float | None,
    config: DetectionConfig,
) -> PlaneGrid:
    """Return the part of the plane that shows the faces; ``nearest`` holds the least scale at each end."""
    half = max(model.width for model in models) / 2
    low, high = (level, level) if level is not None else config.heights
    high += max(model.height for model in models)
    scales = (float(nearest.min()), 2 - float(nearest.min()))
    spread = [camera_height + (up - camera_height) / scale for up in (low, high) for scale in scales]
    resolution = config.coarse_resolution if level is None else config.resolution
    return PlaneGrid.spanning(
        float((columns[0] - half) / nearest[0]) - 0.1,
        float((columns[1] + half) / nearest[1]) + 0.1,
        min(spread) - 0.06,
        max(spread) + 0.06,
        resolution,
    )


def yaw_reach(drift: float, config: DetectionConfig) -> float:
    """Return how far a pallet's yaw may be off the nominal shelf's, in radians."""
    return drift + float(np.radians(config.plane_yaw_deg + config.pallet_yaw_deg))


def depth_reach(right: FloatArray | float, anchor: float, yaw: float, config: DetectionConfig) -> FloatArray:
    """Return how far behind or before the nominal plane a face may stand at a place along the shelf, in metres."""
    return np.asarray(np.abs(right) * np.tan(yaw) + depth_slack(anchor, config), dtype=np.float64)


def depth_slack(anchor: float, config: DetectionConfig) -> float:
    """Return how far a face may stand off the plane that is turned about the camera's foot, in metres."""
    turned = abs(anchor) * float(np.tan(np.radians(config.plane_yaw_deg)))
    return config.plane_depth + config.pallet_depth + turned
