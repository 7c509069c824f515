"""Finding pallets on the shelf's nominal front plane (paper, section A).

The view of the nominal plane is matched with the full-scale front face. The true plane lies some centimetres
and a degree off, so the face appears scaled about the foot of the camera and sheared: a handful of distances and
headings are tried, as finely as the view resolves them.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import RigidTransform

from palletloc.contrast import opening_contrast, smoothed
from palletloc.errors import PalletLocError
from palletloc.geometry import BoolArray, FloatArray, Image, LevelPose, wrap_angle
from palletloc.matching import EdgeEnergy, edge_energy
from palletloc.pallet import PalletModel
from palletloc.plane import PALLET_FROM_VERTICAL, PlaneGrid, PlaneView
from palletloc.projection import Projector
from palletloc.shelf import ShelfPlane
from palletloc.template import FacePlacement, face_template, match_template

MIN_DISTANCE = 0.3
"""Least distance of the camera from the shelf's plane, in metres: nearer, a face is seen at a grazing angle."""


CLEAR_CONTRAST = 4.0
"""Contrast from which on more says nothing more."""


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
    min_score: float = 0.34
    """Least agreement of view and template, 0 to 1."""
    min_spacing: float = 0.25
    """Least distance along the shelf between two candidates, in metres."""
    min_depth_spacing: float = 0.10
    """Least distance in depth between two candidates in one place, in metres."""
    max_candidates: int = 16
    """Most candidates of one model on one level."""


@dataclass(frozen=True, slots=True)
class Detection:
    """A place where a pallet may stand."""

    model: PalletModel
    """What it may be."""
    forklift_from_pallet: LevelPose
    """Where: within centimetres and a degree or two."""
    level: float | None
    """The known height it stands on, in metres; None where levels are not known."""
    score: float
    """Agreement of view and template, 0 to 1."""
    contrast: float
    """How clearly openings differ from blocks there; about 1 or less where there is no pallet."""

    @property
    def promise(self) -> float:
        """How likely it is a pallet: a rank among detections."""
        return self.score * min(self.contrast, CLEAR_CONTRAST)


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
    view: PlaneView
    """The image."""


def detect(
    projector: Projector,
    image: Image,
    shelf: ShelfPlane,
    forklift_from_camera: RigidTransform,
    models: Sequence[PalletModel],
    config: DetectionConfig,
) -> tuple[list[Detection], list[ShelfView]]:
    """Find where pallets of the given models may stand.

    Parameters
    ----------
    projector : Projector
        Of the camera that took the image.
    image : Image
        The shot.
    shelf : ShelfPlane
        Nominal front plane in the forklift frame at the shot's time.
    forklift_from_camera : RigidTransform
        The camera's mounting.
    models : sequence of PalletModel
        What to look for.
    config : DetectionConfig
        Parameters.

    Returns
    -------
    detections : list of Detection
        Best first. Many are wrong: verification tells.
    views : list of ShelfView
        What was searched: a band for each known level, or the whole plane.

    Raises
    ------
    ShelfPlaneError
        If the camera is not before the plane.
    """
    detections: list[Detection] = []
    views: list[ShelfView] = []
    for level in shelf.levels or (None,):
        seen = view_shelf(projector, image, shelf, forklift_from_camera, models, level, config)
        views.append(seen)
        window = (round(0.4 / seen.view.grid.resolution) | 1, round(0.2 / seen.view.grid.resolution) | 1)
        energy = edge_energy(seen.view.image, window)
        smooth = smoothed(seen.view.image, seen.view.grid)
        for model in models:
            detections += [_looked_at(one, seen, smooth) for one in _match(seen, energy, model, level, config)]
    return sorted(detections, key=lambda one: -one.promise), views


def view_shelf(
    projector: Projector,
    image: Image,
    shelf: ShelfPlane,
    forklift_from_camera: RigidTransform,
    models: Sequence[PalletModel],
    level: float | None,
    config: DetectionConfig,
) -> ShelfView:
    """Project the shot on the nominal plane: a band around a level, or all of it.

    Parameters are those of `detect`; ``level`` is a height in metres or None.

    Returns
    -------
    ShelfView
        Wide and high enough for every position that is searched.

    Raises
    ------
    ShelfPlaneError
        If the camera is not before the plane.
    """
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
    forklift_from_plane = LevelPose(foot[0], foot[1], 0.0, yaw).transform() * PALLET_FROM_VERTICAL
    columns = _searched(distance, into, rightward, forklift_from_camera, config)
    anchor = float(from_camera @ rightward)
    reach = _depth_reach(max(-columns[0], columns[1]), anchor, _yaw_reach(shelf.drift, config), config)
    grid = _grid(columns, max(1 - reach / distance, 0.6), float(camera[2]), models, level, config)
    view = projector.view(image, forklift_from_camera.inv() * forklift_from_plane, grid)
    return ShelfView(
        forklift_from_plane, yaw, float(camera[2]), distance, columns, anchor, shelf.drift, view
    )


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
    nearest: float,
    camera_height: float,
    models: Sequence[PalletModel],
    level: float | None,
    config: DetectionConfig,
) -> PlaneGrid:
    margin = max(model.width for model in models) / 2 / nearest + 0.1
    low, high = (level, level) if level is not None else config.heights
    high += max(model.height for model in models)
    spread = [camera_height + (up - camera_height) / scale for up in (low, high) for scale in (nearest, 2 - nearest)]
    resolution = config.coarse_resolution if level is None else config.resolution
    return PlaneGrid.spanning(
        columns[0] / nearest - margin,
        columns[1] / nearest + margin,
        max(min(spread), camera_height - 4.0) - 0.06,
        min(max(spread), camera_height + 4.0) + 0.06,
        resolution,
    )


def _yaw_reach(drift: float, config: DetectionConfig) -> float:
    return drift + float(np.radians(config.plane_yaw_deg + config.pallet_yaw_deg))


def _depth_reach(right: float, anchor: float, yaw: float, config: DetectionConfig) -> float:
    """Return how far behind or before the nominal plane a face may stand at a place along the shelf, in metres."""
    return abs(right) * float(np.tan(yaw)) + _depth_slack(anchor, config)


def _depth_slack(anchor: float, config: DetectionConfig) -> float:
    """Return how far a face may stand off the plane that is turned about the camera's foot, in metres."""
    turned = abs(anchor) * float(np.tan(np.radians(config.plane_yaw_deg)))
    return config.plane_depth + config.pallet_depth + turned


def _match(
    seen: ShelfView, energy: EdgeEnergy, model: PalletModel, level: float | None, config: DetectionConfig
) -> list[Detection]:
    resolution = seen.view.grid.resolution
    template = face_template(model, energy, resolution)
    places = np.arange(seen.columns[0], seen.columns[1], 2 * resolution)
    camera = np.array([0.0, seen.camera_height, seen.distance])
    found: list[Detection] = []
    for batch in _batches(seen, model, level, config):
        score = match_template(template, seen.view.grid, camera, batch, places)
        score[~_plausible(batch, places, seen, config)] = -np.inf
        for place, chosen, value in _best(score, (batch.scale[:, 0] - 1) * seen.distance, places, config):
            pose = _pose(seen, place, batch.scale[chosen, 0], batch.yaw[chosen, 0], batch.height[0, 0])
            found.append(Detection(model, pose, level, value, 0.0))
    return _spaced(found, config.max_candidates * (1 if level is not None else 2), config)


def _plausible(
    batch: FacePlacement, places: FloatArray, seen: ShelfView, config: DetectionConfig
) -> BoolArray:
    """Tell which depths agree with the heading: drift turns the whole shelf about the camera."""
    depth = (batch.scale - 1) * seen.distance
    slack = _depth_slack(seen.anchor, config) + np.abs(places) * np.tan(np.radians(config.pallet_yaw_deg))
    return np.asarray(np.abs(depth - places * np.tan(batch.yaw)) <= slack)


def _batches(
    seen: ShelfView, model: PalletModel, level: float | None, config: DetectionConfig
) -> Iterator[FacePlacement]:
    """Yield the positions to try, spaced so that no edge moves farther than the view tolerates."""
    tolerance = 2.4 * seen.view.grid.resolution
    heights = np.array([level]) if level is not None else np.arange(*config.heights, tolerance)
    half = model.width / 2
    yaw_reach = _yaw_reach(seen.drift, config)
    farthest = max(-seen.columns[0], seen.columns[1])
    depth_reach = min(_depth_reach(farthest, seen.anchor, yaw_reach, config), 0.4 * seen.distance)
    for height in heights:
        below = height - seen.camera_height
        extent = max(half, abs(below), abs(below + model.height))
        scales = _spread(depth_reach / seen.distance, tolerance / extent) + 1
        yaws = _spread(yaw_reach, tolerance * seen.distance / (half * extent))
        scale, yaw = (grid.reshape(-1, 1) for grid in np.meshgrid(scales, yaws))
        yield FacePlacement(scale, yaw, np.full((1, 1), height))


def _spread(reach: float, step: float) -> FloatArray:
    count = int(np.ceil(reach / step))
    return np.linspace(-reach, reach, 2 * count + 1) if count else np.zeros(1)


def _best(
    score: FloatArray, depth: FloatArray, places: FloatArray, config: DetectionConfig
) -> Iterator[tuple[float, int, float]]:
    """Yield place, hypothesis and score of the local maxima along the shelf in each slab of depth."""
    slabs = np.floor(depth / config.min_depth_spacing)
    for slab in np.unique(slabs):
        rows = np.flatnonzero(slabs == slab)
        winner = score[rows].argmax(axis=0)
        best = score[rows[winner], np.arange(len(places))]
        padded = np.concatenate([[-np.inf], best, [-np.inf]])
        peak = (best >= padded[:-2]) & (best >= padded[2:]) & (best >= config.min_score)
        for i in np.flatnonzero(peak):
            yield float(places[i]), int(rows[winner[i]]), float(best[i])


def _spaced(found: list[Detection], most: int, config: DetectionConfig) -> list[Detection]:
    """Return the best detections of a model that stand apart: along the shelf, in depth or in height."""
    kept: list[Detection] = []
    for one in sorted(found, key=lambda detection: -detection.score):
        if len(kept) == most:
            break
        if not any(_close(one, other, config) for other in kept):
            kept.append(one)
    return kept


def _close(one: Detection, other: Detection, config: DetectionConfig) -> bool:
    here, there = one.forklift_from_pallet, other.forklift_from_pallet
    dx, dy = there.x - here.x, there.y - here.y
    cos, sin = np.cos(here.yaw), np.sin(here.yaw)
    return bool(
        abs(cos * dy - sin * dx) < config.min_spacing
        and abs(cos * dx + sin * dy) < config.min_depth_spacing
        and abs(there.z - here.z) < 0.6 * one.model.height
    )


def _looked_at(one: Detection, seen: ShelfView, smooth: Image) -> Detection:
    """Return a detection with the contrast of its openings, as the view of the nominal plane shows them."""
    pose = one.forklift_from_pallet
    place, height, towards = seen.forklift_from_plane.inv().apply([pose.x, pose.y, pose.z])
    turn = wrap_angle(pose.yaw - seen.yaw)

    def placing(points: FloatArray) -> FloatArray:
        scale = 1 + (points[:, 0] * np.tan(turn) - towards) / seen.distance
        up = seen.camera_height + (height + points[:, 1] - seen.camera_height) / scale
        return np.stack([(place + points[:, 0]) / scale, up], axis=1)

    return replace(one, contrast=opening_contrast(smooth, seen.view.grid, one.model, placing))


def _pose(seen: ShelfView, place: float, scale: float, yaw: float, height: float) -> LevelPose:
    depth = (scale - 1) * seen.distance
    plane = np.array([place, height, -depth])
    x, y, z = seen.forklift_from_plane.apply(plane)
    return LevelPose(float(x), float(y), float(z), wrap_angle(seen.yaw + yaw))
