"""From light to the image that a camera writes: blur, exposure, noise, gamma, JPEG."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from palletloc.geometry import Image
from palletloc.synthetic.samples import Samples

_MIDDLE, _DARK = 0.18, 0.02
_STEPS = 1 << 14


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
