"""Surface textures: periodic noise made from a seed, sampled without aliasing."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from functools import lru_cache

import numpy as np

from palletloc.synthetic.samples import Samples, lookup

Colour = tuple[float, float, float]
"""Reflectance in linear light, 0 to 1: blue, green, red."""

_TILE, _LEVELS = 512, 7
"""Side of a noise image in pixels, and how often it is halved: to 8 pixels, beyond which little is left."""


class TexturePattern(StrEnum):
    """What a texture looks like."""

    CLOUD = "cloud"
    """Soft blotches of all sizes."""
    SPECKLE = "speckle"
    """Fine grains of about one size."""
    STREAK = "streak"
    """Long thin lines, as in wood or scratched paint."""


_ASPECT_AND_SLOPE = {
    TexturePattern.CLOUD: (1.0, 1.6),
    TexturePattern.SPECKLE: (1.0, 0.0),
    TexturePattern.STREAK: (14.0, 0.9),
}
"""How much longer than wide its features are, and the exponent of frequency with which its amplitude falls."""


@dataclass(frozen=True, slots=True)
class Texture:
    """One layer of brightness changes on a surface."""

    pattern: TexturePattern
    """What it looks like."""
    period: float
    """After how many metres it repeats."""
    amplitude: float
    """Standard deviation of the relative brightness."""


def srgb(red: int, green: int, blue: int) -> Colour:
    """Convert a colour as screens show it, 0 to 255, to a reflectance in linear light.

    Examples
    --------
    >>> srgb(255, 0, 0)
    (0.0, 0.0, 1.0)
    """
    b, g, r = (
        round(((value / 255 + 0.055) / 1.055) ** 2.4, 4) if value > 10 else value / 3294.6
        for value in (blue, green, red)
    )
    return b, g, r


@lru_cache(maxsize=24)
def noise_levels(pattern: TexturePattern, seed: int) -> tuple[Samples, ...]:
    """Return a periodic noise image at full size and halved again and again.

    Parameters
    ----------
    pattern : TexturePattern
        Its spectrum.
    seed : int
        Equal seeds give equal noise.

    Returns
    -------
    tuple of (n + 1, n + 1) array
        Zero mean and unit variance at full size; the last row and column repeat the first.
    """
    aspect, slope = _ASPECT_AND_SLOPE[pattern]
    rows = np.fft.fftfreq(_TILE)[:, None] * _TILE
    columns = np.fft.rfftfreq(_TILE)[None, :] * _TILE
    frequency = np.hypot(rows, columns * aspect)
    frequency[0, 0] = np.inf
    white = np.fft.rfft2(np.random.default_rng(seed).standard_normal((_TILE, _TILE)))
    image = np.fft.irfft2(white * np.minimum(frequency, 1e9) ** -slope * (frequency < 1e9))
    level = (image / image.std()).astype(np.float32)
    levels = []
    for _ in range(_LEVELS):
        levels.append(np.pad(level, ((0, 1), (0, 1)), mode="wrap"))
        level = (level[::2, ::2] + level[1::2, ::2] + level[::2, 1::2] + level[1::2, 1::2]) / 4
    return tuple(levels)


def sample(texture: Texture, seed: int, u: Samples, v: Samples, footprint: Samples) -> Samples:
    """Return the relative brightness change of a texture at points of a surface.

    Parameters
    ----------
    texture : Texture
        The layer.
    seed : int
        Which of its noises.
    u, v : (N,) array
        Where, in metres; streaks run along ``u``.
    footprint : (N,) array
        Size of what one ray stands for, in metres; finer detail is averaged away.

    Returns
    -------
    (N,) array
        Zero on average.
    """
    levels = noise_levels(texture.pattern, seed)
    texels = np.maximum(footprint * np.float32(_TILE / texture.period), 1.0)
    level = np.minimum(np.log2(texels).astype(np.int8), _LEVELS)
    value = np.zeros(len(u), np.float32)
    for index in range(_LEVELS):
        chosen = np.flatnonzero(level == index)
        if len(chosen):
            size = _TILE >> index
            value[chosen] = lookup(
                levels[index],
                _fraction(u[chosen] / np.float32(texture.period)) * size,
                _fraction(v[chosen] / np.float32(texture.period)) * size,
            )
    value *= np.float32(texture.amplitude)
    return value


def _fraction(values: Samples) -> Samples:
    fraction: Samples = values - np.floor(values)
    return fraction
