"""Between the yaml form of cameras and mountings, and the values that compute."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from palletloc.cameras.double_sphere import DoubleSphere
from palletloc.cameras.dual_fisheye import DualFisheye, FisheyeLens
from palletloc.cameras.equirectangular import Equirectangular
from palletloc.cameras.eucm import Eucm
from palletloc.cameras.kannala_brandt import KannalaBrandt
from palletloc.cameras.mei import Mei
from palletloc.cameras.pinhole import Pinhole, RationalPinhole
from palletloc.cameras.protocol import CameraModel
from palletloc.cameras.stitched_equirectangular import StitchedEquirectangular, StitchedLens
from palletloc.io.schema import (
    CameraSpec,
    DoubleSphereSpec,
    DualFisheyeSpec,
    EquirectangularSpec,
    EucmSpec,
    KannalaBrandtSpec,
    LensSpec,
    MeiSpec,
    PinholeSpec,
    RationalPinholeSpec,
    StitchedLensSpec,
    StitchedSpec,
    Triple,
)
from palletloc.io.yaml_document import Document, DocumentError, checked_document, load_yaml

_DECIMALS_DEG = 9
"""Of written angles: 2e-11 rad, below what a transform keeps; 0.1 is not written as 0.10000000000000002."""


class _CameraOnly(Document):
    """The camera in any file that has one."""

    camera: CameraSpec


def read_camera(path: str | Path) -> CameraModel:
    """Read the camera of recording.yaml, of rig.yaml or of what a calibration of lenses wrote.

    Parameters
    ----------
    path : str or Path
        A yaml file with the key ``camera``; its other keys are passed over.

    Raises
    ------
    InputError
        If the file cannot be read, is not yaml, or its camera is not one; names the line or the key.
    """
    path = Path(path)
    return camera_in(path, load_yaml(path))


def camera_in(path: Path, content: Any) -> CameraModel:
    """Build the camera that the key ``camera`` of a file describes.

    Parameters
    ----------
    path : Path
        The file, for errors.
    content : any
        What was read from it.

    Raises
    ------
    DocumentError
        If there is none; names the key.
    """
    part = {key: content[key] for key in ("camera",) if key in content} if isinstance(content, dict) else content
    try:
        return camera_from_spec(checked_document(path, part, _CameraOnly).camera)
    except ValueError as error:
        raise DocumentError(f"{path}: camera: {error}") from None


@dataclass(frozen=True, slots=True)
class _LensForm:
    """How a file and a camera call the same numbers of a lens."""

    schema: type[Any]
    """What a file says of it."""
    model: type[Any]
    """The camera."""
    names: Mapping[str, tuple[str, ...]]
    """The camera's fields behind each key of the file."""

    def camera(self, lens: Any, width: int, height: int) -> Any:
        """Build the camera of a lens."""
        values = dict(zip(("fx", "fy", "cx", "cy"), (*lens.focal_px, *lens.center_px), strict=True))
        for key, names in self.names.items():
            given = getattr(lens, key)
            values.update(zip(names, given if len(names) > 1 else (given,), strict=True))
        if "max_angle_deg" in self.schema.model_fields:
            values["max_angle"] = float(np.radians(lens.max_angle_deg))
        return self.model(width, height, **values)

    def keys(self, camera: Any) -> dict[str, Any]:
        """Return the keys and values of a file."""
        values: dict[str, Any] = {"focal_px": (camera.fx, camera.fy), "center_px": (camera.cx, camera.cy)}
        for key, names in self.names.items():
            numbers = tuple(getattr(camera, name) for name in names)
            values[key] = numbers if len(names) > 1 else numbers[0]
        if "max_angle_deg" in self.schema.model_fields:
            values["max_angle_deg"] = degrees(camera.max_angle)
        return values


_LENSES = {
    "pinhole": _LensForm(PinholeSpec, Pinhole, {"distortion": ("k1", "k2", "p1", "p2", "k3")}),
    "rational_pinhole": _LensForm(
        RationalPinholeSpec, RationalPinhole, {"distortion": ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")}
    ),
    "kannala_brandt": _LensForm(KannalaBrandtSpec, KannalaBrandt, {"distortion": ("k1", "k2", "k3", "k4")}),
    "mei": _LensForm(MeiSpec, Mei, {"xi": ("xi",), "distortion": ("k1", "k2", "p1", "p2")}),
    "double_sphere": _LensForm(DoubleSphereSpec, DoubleSphere, {"xi": ("xi",), "alpha": ("alpha",)}),
    "eucm": _LensForm(EucmSpec, Eucm, {"alpha": ("alpha",), "beta": ("beta",)}),
}
"""Cameras with one lens, by the model's name in files."""


def camera_from_spec(spec: CameraSpec) -> CameraModel:
    """Build the camera that a file describes.

    Raises
    ------
    ValueError
        If the numbers describe no camera.
    """
    match spec:
        case EquirectangularSpec():
            return Equirectangular(spec.width, spec.height)
        case DualFisheyeSpec():
            form = _LENSES["kannala_brandt"]
            return DualFisheye(
                *(FisheyeLens(form.camera(lens, spec.width, spec.height), _transform(lens)) for lens in spec.lenses)
            )
        case StitchedSpec():
            lenses = (StitchedLens(_transform(lens), *lens.bend) for lens in spec.lenses)
            return StitchedEquirectangular(spec.width, spec.height, *lenses)
    camera: CameraModel = _LENSES[spec.model].camera(spec, spec.width, spec.height)
    return camera


def spec_from_camera(camera: CameraModel) -> CameraSpec:
    """Describe a camera as files do: the inverse of `camera_from_spec`.

    Raises
    ------
    ValueError
        If it is of a kind that files do not know.
    """
    size = {"width": camera.width, "height": camera.height}
    match camera:
        case Equirectangular():
            return EquirectangularSpec(model="equirectangular", **size)
        case DualFisheye():
            form = _LENSES["kannala_brandt"]
            fisheyes = (LensSpec(**form.keys(lens.model), **_place(lens)) for lens in (camera.front, camera.back))
            return DualFisheyeSpec(model="dual_fisheye", **size, lenses=tuple(fisheyes))
        case StitchedEquirectangular():
            lenses = (
                StitchedLensSpec(**_place(lens), bend=(lens.k1, lens.k2)) for lens in (camera.front, camera.back)
            )
            return StitchedSpec(model="stitched_equirectangular", **size, lenses=tuple(lenses))
    for name, form in _LENSES.items():
        if isinstance(camera, form.model):
            spec: CameraSpec = form.schema(model=name, **size, **form.keys(camera))
            return spec
    raise ValueError(f"a camera of the kind {type(camera).__name__} has no form in files")


def is_panorama(camera: CameraModel) -> bool:
    """Return whether a camera's images are stitched to a whole equirectangular panorama."""
    return isinstance(camera, Equirectangular | StitchedEquirectangular)


def _transform(lens: LensSpec | StitchedLensSpec) -> RigidTransform:
    return transform_from_angles(lens.translation_m, lens.roll_pitch_yaw_deg)


def _place(lens: FisheyeLens | StitchedLens) -> dict[str, Any]:
    translation, angles = angles_from_transform(lens.camera_from_lens)
    return {"translation_m": translation, "roll_pitch_yaw_deg": angles}


def transform_from_angles(translation_m: Triple, roll_pitch_yaw_deg: Triple) -> RigidTransform:
    """Return the transform with this translation and R = Rz(yaw) Ry(pitch) Rx(roll).

    Examples
    --------
    >>> camera_up = transform_from_angles((0.0, 0.0, 1.8), (0.0, -90.0, 0.0))
    >>> camera_up.apply([1.0, 0.0, 0.0]).round(6)
    array([0. , 0. , 2.8])
    """
    return RigidTransform.from_components(translation_m, rotation_from_angles(roll_pitch_yaw_deg))


def rotation_from_angles(roll_pitch_yaw_deg: Triple) -> Rotation:
    """Return R = Rz(yaw) Ry(pitch) Rx(roll)."""
    return Rotation.from_euler("ZYX", roll_pitch_yaw_deg[::-1], degrees=True)


def angles_from_transform(transform: RigidTransform) -> tuple[Triple, Triple]:
    """Return translation in metres and roll, pitch, yaw in degrees: the inverse of `transform_from_angles`.

    At a pitch of 90 degrees, where roll and yaw turn about the same axis, the roll is given as zero.
    """
    with warnings.catch_warnings():
        # SciPy warns at that pitch; the angles that it returns still give the same rotation.
        warnings.simplefilter("ignore", UserWarning)
        yaw, pitch, roll = transform.rotation.as_euler("ZYX", degrees=True)
    x, y, z = (float(value) for value in transform.translation)
    return (x, y, z), (_rounded(roll), _rounded(pitch), _rounded(yaw))


def degrees(angle: float) -> float:
    """Return an angle in degrees without the noise of the conversion in its last digits."""
    return _rounded(float(np.degrees(angle)))


def _rounded(angle_deg: float) -> float:
    return round(float(angle_deg), _DECIMALS_DEG) + 0.0
