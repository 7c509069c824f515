"""From shots to observations: every target that is seen, its corners aligned with its print."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

from calibration.bearings import pose_from_bearings
from calibration.targets.board_detection import SCALES, DetectedTarget, Marker, detect_markers, find_target
from calibration.targets.targets import PrintedPattern, Target, border_of, on_board
from calibration.targets.texture_alignment import AlignedCorners, align_corners
from palletloc.cameras.protocol import CameraModel
from palletloc.geometry import BoolArray, FloatArray, Image


@dataclass(frozen=True, slots=True, eq=False)
class CornerObservation:
    """Corners of one target as the camera sees them in one shot."""

    target: int
    """Number of the target."""
    points: FloatArray
    """(n, 3) in the board frame."""
    bearings: FloatArray
    """(n, 3) unit vectors in the camera frame."""
    origins: FloatArray
    """(n, 3) where they start, in metres."""
    sigma: FloatArray
    """(n,) standard deviations, in radians."""

    def kept(self, chosen: BoolArray) -> CornerObservation:
        """Return the observation with the chosen corners only, (n,)."""
        return replace(
            self,
            points=self.points[chosen],
            bearings=self.bearings[chosen],
            origins=self.origins[chosen],
            sigma=self.sigma[chosen],
        )


@dataclass(frozen=True, slots=True, eq=False)
class TargetObservation:
    """One target in one shot."""

    target: str
    """Its name."""
    shot: str
    """The shot's file."""
    pattern: PrintedPattern
    """What is printed."""
    markers: int
    """How many of its markers were seen."""
    corners: AlignedCorners
    """Where its corners are."""

    def numbered(self, target: int) -> CornerObservation:
        """Return its corners as an adjustment takes them, with the number of the target."""
        corners = self.corners
        return CornerObservation(target, on_board(corners.points), corners.bearings, corners.origins, corners.sigma)


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
    camera, image
        As for `sphere_patches`.
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
    found: dict[str, DetectedTarget] = {}
    markers: dict[tuple[str, int], list[Marker]] = {}
    for scale in SCALES:
        missing = {name: target for name, target in targets.items() if name not in found}
        for dictionary, border in sorted({(target.dictionary, border_of(target)) for target in missing.values()}):
            on_progress(f"{shot}: looking for markers of {dictionary}")
            markers[dictionary, border] = detect_markers(camera, image, dictionary, scale, border)
        for name, target in missing.items():
            detected = find_target(camera, markers[target.dictionary, border_of(target)], target, name)
            if detected is not None:
                found[name] = detected
    on_progress(f"{shot}: measuring {len(found)} targets")
    measured = {name: _measure(camera, image, detected) for name, detected in found.items()}
    return [
        TargetObservation(name, shot, found[name].pattern, found[name].markers, aligned)
        for name in targets
        if (aligned := measured.get(name)) is not None
    ]


def _measure(camera: CameraModel, image: Image, detected: DetectedTarget) -> AlignedCorners | None:
    points = on_board(detected.pattern.corners)
    bearings = detected.directions(detected.pattern.corners)
    pose = pose_from_bearings(points, bearings)
    if pose is None:
        return None
    # Patches show what is far away; of two lens centres the nearer one in direction sees the target.
    center = camera.centers(pose.apply(points)).mean(0)
    shifted = type(pose).from_components(pose.translation + center, pose.rotation)
    return align_corners(camera, image, detected.pattern, shifted)
