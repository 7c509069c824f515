"""Between the yaml form of cameras and mountings, and the values that compute."""

from __future__ import annotations

import warnings
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
from palletloc.cameras.pinhole import Pinhole
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
        case PinholeSpec():
            return Pinhole(*_whole(spec), *spec.distortion)
        case KannalaBrandtSpec():
            return _fisheye(spec, spec.width, spec.height)
        case MeiSpec():
            return Mei(*_whole(spec), spec.xi, *spec.distortion, max_angle=_radians(spec.max_angle_deg))
        case DoubleSphereSpec():
            return DoubleSphere(*_whole(spec), spec.xi, spec.alpha, max_angle=_radians(spec.max_angle_deg))
        case EucmSpec():
            return Eucm(*_whole(spec), spec.alpha, spec.beta, max_angle=_radians(spec.max_angle_deg))
        case DualFisheyeSpec():
            front, back = (
                FisheyeLens(
                    _fisheye(lens, spec.width, spec.height),
                    transform_from_angles(lens.translation_m, lens.roll_pitch_yaw_deg),
                )
                for lens in spec.lenses
            )
            return DualFisheye(front, back)
        case StitchedSpec():
            return StitchedEquirectangular(spec.width, spec.height, *(_stitched_lens(lens) for lens in spec.lenses))


def _stitched_lens(spec: StitchedLensSpec) -> StitchedLens:
    return StitchedLens(transform_from_angles(spec.translation_m, spec.roll_pitch_yaw_deg), *spec.bend)


def _whole(
    spec: PinholeSpec | MeiSpec | DoubleSphereSpec | EucmSpec,
) -> tuple[int, int, float, float, float, float]:
    """Return what all lenses begin with: the image's size, focal lengths and centre."""
    return spec.width, spec.height, *spec.focal_px, *spec.center_px


def _radians(angle_deg: float) -> float:
    return float(np.radians(angle_deg))


def _fisheye(spec: KannalaBrandtSpec | LensSpec, width: int, height: int) -> KannalaBrandt:
    return KannalaBrandt(
        width,
        height,
        *spec.focal_px,
        *spec.center_px,
        *spec.distortion,
        max_angle=_radians(spec.max_angle_deg),
    )


def spec_from_camera(camera: CameraModel) -> CameraSpec:
    """Describe a camera as files do: the inverse of `camera_from_spec`.

    Raises
    ------
    ValueError
        If it is of a kind that files do not know.
    """
    match camera:
        case Equirectangular():
            return EquirectangularSpec(model="equirectangular", width=camera.width, height=camera.height)
        case Mei() | DoubleSphere() | Eucm():
            return _unified_spec(camera)
        case Pinhole():
            return PinholeSpec(
                model="pinhole",
                width=camera.width,
                height=camera.height,
                focal_px=(camera.fx, camera.fy),
                center_px=(camera.cx, camera.cy),
                distortion=(camera.k1, camera.k2, camera.p1, camera.p2, camera.k3),
            )
        case KannalaBrandt():
            return KannalaBrandtSpec(
                model="kannala_brandt",
                width=camera.width,
                height=camera.height,
                focal_px=(camera.fx, camera.fy),
                center_px=(camera.cx, camera.cy),
                distortion=(camera.k1, camera.k2, camera.k3, camera.k4),
                max_angle_deg=degrees(camera.max_angle),
            )
        case DualFisheye():
            return DualFisheyeSpec(
                model="dual_fisheye",
                width=camera.width,
                height=camera.height,
                lenses=(_lens_spec(camera.front), _lens_spec(camera.back)),
            )
        case StitchedEquirectangular():
            return StitchedSpec(
                model="stitched_equirectangular",
                width=camera.width,
                height=camera.height,
                lenses=(_stitched_lens_spec(camera.front), _stitched_lens_spec(camera.back)),
            )
    raise ValueError(f"a camera of the kind {type(camera).__name__} has no form in files")


def _unified_spec(camera: Mei | DoubleSphere | Eucm) -> CameraSpec:
    size = {"width": camera.width, "height": camera.height}
    lens = {"focal_px": (camera.fx, camera.fy), "center_px": (camera.cx, camera.cy)}
    angle = degrees(camera.max_angle)
    match camera:
        case Mei():
            terms = (camera.k1, camera.k2, camera.p1, camera.p2)
            return MeiSpec(model="mei", **size, **lens, xi=camera.xi, distortion=terms, max_angle_deg=angle)
        case DoubleSphere():
            return DoubleSphereSpec(
                model="double_sphere", **size, **lens, xi=camera.xi, alpha=camera.alpha, max_angle_deg=angle
            )
        case Eucm():
            return EucmSpec(model="eucm", **size, **lens, alpha=camera.alpha, beta=camera.beta, max_angle_deg=angle)


def _lens_spec(lens: FisheyeLens) -> LensSpec:
    model = lens.model
    translation, angles = angles_from_transform(lens.camera_from_lens)
    return LensSpec(
        focal_px=(model.fx, model.fy),
        center_px=(model.cx, model.cy),
        distortion=(model.k1, model.k2, model.k3, model.k4),
        max_angle_deg=degrees(model.max_angle),
        translation_m=translation,
        roll_pitch_yaw_deg=angles,
    )


def _stitched_lens_spec(lens: StitchedLens) -> StitchedLensSpec:
    translation, angles = angles_from_transform(lens.camera_from_lens)
    return StitchedLensSpec(translation_m=translation, roll_pitch_yaw_deg=angles, bend=(lens.k1, lens.k2))


def transform_from_angles(translation_m: Triple, roll_pitch_yaw_deg: Triple) -> RigidTransform:
    """Return the transform with this translation and R = Rz(yaw) Ry(pitch) Rx(roll).

    Examples
    --------
    >>> camera_up = transform_from_angles((0.0, 0.0, 1.8), (0.0, -90.0, 0.0))
    >>> camera_up.apply([1.0, 0.0, 0.0]).round(6)
    array([0. , 0. , 2.8])
    """
    rotation = Rotation.from_euler("ZYX", roll_pitch_yaw_deg[::-1], degrees=True)
    return RigidTransform.from_components(translation_m, rotation)


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
