"""Finding markers in a shot, and the targets that they belong to.

Markers are detected in gnomonic patches. All markers of a target vote for one homography from its paper to
the tangent plane; a marker elsewhere with the same number shows as a second target.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import ArrayLike

from calibration.targets.patches import pixel_density, sphere_patches, view_axes
from calibration.targets.targets import PrintedPattern, Target, border_of, marker_dictionary, patterns
from palletloc.cameras.protocol import CameraModel
from palletloc.errors import PalletLocError
from palletloc.geometry import BoolArray, FloatArray, Image

SCALES = (1.5, 3.0)
"""Pixels of a patch per pixel of the shot: the second pass is for what the first did not find."""
_TOLERANCE_PX = 1.5
"""How far a marker's corner may be from where its board has it, in pixels: detection without alignment is as good."""
_SADDLE_HALF, _STOP = 4, (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 30, 1e-2)
"""Half side of the window in which a corner of a grid's tag settles, in pixels, and when it has."""
_SAME = 0.5
"""Two markers of one number are the same where they are nearer than this part of their diagonal."""
_MIN_MARKERS = 2
"""Fewer markers do not make a board: a single one may be a misreading."""
_MISPRINTED = 3
"""So many markers tell that a board is mirrored or inverted: fewer may be misreadings."""
MIRRORED = "its markers are mirrored: the board was printed as its mirror image, or the shot is flipped"
"""What is said of a mirrored print."""
INVERTED = "its markers are inverted: the board was printed as its negative, white for black"
"""What is said of a negative."""
_MIN_COS = 0.2
"""Markers farther off the middle than the angle of this cosine are not on its tangent plane."""
_BLIND_DENSITY = 500.0
"""Pixels per radian where the camera does not see the middle of the markers: a panorama of 3142 columns."""


class DuplicateTargetError(PalletLocError):
    """A marker that should exist once is in a shot twice."""


@dataclass(frozen=True, slots=True, eq=False)
class Marker:
    """A marker in a shot."""

    id: int
    """Its number in its dictionary."""
    corners: FloatArray
    """(4, 3) unit vectors to its corners in the camera frame: upper left, upper right, lower right, lower left."""


@dataclass(frozen=True, slots=True, eq=False)
class DetectedTarget:
    """A target in a shot, from its markers alone."""

    pattern: PrintedPattern
    """What is printed; of a board with even rows the layout that fits."""
    tangent_from_pattern: FloatArray
    """(3, 3) homography from pattern coordinates to the tangent plane."""
    axes: FloatArray
    """(3, 3): right, down and forward of the tangent plane in the camera frame, as rows."""
    markers: int
    """How many of its markers were seen."""

    def directions(self, points: FloatArray) -> FloatArray:
        """Return the unit vectors in the camera frame to points of the pattern, (..., 2)."""
        ones = np.ones((*points.shape[:-1], 1))
        rays = np.concatenate([points, ones], axis=-1) @ self.tangent_from_pattern.T @ self.axes
        unit: FloatArray = rays / np.linalg.norm(rays, axis=-1, keepdims=True)
        return unit


def detect_markers(camera: CameraModel, image: Image, dictionary: str, scale: float, border: int = 1) -> list[Marker]:
    """Find the markers of one dictionary all over a shot.

    Parameters
    ----------
    camera, image
        As for `sphere_patches`.
    dictionary : str
        Name of the dictionary.
    scale : float
        Pixels of a patch per pixel of the shot.
    border : int
        Width of the markers' black border, in modules.

    Returns
    -------
    list of Marker
        One for each place and number.

    Raises
    ------
    TargetError
        If there is no such dictionary.
    """
    detector = _detector(dictionary, border)
    seen: list[Marker] = []
    for patch in sphere_patches(camera, image, scale):
        corners, ids, _ = detector.detectMarkers(patch.image)
        if ids is not None:
            found = zip(np.ravel(ids), (_settled(patch.image, c, border) for c in corners), strict=True)
            seen.extend(Marker(int(i), patch.directions(c)) for i, c in found)
    return _merge_markers(seen)


def misprint(camera: CameraModel, image: Image, target: Target) -> str:
    """Return what is wrong with the print of a target whose markers are not seen; nothing where that is not known.

    Parameters
    ----------
    camera, image
        As for `sphere_patches`.
    target : Target
        With several markers: a single one may be another's mirror image.
    """
    detector, known = _detector(target.dictionary, border_of(target)), set(patterns(target)[0].marker_ids.tolist())
    seen: dict[str, set[int]] = {MIRRORED: set(), INVERTED: set()}
    for patch in sphere_patches(camera, image, SCALES[0]):
        changed = {MIRRORED: np.ascontiguousarray(patch.image[:, ::-1]), INVERTED: np.asarray(255 - patch.image)}
        for why, picture in changed.items():
            _, ids, _ = detector.detectMarkers(picture)
            if ids is not None:
                seen[why] |= known & set(np.ravel(ids).tolist())
    return next((why for why, ids in seen.items() if len(ids) >= _MISPRINTED), "")


def _detector(dictionary: str, border: int) -> cv2.aruco.ArucoDetector:
    parameters = cv2.aruco.DetectorParameters()
    parameters.markerBorderBits = border
    parameters.minMarkerPerimeterRate = 0.01
    parameters.adaptiveThreshWinSizeMax = 43
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    return cv2.aruco.ArucoDetector(marker_dictionary(dictionary), parameters)


def _settled(image: Image, corners: ArrayLike, border: int) -> FloatArray:
    """Return a marker's corners, (4, 2); those of a grid's tags, which are saddles, settle there."""
    start = np.asarray(corners, dtype=np.float32).reshape(-1, 1, 2)
    if border > 1:
        cv2.cornerSubPix(image, start, (_SADDLE_HALF, _SADDLE_HALF), (-1, -1), _STOP)
    return start.reshape(4, 2).astype(np.float64)


def _merge_markers(seen: Iterable[Marker]) -> list[Marker]:
    """Return the markers, each place once: with the median of what several patches show of it."""
    groups: list[list[Marker]] = []
    for marker in seen:
        for group in groups:
            first = group[0].corners
            side = np.linalg.norm(first[0] - first[2])
            if group[0].id == marker.id and np.linalg.norm((first - marker.corners).mean(0)) < _SAME * side:
                group.append(marker)
                break
        else:
            groups.append([marker])
    return [Marker(group[0].id, _median_directions(group)) for group in groups]


def _median_directions(group: Sequence[Marker]) -> FloatArray:
    middle = np.median([marker.corners for marker in group], axis=0)
    unit: FloatArray = middle / np.linalg.norm(middle, axis=-1, keepdims=True)
    return unit


def find_target(camera: CameraModel, markers: Sequence[Marker], target: Target, name: str) -> DetectedTarget | None:
    """Return where a target is, from the markers of its dictionary.

    Parameters
    ----------
    camera : CameraModel
        Of the shot.
    markers : sequence of Marker
        All that were seen in the shot.
    target : Target
        What to look for.
    name : str
        Of the target, for errors.

    Returns
    -------
    DetectedTarget, optional
        None where too few of its markers were seen together.

    Raises
    ------
    DuplicateTargetError
        If it is there twice.
    """
    best, rest = None, list[Marker]()
    for pattern in patterns(target):
        mine = [marker for marker in markers if marker.id in pattern.marker_ids]
        detected, inliers = _fit(camera, pattern, mine)
        if detected is not None and (best is None or detected.markers > best.markers):
            best, rest = detected, [m for m, inlier in zip(mine, inliers, strict=True) if not inlier]
    if best is None:
        return None
    _refuse_second(camera, best.pattern, rest, name)
    return best


def _refuse_second(camera: CameraModel, pattern: PrintedPattern, rest: Sequence[Marker], name: str) -> None:
    again, _ = _fit(camera, pattern, rest)
    if again is not None:
        ids = sorted({marker.id for marker in rest})
        raise DuplicateTargetError(
            f"target {name}: its markers are in the shot twice ({pattern.dictionary}, id {ids[0]} and others);"
            " expected every id once in view: cover one of the two, or print it with other ids"
        )


def _fit(
    camera: CameraModel, pattern: PrintedPattern, markers: Sequence[Marker]
) -> tuple[DetectedTarget | None, BoolArray]:
    """Return the detected target that most markers agree on, and which they are."""
    none = np.zeros(len(markers), dtype=np.bool_)
    least = min(_MIN_MARKERS, len(pattern.marker_ids))
    if len(markers) < least:
        return None, none
    directions = np.stack([marker.corners for marker in markers])
    middle = np.median(directions.reshape(-1, 3), axis=0)
    axes = view_axes(middle)
    plane = directions @ axes.T
    near = (plane[..., 2] > _MIN_COS).all(-1)
    index = {int(number): i for i, number in enumerate(pattern.marker_ids)}
    paper = pattern.marker_corners[[index[marker.id] for marker in markers]]
    if near.sum() < least:
        return None, none
    density = pixel_density(camera, middle[None] / np.linalg.norm(middle))[0]
    tolerance = _TOLERANCE_PX / (density if np.isfinite(density) else _BLIND_DENSITY)
    flat = plane[near, :, :2] / plane[near, :, 2:]
    found, _ = cv2.findHomography(
        paper[near].reshape(-1, 1, 2), flat.reshape(-1, 1, 2), cv2.RANSAC, tolerance, maxIters=2000
    )
    homography = np.asarray(found, dtype=np.float64)  # an empty one where there is none
    if homography.shape != (3, 3):
        return None, none
    error = cv2.perspectiveTransform(paper[near].reshape(-1, 1, 2), homography).reshape(-1, 4, 2) - flat
    good = np.linalg.norm(error, axis=-1).max(-1) < 2 * tolerance
    none[np.flatnonzero(near)[good]] = True
    if good.sum() < least:
        return None, none
    return DetectedTarget(pattern, homography, axes, int(good.sum())), none
