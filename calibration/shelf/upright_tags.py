"""Tags glued to the uprights: the surest way to the front, where there are any."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from calibration.bearings import pose_from_bearings
from calibration.drive import compose
from calibration.shelf.plane import Foot, PlaneEstimate, depth_residuals, robust_plane
from calibration.targets.board_detection import SCALES, detect_markers
from calibration.targets.observations import observe
from calibration.targets.targets import SingleTag, on_board
from palletloc.geometry import FloatArray
from palletloc.io.recording import Recording

TAGS = "tags"
"""Name of the method."""
_GLUED, _TURN_SIGMA = 0.002, float(np.radians(6.0))
"""How far tags stand off the front, in metres, and how well the heading is known before, in radians."""
_NEAR = 0.6
"""Tags farther from the front, in metres, are elsewhere."""
_ROUNDS = 8
"""Steps of the robust line: more than the weights need to settle."""
_HUBER = 2.0
"""Residuals beyond this many standard deviations count by their size: looser than usual, for tags are few."""


@dataclass(frozen=True, slots=True)
class TagsOnUprights:
    """Which tags to look for; each number once."""

    dictionary: str
    """As OpenCV names it."""
    size: float
    """Side of the black square, in metres."""
    offset: float = 0.0
    """How far the tags' faces lie before the front plane, in metres."""


def tag_places(
    recording: Recording,
    shots: Sequence[int],
    poses: FloatArray,
    tags: TagsOnUprights,
    on_progress: Callable[[str], None] = lambda _: None,
) -> dict[int, FloatArray]:
    """Return where each tag is seen in each shot.

    Parameters
    ----------
    recording, shots, poses
        As for `beam_lines`.
    tags : TagsOnUprights
        Which tags.
    on_progress : callable
        Is told what is done next.

    Returns
    -------
    dict of int to (k, 2) array
        For each tag's number its middle in odom, in metres.

    Raises
    ------
    PalletLocError
        If the dictionary is unknown, or a number is there twice.
    """
    places: dict[int, list[FloatArray]] = {}
    for index, pose in zip(shots, poses, strict=True):
        shot = recording.shots[index]
        image = recording.image(shot, gray=True)
        seen = {marker.id for marker in detect_markers(recording.camera, image, tags.dictionary, SCALES[0])}
        targets = {str(number): SingleTag(tags.size, tags.dictionary, number) for number in sorted(seen)}
        for target in observe(recording.camera, image, shot.file, targets, on_progress) if targets else ():
            camera_from_tag = pose_from_bearings(on_board(target.corners.points), target.corners.bearings)
            if camera_from_tag is not None:
                middle = on_board(target.corners.points).mean(axis=0)
                x, y, _ = recording.forklift_from_camera.apply(camera_from_tag.apply(middle))
                places.setdefault(int(target.target), []).append(compose(pose, np.array([x, y, 0.0]))[:2])
    return {number: np.array(found) for number, found in places.items()}


def tag_plane(
    places: dict[int, FloatArray], foot: Foot, tags: TagsOnUprights, distance: float | None = None
) -> PlaneEstimate | None:
    """Return the front plane behind tags.

    Parameters
    ----------
    places : dict of int to (k, 2) array
        From `tag_places`.
    foot : Foot
        What the plane is described from; its heading is trusted to six degrees.
    tags : TagsOnUprights
        Says how far before the front they are.
    distance : float, optional
        About how far the front is: tags that are elsewhere do not belong to it.

    Returns
    -------
    PlaneEstimate or None
        None where no tag is on the front.
    """
    middles = np.array([np.median(found, axis=0) for found in places.values()]).reshape(-1, 2)
    right, depth = foot.local(middles).T
    spread = np.array([np.ptp(found @ [np.cos(foot.yaw), np.sin(foot.yaw)]) for found in places.values()])
    near = np.ones(len(right), bool) if distance is None else np.abs(depth - distance) < _NEAR
    if not near.any():
        return None
    right, depth, sigma = right[near], depth[near], np.hypot(_GLUED, spread[near] / 2)

    def residuals(turn: float, along: float) -> tuple[FloatArray, FloatArray]:
        return depth_residuals(right, depth, turn, along - tags.offset)

    prior = np.diag([1 / _TURN_SIGMA**2, 0.0])
    start = float(np.median(depth))
    turn, along, information = robust_plane(residuals, sigma, prior, start, _HUBER, _ROUNDS)
    evidence = f"{len(right)} tag{'s' * (len(right) > 1)}"
    return PlaneEstimate(TAGS, turn, along, information, evidence)
