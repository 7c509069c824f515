"""The camera of a simulation: its kind, its mounting, and what its sensor makes of light."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from palletloc.cameras import CameraModel, DualFisheye, Equirectangular, FisheyeLens, KannalaBrandt, Pinhole
from palletloc.choices import CameraKind, Side
from palletloc.geometry import Image
from palletloc.synthetic.samples import Samples

_LENS_ANGLE = np.radians(97.0)
"""From a fisheye's axis to the rim of its image, in radians: two of them overlap."""
_LENS_COEFFICIENTS = (0.015, -0.009, 0.002, -0.0003)
"""Of the Kannala-Brandt model: a lens that is nearly equidistant."""
_LENS_OFFSET = 0.012
"""From the camera's middle to each of two fisheyes, in metres: half the thickness of a 360-degree camera."""
_MIDDLE, _DARK = 0.18, 0.02
"""Light of a middle grey, at which the noise is stated, and light whose shot noise equals that of reading."""
_STEPS = 1 << 14
"""Steps of light before the gamma curve: the darkest of them are less than a grey level."""


def camera_of(kind: CameraKind, width: int) -> CameraModel:
    """Return a camera of a kind by the width of its image, in pixels; the height follows."""
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
    """Return where a camera is on the forklift: height, place and small angles are drawn at random.

    One with a single lens is turned to the shelf and down.
    """
    translation = np.round(rng.uniform([-0.1, -0.1, 1.5], [0.4, 0.1, 2.1]), 4)
    angles_deg = np.round(rng.uniform(-1.5, 1.5, 3), 3)
    if kind in (CameraKind.KANNALA_BRANDT, CameraKind.PINHOLE):
        angles_deg += (55.0 if side is Side.LEFT else -55.0, 18.0, 0.0)
    return RigidTransform.from_components(translation, Rotation.from_euler("ZYX", angles_deg, degrees=True))


def disturbed(
    forklift_from_camera: RigidTransform, translation_sigma: float, rotation_sigma: float, rng: np.random.Generator
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


@dataclass(frozen=True, slots=True)
class Sensor:
    """What a camera does to the light."""

    blur_px: float = 0.6
    """Standard deviation of its blur, in pixels."""
    gain: float = 1.0
    """Exposure: by how much it brightens."""
    noise: float = 1.5
    """Standard deviation of the noise of a middle grey, in grey levels of 255."""
    falloff: float = 0.0
    """How much darker the lower edge of the image is than its upper one, 0 to 1."""
    jpeg_quality: int = 92
    """Of the compression, 1 to 100; 0 for none."""


def expose(radiance: Samples, sensor: Sensor, closed: bool, rng: np.random.Generator) -> Image:
    """Return the image of a sensor.

    Parameters
    ----------
    radiance : (height, width, 3) array
        Blue, green, red in linear light.
    sensor : Sensor
        The sensor.
    closed : bool
        Whether the image closes around, left to right.
    rng : numpy.random.Generator
        Draws the noise.
    """
    light = _blurred(radiance, sensor.blur_px, closed)
    rows = np.linspace(0.0, 1.0, len(light), dtype=np.float32)[:, None, None]
    light = light * (np.float32(sensor.gain) * (1 - np.float32(sensor.falloff) * rows))
    if sensor.noise > 0:
        spread = np.sqrt((light + np.float32(_DARK)) / np.float32(_MIDDLE + _DARK))
        spread *= np.float32(sensor.noise / (255 * _slope(_MIDDLE)))
        light += spread * rng.standard_normal(light.shape, np.float32)
    image = _gamma().take((np.clip(light, 0, 1) * np.float32(_STEPS - 1) + np.float32(0.5)).astype(np.uint16))
    if sensor.jpeg_quality > 0:
        _, code = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, sensor.jpeg_quality])
        image = np.asarray(cv2.imdecode(code, cv2.IMREAD_COLOR), np.uint8)
    return image


def _blurred(radiance: Samples, sigma: float, closed: bool) -> Samples:
    if sigma <= 0:
        return radiance
    reach = int(np.ceil(4 * sigma))
    border = cv2.BORDER_WRAP if closed else cv2.BORDER_REPLICATE
    padded = cv2.copyMakeBorder(radiance, 0, 0, reach, reach, border)
    blurred = cv2.GaussianBlur(padded, (0, 0), sigma, borderType=cv2.BORDER_REPLICATE)
    return np.asarray(blurred[:, reach:-reach], np.float32)


def _slope(light: float) -> float:
    """Return by how much the coded value, 0 to 1, changes with the light."""
    return float(1.055 / 2.4 * light ** (1 / 2.4 - 1))


def _gamma() -> Image:
    """Return the coded grey level of each step of light, as sRGB has it."""
    light = np.arange(_STEPS) / (_STEPS - 1)
    coded = np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)
    return np.round(255 * coded).astype(np.uint8)
