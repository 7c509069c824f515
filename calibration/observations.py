"""From shots to observations: every target that is seen, its corners aligned with its print."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from calibration.bearing_dlt import pose_from_bearings
from calibration.board_detection import SCALES, Marker, Sighting, detect_markers, find_target
from calibration.targets import Pattern, Target
from calibration.texture_alignment import AlignedCorners, align_corners, on_board
from palletloc.cameras.protocol import CameraModel
from palletloc.geometry import Image


@dataclass(frozen=True, slots=True, eq=False)
class TargetObservation:
    """One target in one shot."""

    target: str
    """Its name."""
    shot: str
    """The shot's file."""
    pattern: Pattern
    """What is printed."""
    markers: int
    """How many of its markers were seen."""
    corners: AlignedCorners
    """Where its corners are."""


def observe(
    camera: CameraModel,
    image: Image,
    shot: str,
    targets: Mapping[str, Target],
    on_progress: Callable[[str], None] = lambda _: None,
) -> list[TargetObservation]:
    """Find and measure the targets in one shot.

    Parameters
    ----------
    camera : CameraModel
        Of the shot.
    image : (height, width) array of uint8
        The shot in gray.
    shot : str
        Its name.
    targets : mapping of str to Target
        What to look for.
    on_progress : callable
        Is told what is done next.

    Returns
    -------
    list of TargetObservation
        One for each target that is seen, in the order of the targets.

    Raises
    ------
    DuplicateTargetError
        If a target is there twice.
    TargetError
        If a target cannot exist.
    """
    found: dict[str, Sighting] = {}
    markers: dict[str, list[Marker]] = {}
    for scale in SCALES:
        missing = {name: target for name, target in targets.items() if name not in found}
        for dictionary in sorted({target.dictionary for target in missing.values()}):
            on_progress(f"{shot}: looking for markers of {dictionary}")
            markers[dictionary] = detect_markers(camera, image, dictionary, scale)
        for name, target in missing.items():
            sighting = find_target(camera, markers[target.dictionary], target, name)
            if sighting is not None:
                found[name] = sighting
    on_progress(f"{shot}: measuring {len(found)} targets")
    measured = {name: _measure(camera, image, sighting) for name, sighting in found.items()}
    return [
        TargetObservation(name, shot, found[name].pattern, found[name].markers, aligned)
        for name in targets
        if (aligned := measured.get(name)) is not None
    ]


def _measure(camera: CameraModel, image: Image, sighting: Sighting) -> AlignedCorners | None:
    points = on_board(sighting.pattern.corners)
    bearings = sighting.directions(sighting.pattern.corners)
    pose = pose_from_bearings(points, bearings)
    if pose is None:
        return None
    # Patches show what is far away; of two lens centres the nearer one in direction sees the target.
    center = camera.centers(pose.apply(points)).mean(0)
    shifted = type(pose).from_components(pose.translation + center, pose.rotation)
    return align_corners(camera, image, sighting.pattern, shifted)
