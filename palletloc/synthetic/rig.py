"""Cameras as they come, and how they are mounted."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from palletloc.cameras import CameraModel, DualFisheye, Equirectangular, FisheyeLens, KannalaBrandt, Pinhole
from palletloc.choices import CameraKind, Side

_LENS_ANGLE = np.radians(97.0)
_LENS_COEFFICIENTS = (0.015, -0.009, 0.002, -0.0003)
_LENS_OFFSET = 0.012


def camera_of(kind: CameraKind, width: int) -> CameraModel:
    """Return a camera of a kind.

    Parameters
    ----------
    kind : CameraKind
        The kind.
    width : int
        Of the image, in pixels; the height follows.
    """
    if kind is CameraKind.EQUIRECTANGULAR:
        return Equirectangular(width, width // 2)
    if kind is CameraKind.DUAL_FISHEYE:
        height = width // 2
        return DualFisheye(
            _side_lens(width, height, 0.25 * width + 1.3, np.pi / 2),
            _side_lens(width, height, 0.75 * width - 2.1, -np.pi / 2),
        )
    height = 3 * width // 4
    if kind is CameraKind.KANNALA_BRANDT:
        return _lens(width, height, (width - 1) / 2, 0.49 * width)
    focal = 0.55 * width
    return Pinhole(width, height, focal, 1.002 * focal, 0.498 * width, 0.503 * height, -0.03, 0.004)


def _lens(width: int, height: int, cx: float, radius: float) -> KannalaBrandt:
    """Return a fisheye lens whose image circle has some radius."""
    focal = radius / _LENS_ANGLE
    return KannalaBrandt(
        width, height, focal, focal, cx, height / 2 - 0.8, *_LENS_COEFFICIENTS, max_angle=float(_LENS_ANGLE)
    )


def _side_lens(width: int, height: int, cx: float, yaw: float) -> FisheyeLens:
    turn = Rotation.from_euler("z", yaw)
    return FisheyeLens(
        _lens(width, height, cx, 0.485 * height),
        RigidTransform.from_components([0.0, float(np.copysign(_LENS_OFFSET, yaw)), 0.0], turn),
    )


def draw_mounting(kind: CameraKind, side: Side, rng: np.random.Generator) -> RigidTransform:
    """Return where a camera is on the forklift.

    Parameters
    ----------
    kind : CameraKind
        One with a single lens is turned to the shelf and down.
    side : Side
        Of the shelf.
    rng : numpy.random.Generator
        Draws height, place and small angles.
    """
    translation = np.round(rng.uniform([-0.1, -0.1, 1.5], [0.4, 0.1, 2.1]), 4)
    angles_deg = np.round(rng.uniform(-1.5, 1.5, 3), 3)
    if kind in (CameraKind.KANNALA_BRANDT, CameraKind.PINHOLE):
        angles_deg += (55.0 if side is Side.LEFT else -55.0, 18.0, 0.0)
    return RigidTransform.from_components(translation, Rotation.from_euler("ZYX", angles_deg, degrees=True))


def disturbed(
    forklift_from_camera: RigidTransform,
    translation_sigma: float,
    rotation_sigma: float,
    rng: np.random.Generator,
) -> RigidTransform:
    """Return a mounting with errors, as a calibration gives it.

    Parameters
    ----------
    forklift_from_camera : RigidTransform
        The true one.
    translation_sigma : float
        Standard deviation along each axis, in metres.
    rotation_sigma : float
        Standard deviation about each of the forklift's axes, in radians.
    rng : numpy.random.Generator
        Draws the errors.
    """
    turn = Rotation.from_rotvec(rotation_sigma * rng.standard_normal(3))
    translation = forklift_from_camera.translation + translation_sigma * rng.standard_normal(3)
    return RigidTransform.from_components(translation, turn * forklift_from_camera.rotation)
