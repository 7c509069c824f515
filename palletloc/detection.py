"""Finding pallets on the shelf's nominal front plane (paper, section A).

The view of the nominal plane is matched with the full-scale front face. The true plane lies some centimetres
and a degree off, so the face appears scaled about the foot of the camera and sheared (`palletloc.shelf_search`). What
the openings show tells most wrong places from pallets.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from palletloc.contrast import place_contrasts
from palletloc.geometry import FloatArray, Image, LevelPose, wrap_angle
from palletloc.matching import EdgeEnergy, edge_energy, smoothed
from palletloc.pallet import PalletModel
from palletloc.shelf import ShelfPlane
from palletloc.shelf_search import Sites, first_steps, refine, search, spaced
from palletloc.shelf_view import DetectionConfig, ShelfView, view_shelf
from palletloc.shot import Shot
from palletloc.template import face_template

CLEAR_CONTRAST = 4.0
"""Contrast from which on more says nothing more."""
NEARBY = tuple(product((-0.03, 0.0, 0.03), (-0.03, 0.0, 0.03)))
"""Where around a place openings are looked for, to the right and upwards: it is right to some centimetres, and of
those in depth the view from above or below makes height."""

YAW_SLACK_DEG = 1.0
"""How far beyond its reach a yaw is still looked for, in degrees: where the best one is, there is one beside it."""


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
    near: float
    """The same for the clearest place within centimetres."""
    yaws: tuple[float, float]
    """Between which yaws a pallet may stand on this shelf, in radians."""

    @property
    def promise(self) -> float:
        """How likely it is a pallet: a rank among detections."""
        return self.score * min(self.contrast, CLEAR_CONTRAST)

    @property
    def hope(self) -> float:
        """The most that its promise may be, as it is right to some centimetres only."""
        return self.score * min(self.near, CLEAR_CONTRAST)


def detect(
    shot: Shot, shelf: ShelfPlane, models: Sequence[PalletModel], config: DetectionConfig
) -> tuple[list[Detection], list[ShelfView]]:
    """Find where pallets of the given models may stand.

    Parameters
    ----------
    shot : Shot
        The shot.
    shelf : ShelfPlane
        Nominal front plane in the forklift frame at the shot's time.
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
    views = view_shelf(shot, shelf, models, config)
    detections: list[Detection] = []
    for seen in views:
        window = (round(0.4 / seen.view.grid.resolution) | 1, round(0.2 / seen.view.grid.resolution) | 1)
        energy = edge_energy(seen.view.image, window)
        smooth = smoothed(seen.view.image, seen.view.grid.resolution)
        for model in models:
            detections += _detected(seen, energy, smooth, model, config)
    return sorted(detections, key=lambda detection: -detection.promise), views


def _detected(
    seen: ShelfView, energy: EdgeEnergy, smooth: Image, model: PalletModel, config: DetectionConfig
) -> list[Detection]:
    """Find a model in one view: everywhere first, then in finer steps where it may stand."""
    template = face_template(model, energy, seen.view.grid.resolution)
    steps = first_steps(seen, model, config)
    sites = search(seen, template, steps, config)
    if steps.free:
        sites = sites.chosen(spaced(sites, sites.score, config.max_places, model.height, config))
    else:
        sites = sites.chosen(np.argsort(-sites.score, kind="stable")[: config.max_looks])
    for part in (1.0, 0.3) if steps.free else (1.0,):  # the first pass leaves more open where the height is free
        sites = refine(seen, template, steps, sites, part, config)
    sites = sites.chosen(np.flatnonzero(sites.score >= config.min_score))
    contrast = _contrast(seen, smooth, model, sites)[:, 0]
    kept = spaced(
        sites, sites.score * np.minimum(contrast, CLEAR_CONTRAST), config.max_candidates, model.height, config
    )
    sites, contrast = sites.chosen(kept), contrast[kept].tolist()
    near = _contrast(seen, smooth, model, sites, NEARBY).max(axis=1).tolist()
    found = zip(_poses(seen, sites), sites.score.tolist(), contrast, near, strict=True)
    turn = steps.turn + np.radians(YAW_SLACK_DEG)
    yaws = seen.yaw - turn, seen.yaw + turn
    return [Detection(model, pose, seen.level, score, clear, most, yaws) for pose, score, clear, most in found]


def _contrast(
    seen: ShelfView,
    smooth: Image,
    model: PalletModel,
    sites: Sites,
    around: Sequence[tuple[float, float]] = ((0.0, 0.0),),
) -> FloatArray:
    """Return the contrast of openings and blocks, as the view of the nominal plane shows them.

    Parameters beside those of `_detected`: ``around`` are m shifts to the right and upwards, in metres.
    Returns (n, m).
    """
    aside, lift = np.array(around).T[..., None]

    def placing(points: FloatArray) -> FloatArray:
        scale = 1 + (points[:, 0] * np.tan(sites.yaw[:, None]) + sites.depth[:, None]) / seen.distance
        right, up = (
            sites.place[:, None, None] + aside + points[:, 0],
            sites.height[:, None, None] + lift + points[:, 1],
        )
        up = seen.camera_height + (up - seen.camera_height) / scale[:, None]
        return np.stack([right / scale[:, None], up], axis=-1).reshape(-1, len(points), 2)

    return place_contrasts(smooth, seen.view.grid, model, placing).reshape(-1, len(around))


def _poses(seen: ShelfView, sites: Sites) -> list[LevelPose]:
    plane = seen.forklift_from_plane.as_matrix()
    points = np.stack([sites.place, sites.height, -sites.depth], axis=1) @ plane[:3, :3].T + plane[:3, 3]
    yaws = wrap_angle(seen.yaw + sites.yaw).tolist()
    return [LevelPose(x, y, z, yaw) for (x, y, z), yaw in zip(points.tolist(), yaws, strict=True)]
