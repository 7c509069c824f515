"""The horizontal plane through an edge of the front face: which edge, and what the camera sees there."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np

from palletloc.geometry import FloatArray, LevelPose
from palletloc.measurement import YawSource
from palletloc.pallet import PalletModel
from palletloc.plane import PlaneView
from palletloc.shot import Shot

MAX_DEPTH = 1.0
"""How far before and behind the face its other edges are looked for, in metres: those near the camera's height
appear at any distance."""


class BoundaryMethod(StrEnum):
    """How the boundary line is found."""

    EDGES = "edges"
    """Canny edges and a Hough transform (paper, first way)."""
    TWO_REGION = "two_region"
    """A threshold between two regions, scanned row by row, and a Hough transform (second way)."""


@dataclass(frozen=True, slots=True)
class YawConfig:
    """How the yaw is measured."""

    resolution: float = 0.004
    """Metres per pixel of the horizontal view."""
    max_lever: float = 3.0
    """Largest ratio of the face's distance to the edge's height over or below the camera: at a larger one a
    millimetre of edge is too many degrees, and the face has to do."""
    search: float = 0.10
    """How far before and behind its expected place the line is looked for, in metres."""
    max_turn_deg: float = 12.0
    """Largest correction of the start's yaw, in degrees."""
    boundary: BoundaryMethod = BoundaryMethod.EDGES
    """How the boundary line is found."""
    hough_step_deg: float = 0.25
    """Step of the Hough transform's angle, in degrees."""
    reach: float = 0.012
    """How far from its place an edge is measured, in metres on the face."""
    min_coverage: float = 0.35
    """Least part of an edge that must be seen for it to vote."""
    outline_error: float = 0.0005
    """How far each end of the face's lower edge may lie off (one standard deviation), in metres."""
    outline_error_px: float = 0.05
    """What comes on top, in pixels of the camera's image along the edge: its shadow is not even."""
    load_error: float = 0.004
    """The same for the upper edge, where a load may begin, in metres."""
    opening_error_px: float = 0.2
    """The same for an opening's edges, in pixels of the camera's image along the edge: what is seen through an
    opening changes along it."""
    agreement: float = 3.5
    """How many standard deviations two edges' yaws may differ."""


@dataclass(frozen=True, slots=True)
class HorizontalView:
    """A horizontal plane at the height of one of the face's edges, as the camera sees it."""

    source: YawSource
    """Which edge the plane goes through."""
    height: float
    """Height of the plane above the face's lower edge, in metres."""
    plane_from_camera: FloatArray
    """(3,) the camera's centre in the plane's coordinates: right, up (into the shelf), above."""
    view: PlaneView
    """The image."""


def horizontal_source(model: PalletModel, camera: FloatArray, config: YawConfig) -> YawSource:
    """Choose the edge whose height suits a horizontal plane.

    Below the camera the lower edge, which stands out against the floor; above it the upper edges, as a beam may
    hide the lower one. Near the camera's height no plane serves.

    Parameters
    ----------
    model : PalletModel
        The pallet.
    camera : (3,) array
        The camera's centre in the face's coordinates: right, up and towards the viewer, in metres.
    config : YawConfig
        Parameters.

    Returns
    -------
    YawSource
        `YawSource.FACE` where no plane serves.
    """
    _, height_below, distance = camera
    if height_below * config.max_lever >= distance:
        return YawSource.BOTTOM
    if (model.height - height_below) * config.max_lever >= distance:
        return YawSource.TOP
    return YawSource.FACE


def view_horizontal(
    shot: Shot, start: LevelPose, model: PalletModel, source: YawSource, config: YawConfig
) -> HorizontalView:
    """Project the shot on the horizontal plane through an edge of the face at its start.

    Parameters
    ----------
    shot : Shot
        The shot.
    start : LevelPose
        ``forklift_from_pallet``.
    model : PalletModel
        The pallet.
    source : YawSource
        The edge; not `YawSource.FACE`.
    config : YawConfig
        Parameters.

    Returns
    -------
    HorizontalView
        As deep as the search and every other level edge of the face need.
    """
    height = {YawSource.BOTTOM: 0.0, YawSource.TOP: model.height}[source]
    pose = replace(start, z=start.z + height)
    right, up, towards = shot.camera_in(pose).tolist()
    plane_from_camera = np.array([right, -towards, up])  # the horizontal plane has the face's axes, turned
    half = model.width / 2 + 0.05
    places = [
        float(np.clip(line_up(up - height, plane_from_camera), -MAX_DEPTH, MAX_DEPTH)) for up in (0.0, model.height)
    ]
    extent = -half * 1.08, half * 1.08, min(places) - config.search, max(places) + config.search
    view = shot.horizontal_view(pose, extent, config.resolution)
    return HorizontalView(source, height, plane_from_camera, view)


def line_up(height: float, plane_from_camera: FloatArray) -> float:
    """Return where a level edge of the face appears on a horizontal plane: scaled about the camera's foot.

    Parameters
    ----------
    height : float
        Of the edge over the plane, in metres.
    plane_from_camera : (3,) array
        The camera's centre in the plane's coordinates, in metres.

    Returns
    -------
    float
        ``up`` coordinate on the plane, in metres.
    """
    above = plane_from_camera[2]
    scale = above / (above - height) if abs(above - height) > 1e-6 else 1.0
    return float(plane_from_camera[1] * (1 - scale))
