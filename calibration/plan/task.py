"""A layout of targets that is planned: camera, its rough mounting, and where the targets will hang."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field
from scipy.spatial.transform import RigidTransform, Rotation

from calibration.mounting.problem import SurveyedTarget
from calibration.mounting.task import EXTRINSICS, CornersSpec
from calibration.plan.prediction import Layout, PlannedTarget
from calibration.targets.target_file import CharucoSpec, Positive, TagSpec, refuse_shared_ids, target_from_spec
from calibration.targets.targets import Target, on_board, patterns
from palletloc.geometry import FloatArray
from palletloc.io.camera_spec import camera_from_spec, transform_from_angles
from palletloc.io.reading import require_file
from palletloc.io.schema import CameraSpec, MountingSpec, Number, Triple
from palletloc.io.yaml_document import Document, DocumentError, read_document

_CORNER_PX = 0.1
"""How well a corner is measured where nothing is said, in pixels: real prints are not quite flat."""


class _PlannedTargetSpec(Document):
    """One target: `charuco` or `tag`, and where it will be."""

    charuco: CharucoSpec | None = None
    tag: TagSpec | None = None
    corners_m: CornersSpec | None = None
    center_m: Triple | None = None
    """Middle of the pattern, in place of its corners."""
    facing_deg: Number | None = None
    """With `center_m`: heading of the normal that points away from the print; without it, towards the camera."""
    sigma_m: Positive


class _PlanSpec(Document):
    """The file of a layout; an extrinsics.yaml with a rough mounting is one."""

    format: Literal[1]
    camera: CameraSpec
    forklift_from_camera: MountingSpec
    corner_px: Positive | None = None
    corner_deg: Positive | None = None
    shots: tuple[str, ...] | None = None
    """Not used."""
    targets: Annotated[dict[str, _PlannedTargetSpec], Field(min_length=1)]


def read_layout(path: Path) -> Layout:
    """Read a layout.

    Parameters
    ----------
    path : Path
        The file, or a folder with extrinsics.yaml.

    Raises
    ------
    PalletLocError
        If the file is missing or wrong; names file, key and what was expected.
    """
    path = path / EXTRINSICS if path.is_dir() else path
    require_file(path, f"a layout in the form of {EXTRINSICS}, or a folder that has one")
    spec = read_document(path, _PlanSpec)
    if spec.corner_px is not None and spec.corner_deg is not None:
        raise DocumentError(f"{path}: expected one of the keys corner_px and corner_deg")
    try:
        camera = camera_from_spec(spec.camera)
    except ValueError as error:
        raise DocumentError(f"{path}: camera: {error}") from error
    mounting = transform_from_angles(
        spec.forklift_from_camera.translation_m, spec.forklift_from_camera.roll_pitch_yaw_deg
    )
    printed = {name: target_from_spec(path, name, given.charuco, given.tag) for name, given in spec.targets.items()}
    refuse_shared_ids(path, printed)
    targets = tuple(
        _planned(path, name, printed[name], hung, mounting.translation) for name, hung in spec.targets.items()
    )
    angle = None if spec.corner_deg is None else float(np.radians(spec.corner_deg))
    return Layout(camera, mounting, targets, spec.corner_px or _CORNER_PX, angle)


def _planned(path: Path, name: str, target: Target, spec: _PlannedTargetSpec, eye: FloatArray) -> PlannedTarget:
    pattern = patterns(target)[0]
    outline = on_board(pattern.outline)
    if (spec.corners_m is None) == (spec.center_m is None):
        raise DocumentError(f"{path}: targets.{name}: expected one of the keys corners_m and center_m")
    if spec.corners_m is not None:
        if spec.facing_deg is not None:
            raise DocumentError(f"{path}: targets.{name}: facing_deg goes with center_m, not with corners_m")
        points = spec.corners_m.points()
    else:
        points = _upright(np.array(spec.center_m), spec.facing_deg, eye, outline).apply(outline)
    return PlannedTarget(pattern, SurveyedTarget(name, outline, points, spec.sigma_m))


def _upright(center: FloatArray, facing_deg: float | None, eye: FloatArray, outline: FloatArray) -> RigidTransform:
    """Return the pose of an upright target with its middle at a place."""
    back = center - eye
    heading = np.arctan2(back[1], back[0]) if facing_deg is None else np.radians(facing_deg) + np.pi
    into = np.array([np.cos(heading), np.sin(heading), 0.0])
    axes = np.stack([np.cross(into, [0.0, 0.0, 1.0]), [0.0, 0.0, -1.0], into], axis=1)
    rotation = Rotation.from_matrix(axes)
    return RigidTransform.from_components(center - rotation.apply((outline[1] + outline[2]) / 2), rotation)
