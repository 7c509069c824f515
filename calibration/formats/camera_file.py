"""What a camera file holds: one camera or several, with their places against the first; and our own form of it.

Ours is the key ``camera`` of recording.yaml, rig.yaml and the files that a calibration of lenses writes.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from calibration.formats.fields import Fields, FormatError
from calibration.lenses.models import MODELS, OPTICAL_FROM_CAMERA, model_of
from palletloc.cameras import CameraModel, DualFisheye, FisheyeLens, KannalaBrandt
from palletloc.geometry import FloatArray
from palletloc.io.camera_spec import spec_from_camera
from palletloc.io.schema import CameraSpec
from palletloc.io.yaml_document import Document, format_document
from palletloc.ranges import range_of

_RIGID = 1e-3
"""How far a matrix may be from a rigid transform: files have four digits or more."""
_LEAST_FIELD = float(np.radians(1.0))
"""Lenses whose image ends or folds sooner off axis, in radians, are none."""
_OPTICAL = RigidTransform.from_rotation(Rotation.from_matrix(OPTICAL_FROM_CAMERA))
"""Turns the camera frame into the optical one."""


@dataclass(frozen=True, slots=True, eq=False)
class FiledCamera:
    """One of the cameras."""

    name: str
    """As the file has it."""
    camera: CameraModel
    """How it images."""
    first_from_camera: RigidTransform
    """Where it is in the first camera's frame; both frames x forward, y left, z up."""
    note: str = ""
    """What was decided when it was read that the user should know."""
    placed: bool = True
    """Whether the file says where it is."""


def alone(name: str, camera: CameraModel, note: str = "") -> FiledCamera:
    """Return a camera that is the only one."""
    return FiledCamera(name, camera, RigidTransform.identity(), note)


def built(fields: Fields, build: Callable[[], CameraModel]) -> CameraModel:
    """Return what a constructor builds.

    Raises
    ------
    FormatError
        If the numbers describe no camera; names file and key.
    """
    try:
        return build()
    except ValueError as error:
        where = f"{fields.path}: {fields.place}: " if fields.place else f"{fields.path}: "
        raise FormatError(f"{where}{error}") from None


def fisheye(fields: Fields, size: tuple[int, int], lens: Sequence[float], terms: Sequence[float]) -> CameraModel:
    """Return a Kannala-Brandt lens that sees as far as its own polynomial rises.

    Parameters
    ----------
    fields : Fields
        Where it stands, for errors.
    size : (int, int)
        Width and height of the image, in pixels.
    lens : sequence of float
        fx, fy, cx, cy.
    terms : sequence of float
        k1, k2, k3, k4.
    """
    fx, fy, cx, cy = lens
    angles = np.linspace(0, np.pi, 2000)
    radii = angles + (angles[:, None] ** np.array([3, 5, 7, 9])) @ np.array(terms)
    falls = np.flatnonzero(np.diff(radii) <= 1e-4 * angles[1])
    rises = angles[falls[0]] * 0.999 if falls.size else np.pi
    corners = np.array([(u, v) for u in (-0.5, size[0] - 0.5) for v in (-0.5, size[1] - 0.5)])
    farthest = float(np.linalg.norm((corners - (cx, cy)) / (fx, fy), axis=-1).max()) if fx > 0 and fy > 0 else 0.0
    shown = float(angles[min(int(np.searchsorted(np.maximum.accumulate(radii), farthest)), len(angles) - 1)])
    limit = float(min(rises, shown)) or np.pi / 2
    if limit < _LEAST_FIELD:
        raise fields.wrong(f"this lens sees {np.degrees(limit):.1g} degrees off axis; expected smaller coefficients")
    k1, k2, k3, k4 = terms
    return built(fields, lambda: KannalaBrandt(*size, fx, fy, cx, cy, k1, k2, k3, k4, limit))


def filed_lens(
    fields: Fields, model: str, size: tuple[int, int], lens: Sequence[float], shape: Sequence[float]
) -> CameraModel:
    """Return a lens of a model.

    Parameters
    ----------
    fields : Fields
        Where it stands, for errors.
    model : str
        Name of the model.
    size : (int, int)
        Width and height of the image, in pixels.
    lens : sequence of float
        fx, fy, cx, cy.
    shape : sequence of float
        The model's other parameters, in the order of its camera; those at the end may be left out.

    Raises
    ------
    FormatError
        If the numbers describe no camera; names file and key.
    """
    for value in lens:
        if fault := range_of("focal_px").fault(value):
            raise fields.wrong(f"focal lengths and centre: {fault}")
    if model == "kannala_brandt":
        return fisheye(fields, size, lens, shape)
    named: dict[str, Any] = dict(zip(MODELS[model].parameters, (*lens, *shape), strict=False))
    return built(fields, lambda: MODELS[model].camera_type(*size, **named))


def filed_shape(camera: CameraModel, models: Sequence[str], form: str) -> tuple[str, list[float], list[float]]:
    """Return the name of a lens's model, its fx, fy, cx, cy, and its other parameters in the order of the camera.

    Raises
    ------
    ValueError
        If a format does not know the model.
    """
    model = model_of(camera)
    if model is None or model.name not in models:
        raise ValueError(f"{form} has no form for this {type(camera).__name__}")
    values = [getattr(camera, name) for name in model.parameters]
    return model.name, values[:4], values[4:]


def optical(first_from_camera: RigidTransform) -> FloatArray:
    """Return a transform between camera frames as a matrix between optical ones (right, down, forward)."""
    return np.asarray((_OPTICAL * first_from_camera * _OPTICAL.inv()).as_matrix())


def from_optical(fields: Fields, matrix: FloatArray) -> RigidTransform:
    """Return a matrix between optical frames as a transform between camera frames.

    Raises
    ------
    FormatError
        If it is no rotation with a translation.
    """
    turn = matrix[:3, :3]
    if (
        np.abs(turn @ turn.T - np.eye(3)).max() > _RIGID
        or np.linalg.det(turn) < 0
        or np.abs(matrix[3] - [0, 0, 0, 1]).max() > _RIGID
    ):
        raise fields.fault("a rotation with a translation")
    transform = RigidTransform.from_components(matrix[:3, 3], Rotation.from_matrix(turn))
    return _OPTICAL.inv() * transform * _OPTICAL


def as_cameras(camera: CameraModel, name: str) -> list[FiledCamera]:
    """Return a camera as files of other programs have it: each lens on its own."""
    if not isinstance(camera, DualFisheye):
        return [alone(name, camera)]
    front, back = camera.front, camera.back
    between = front.camera_from_lens.inv() * back.camera_from_lens
    return [alone(f"{name}0", front.model), FiledCamera(f"{name}1", back.model, between)]


def side_by_side(first: FiledCamera, second: FiledCamera) -> DualFisheye | None:
    """Return two fisheye cameras as one whose images stand side by side; None where they are no such pair."""
    left, right = first.camera, second.camera
    if not (isinstance(left, KannalaBrandt) and isinstance(right, KannalaBrandt)) or left.height != right.height:
        return None
    width = left.width + right.width
    lenses = [replace(lens, width=width, cx=lens.cx + offset) for lens, offset in ((left, 0), (right, left.width))]
    middle = RigidTransform.from_translation(second.first_from_camera.translation / 2)
    return DualFisheye(
        FisheyeLens(lenses[0], middle.inv()), FisheyeLens(lenses[1], middle.inv() * second.first_from_camera)
    )


class _CameraSheet(Document):
    """The file that a calibration of lenses writes."""

    format: Literal[1]
    camera: CameraSpec


def camera_text(camera: CameraModel) -> str:
    """Return a camera in our own form."""
    return format_document(_CameraSheet(format=1, camera=spec_from_camera(camera)))
