"""Whose frame a file's poses are in, and the level poses of the forklift from them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from palletloc.geometry import FloatArray
from palletloc.io.camera_spec import rotation_from_angles
from palletloc.io.csv_table import TableError
from palletloc.io.schema import PathSpec

_MAX_TILT_DEG = 5.0
"""Tilt beyond which a pose is not that of a vehicle on a floor, in degrees."""
_FORKLIFT_FROM_OPTICAL = Rotation.from_matrix([[0, 0, 1], [-1, 0, 0], [0, -1, 0]])
"""Of a frame with x to the right, y down and z forward (REP 103, suffix ``_optical``)."""


class PoseFrame(StrEnum):
    """Whose poses a file holds."""

    BODY = "body"
    """x forward, y left, z up."""
    OPTICAL = "optical"
    """x right, y down, z forward: of a camera; its world may be such a frame, too."""


@dataclass(frozen=True, slots=True)
class PathForm:
    """What a file of poses cannot say itself."""

    frame: PoseFrame | None = None
    """Whose poses they are; None for the body's, and for KITTI's what makes them level."""
    rotation: Rotation | None = None
    """``forklift_from_body``: how the body is turned on the forklift; None where it is not."""
    times: Path | None = None
    """File with one time a line, in seconds, for KITTI."""


def path_form(folder: Path, spec: PathSpec | None) -> PathForm:
    """Return what recording.yaml says of a file of poses; names in it are relative to the folder."""
    if spec is None:
        return PathForm()
    frame = None if spec.frame is None else PoseFrame(spec.frame)
    rotation = None if spec.rotation_deg is None else rotation_from_angles(spec.rotation_deg)
    return PathForm(frame, rotation, None if spec.times is None else folder / spec.times)


def level_path(
    path: Path, lines: Sequence[int], places: FloatArray, turns: FloatArray, form: PathForm
) -> tuple[FloatArray, FloatArray]:
    """Return the level part of poses.

    Parameters
    ----------
    path : Path
        The file, for errors.
    lines : sequence of int
        Line of each pose.
    places : (n, 3) array
        In metres.
    turns : (n, 4) or (n, 9) array
        Quaternions with their scalar last, or matrices row by row.
    form : PathForm
        Whose poses they are.

    Returns
    -------
    places : (n, 3) array
        In a world with z up.
    yaw : (n,) array
        Heading of the forklift, in radians.

    Raises
    ------
    TableError
        If a rotation is none, or the forklift would be tilted; names the line.
    """
    is_matrix = turns.shape[1] == 9
    lengths = np.cbrt(np.abs(np.linalg.det(turns.reshape(-1, 3, 3)))) if is_matrix else np.linalg.norm(turns, axis=1)
    wrong = np.flatnonzero(np.abs(lengths - 1) > 0.01)
    if wrong.size:
        what = "a rotation matrix" if is_matrix else "a quaternion"
        at = int(wrong[0])
        raise TableError(f"{path}, line {lines[at]}: expected {what} of length 1, got {lengths[at]:.3g}")
    world_from_body = Rotation.from_matrix(turns.reshape(-1, 3, 3)) if is_matrix else Rotation.from_quat(turns)
    body = form.rotation or Rotation.identity()
    choices = [(world_from_body * body.inv(), places)]
    if form.frame is PoseFrame.OPTICAL or (form.frame is None and is_matrix):
        turned = world_from_body * _FORKLIFT_FROM_OPTICAL.inv()
        optical = [(turned, places), (_FORKLIFT_FROM_OPTICAL * turned, _FORKLIFT_FROM_OPTICAL.apply(places))]
        choices = optical if form.frame is PoseFrame.OPTICAL else [*choices, *optical]
    world_from_forklift, places = min(choices, key=lambda choice: float(np.median(_tilt(choice[0]))))
    tilts = np.degrees(_tilt(world_from_forklift))
    if tilts.max() > _MAX_TILT_DEG:
        at = int(np.argmax(tilts > _MAX_TILT_DEG))
        hint = "" if form.frame is not None or form.rotation is not None else _frame_hint(world_from_body)
        raise TableError(
            f"{path}, line {lines[at]}: the pose is tilted by {tilts[at]:.1f} degrees, expected at"
            f" most {_MAX_TILT_DEG:.0f}: z up, and the scalar of the quaternion last{hint}"
        )
    matrix = world_from_forklift.as_matrix()
    return places, np.arctan2(matrix[:, 1, 0], matrix[:, 0, 0])


def _tilt(rotation: Rotation) -> FloatArray:
    """Return the angles between the z axes, in radians."""
    return np.asarray(2 * np.arcsin(np.clip(np.linalg.norm(rotation.as_quat()[:, :2], axis=1), 0.0, 1.0)))


def _frame_hint(world_from_body: Rotation) -> str:
    turned = world_from_body * _FORKLIFT_FROM_OPTICAL.inv()
    level = min(float(np.median(_tilt(choice))) for choice in (turned, _FORKLIFT_FROM_OPTICAL * turned))
    return (
        "; they are level as poses of a camera: state 'frame: optical'" if level < math.radians(_MAX_TILT_DEG) else ""
    )
