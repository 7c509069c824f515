"""Which shots of a recording can be used, and whether its way allows to triangulate."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calibration.drive import Drive, compose
from calibration.shelf.front_line import UPRIGHTS
from calibration.shelf.plane import Foot
from palletloc.geometry import FloatArray
from palletloc.io.images import ImageError
from palletloc.io.recording import Recording
from palletloc.shelf import ShelfPlane
from palletloc.trajectory import TrajectoryError

_MOST_SHOTS = 24
"""Shots that are used: more take time and tell little more."""
_LEAST_BASELINE = 0.2
"""Way along the shelf that triangulates, in parts of its distance."""
_LEAST_ACROSS = float(np.radians(15.0))
"""Angle between the way and the direction into the shelf below which things show no parallax, in radians."""


@dataclass(frozen=True, slots=True, eq=False)
class Skipped:
    """A method that could not be used."""

    method: str
    """Its name."""
    code: str
    """Why, for programs."""
    what: str
    """Why, in one sentence."""


def usable_shots(recording: Recording) -> list[int]:
    """Return the indices of shots that odometry reaches and whose images can be read, evenly spread, at most 24."""
    reached = []
    for i, shot in enumerate(recording.shots):
        try:
            recording.odometry.pose_at(shot.time)
        except TrajectoryError:
            continue
        reached.append(i)
    spread = np.linspace(0, len(reached) - 1, min(len(reached), _MOST_SHOTS)).round().astype(int)
    return [reached[i] for i in np.unique(spread) if _readable(recording, reached[i])]


def _readable(recording: Recording, index: int) -> bool:
    try:
        recording.image(recording.shots[index], gray=True)
    except ImageError:
        return False
    return True


def motion_refusal(drive: Drive, camera: FloatArray, foot: Foot, prior: ShelfPlane) -> Skipped | None:
    """Return why the way does not allow to triangulate; None where it does."""
    poses = drive.poses()
    local = foot.local(compose(poses, np.tile([*camera, 0.0], (len(poses), 1)))[:, :2])
    along, deep = np.ptp(local, axis=0)
    distance = abs(foot.described(prior)[1])
    if len(poses) < 3:
        return Skipped(UPRIGHTS, "few_shots", f"{len(poses)} shots are too few to triangulate; three are needed")
    if deep > 0.05 and np.arctan2(along, deep) < _LEAST_ACROSS:
        return Skipped(UPRIGHTS, "along_the_ray", "the camera moves towards the shelf: what it sees has no parallax")
    if along < _LEAST_BASELINE * distance:
        what = f"the camera moves {along:.2f} m along a shelf {distance:.1f} m away; a fifth of that is needed"
        return Skipped(UPRIGHTS, "short_baseline", what)
    return None
