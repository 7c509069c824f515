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
from palletloc.geometry import BoolArray, FloatArray, Image, LevelPose, wrap_angle
from palletloc.matching import EdgeEnergy, edge_energy
from palletloc.pallet import PalletModel
from palletloc.projection import Projector
from palletloc.shelf import ShelfPlane
from palletloc.shelf_view import DetectionConfig, ShelfView, depth_reach, depth_slack, view_shelf, yaw_reach
from palletloc.template import FacePlacement, face_template, match_template

CLEAR_CONTRAST = 4.0
"""Contrast from which on more says nothing more."""


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
            looked_at = [_looked_at(one, seen, smooth) for one in _match(seen, energy, model, level, config)]
            detections += sorted(looked_at, key=lambda one: -one.promise)[: config.max_candidates]
    return sorted(detections, key=lambda one: -one.promise), views


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
    return _spaced(found, config.max_candidates if level is not None else config.max_places, config)


def _plausible(batch: FacePlacement, places: FloatArray, seen: ShelfView, config: DetectionConfig) -> BoolArray:
    """Tell which depths agree with the heading: drift turns the whole shelf about the camera."""
    depth = (batch.scale - 1) * seen.distance
    slack = depth_slack(seen.anchor, config) + np.abs(places) * np.tan(np.radians(config.pallet_yaw_deg))
    return np.asarray(np.abs(depth - places * np.tan(batch.yaw)) <= slack)


def _batches(
    seen: ShelfView, model: PalletModel, level: float | None, config: DetectionConfig
) -> Iterator[FacePlacement]:
    """Yield the positions to try, spaced so that no edge moves farther than the view tolerates."""
    tolerance = 2.4 * seen.view.grid.resolution
    heights = np.array([level]) if level is not None else np.arange(*config.heights, tolerance)
    half = model.width / 2
    turn = yaw_reach(seen.drift, config)
    farthest = max(-seen.columns[0], seen.columns[1])
    depth = min(depth_reach(farthest, seen.anchor, turn, config), 0.4 * seen.distance)
    for height in heights:
        below = height - seen.camera_height
        extent = max(half, abs(below), abs(below + model.height))
        scales = _spread(depth / seen.distance, tolerance / extent) + 1
        yaws = _spread(turn, tolerance * seen.distance / (half * extent))
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
