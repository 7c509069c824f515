"""Views of pallets: what a method made of one pallet in one simulated shot."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from pathlib import Path

import numpy as np
from scipy.spatial.transform import RigidTransform

from benchmarks.run_parts import FAR_BELOW
from benchmarks.scenes import DrawnScene
from benchmarks.visibility import hidden_shares
from palletloc.candidate import Refusal
from palletloc.choices import CameraKind
from palletloc.evaluation.pose_error import PoseError, TrueFace, from_measurements, true_faces
from palletloc.evaluation.run_match import PAIRING_DISTANCE, match_shot
from palletloc.io.recording import Recording
from palletloc.io.truth import TruePallet
from palletloc.localizer import Explanation, Localizer
from palletloc.shot import Shot
from palletloc.synthetic.simulation import Simulation

MOST_HIDDEN = 0.5
"""Share of a face that may be hidden for it to count."""
NEAR, SAME = 0.45, 0.15
"""Largest distance of the camera's height from the nearest edge of a face in these classes, in metres."""


class HeightClass(StrEnum):
    """How high a pallet stands."""

    FLOOR = "floor"
    """Its lower edge 0.6 m or more below the camera."""
    NEAR = "near"
    """The camera's height 0.15 to 0.45 m from the nearest edge of its face."""
    SAME = "same"
    """The camera's height on its face, or closer to it than 0.15 m."""
    OTHER = "other"
    """Any other height."""


def height_class(below: float, pallet_height: float) -> HeightClass:
    """Return how high a pallet stands.

    Parameters
    ----------
    below : float
        Height of the camera above its lower edge, in metres.
    pallet_height : float
        Of its face, in metres.
    """
    if below >= FAR_BELOW:
        return HeightClass.FLOOR
    distance = max(-below, below - pallet_height, 0.0)
    if distance < SAME:
        return HeightClass.SAME
    return HeightClass.NEAR if distance < NEAR else HeightClass.OTHER


@dataclass(frozen=True, slots=True)
class View:
    """One pallet in one shot."""

    scene: DrawnScene
    """The scene."""
    face: TrueFace
    """Where the pallet truly is."""
    height: HeightClass
    """How high it stands."""
    hidden: float
    """Share of its face that is hidden, 0 to `MOST_HIDDEN`."""
    error: PoseError | None
    """How far its measurement is off; None where there is none."""
    refused: bool
    """Whether there is no measurement, but a candidate that was given up with a reason."""


@dataclass(frozen=True, slots=True)
class ShotViews:
    """What a method made of one shot."""

    full: bool
    """Whether the image has its full size."""
    views: tuple[View, ...]
    """Of the pallets that had to be found."""
    false: tuple[HeightClass, ...]
    """The heights of the measurements that belong to no pallet."""


@dataclass(frozen=True, slots=True)
class Exposure:
    """One shot of a simulated scene with its truth."""

    scene: DrawnScene
    """What was drawn."""
    recording: Recording
    """What the localizer may know."""
    shot: Shot
    """The shot."""
    faces: tuple[TrueFace, ...]
    """Every pallet beside the path; visible are those that have to be found."""
    hidden: tuple[float | None, ...]
    """Share of each face that is hidden; None where the image does not hold all of it."""


def expose(scene: DrawnScene, simulation: Simulation, index: int) -> Exposure:
    """Render one shot, and say which pallets a method has to find in it."""
    picture = simulation.picture(index)
    hidden = hidden_shares(simulation, index, picture.solids)
    recording = recorded(simulation)
    image, time = simulation.exposed(index, picture), float(simulation.times[index])
    return Exposure(
        scene,
        recording,
        Shot(image, recording.camera, recording.mounting, time),
        counted_faces(simulation, index, hidden),
        tuple(hidden),
    )


def counted_faces(simulation: Simulation, index: int, hidden: Sequence[float | None]) -> tuple[TrueFace, ...]:
    """Return the pallets beside the path as one shot should show them.

    Visible are those that `palletloc.evaluation` counts as such, except for the ones of which more than
    `MOST_HIDDEN` is hidden, and the ones that the image does not hold whole.
    """
    faces = true_faces(
        [TruePallet(pallet.name, pallet.model.name, pallet.world_from_pallet) for pallet in simulation.aisle.pallets],
        {model.name: model.width for model in simulation.spec.aisle.models},
        simulation.truth.pose_at(float(simulation.times[index])),
        _bearing_frame(simulation),
    )
    return tuple(
        replace(face, visible=face.visible and share is not None and share <= MOST_HIDDEN)
        for face, share in zip(faces, hidden, strict=True)
    )


def _bearing_frame(simulation: Simulation) -> RigidTransform:
    """Return the frame whose x axis the bearings of visible faces count from.

    That of a lens turned to the shelf says nothing about how a face is seen; the forklift's does.
    """
    mounting = simulation.recorded_mounting
    if simulation.spec.camera in (CameraKind.EQUIRECTANGULAR, CameraKind.DUAL_FISHEYE):
        return mounting
    return RigidTransform.from_translation(mounting.translation)


def recorded(simulation: Simulation) -> Recording:
    """Return what a simulation's recording would say, without any file."""
    translation, rotation = (
        (sigma,) * 3 if sigma else None
        for sigma in (simulation.spec.mounting_translation_sigma, simulation.spec.mounting_rotation_sigma)
    )
    return Recording(
        folder=Path(f"scene-{simulation.seed}"),
        camera=simulation.camera,
        forklift_from_camera=simulation.recorded_mounting,
        shelf=simulation.shelf,
        models=simulation.spec.aisle.models,
        shots=(),
        odometry=simulation.odometry,
        translation_sigma=translation,
        rotation_sigma=rotation,
    )


def look(exposure: Exposure, localizer: Localizer) -> ShotViews:
    """Localize the pallets of a shot and compare them with the truth.

    Parameters
    ----------
    exposure : Exposure
        The shot.
    localizer : Localizer
        For its recording.
    """
    shelf = exposure.recording.shelf_at(exposure.shot.time, localizer.config.prior)
    explained = localizer.explain(exposure.shot, shelf)
    camera_height = float(exposure.recording.forklift_from_camera.translation[2])
    result = match_shot(exposure.shot.time, from_measurements(explained.measurements), exposure.faces)
    errors = {error.face.id: error for error in result.errors}
    heights = {model.name: model.height for model in exposure.recording.models}
    views = [
        View(
            exposure.scene,
            face,
            height_class(face.below, heights[face.model]),
            hidden or 0.0,
            errors.get(face.id),
            face in result.missed and _given_up(explained, face),
        )
        for face, hidden in zip(exposure.faces, exposure.hidden, strict=True)
        if face.visible
    ]
    false = [
        height_class(camera_height - estimate.forklift_from_pallet.z, heights[estimate.model])
        for estimate in result.false
    ]
    return ShotViews(exposure.scene.full, tuple(views), tuple(false))


def _given_up(explained: Explanation, face: TrueFace) -> bool:
    """Tell whether a candidate was given up where a pallet stands."""
    true = face.forklift_from_pallet.as_array()[:3]
    places = [
        (refusal.candidate.start if refusal.fit is None else refusal.fit.pose).as_array()[:3]
        for refusal in explained.outcomes
        if isinstance(refusal, Refusal)
    ]
    return any(float(np.linalg.norm(place - true)) < PAIRING_DISTANCE for place in places)
