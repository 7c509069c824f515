"""Kinds of light."""

from __future__ import annotations

import numpy as np

from palletloc.choices import Illumination
from palletloc.geometry import FloatArray
from palletloc.synthetic.scene import Light

_SKY, _KEY = 18, 5


_KEY_SHARE = {
    Illumination.EVEN: 0.15,
    Illumination.LAMPS: 0.35,
    Illumination.WINDOW: 0.55,
    Illumination.SPOT: 0.65,
    Illumination.DIM: 0.3,
}


def light_of(kind: Illumination, rng: np.random.Generator) -> Light:
    """Return a light of some kind.

    Parameters
    ----------
    kind : Illumination
        The kind.
    rng : numpy.random.Generator
        Draws directions, tint and strength.
    """
    share = _KEY_SHARE[kind]
    low = kind is Illumination.WINDOW
    elevation = np.radians(rng.uniform(22, 40) if low else rng.uniform(50, 80))
    heading = rng.uniform(-np.pi, np.pi)
    spread = np.radians(1.5 if kind is Illumination.SPOT else 4.0)
    key = _directions(elevation + spread * rng.standard_normal(_KEY), heading + spread * rng.standard_normal(_KEY))
    sky = _sky(rng)
    # level ground in full light has irradiance 1, of which the key lamp gives its share
    key_weight = share / key[:, 2].sum()
    sky_weight = (1 - share) / sky[:, 2].sum()
    strength = float(rng.uniform(0.8, 1.15)) * (0.25 if kind is Illumination.DIM else 1.0)
    warm = float(rng.uniform(-0.12, 0.12))
    return Light(
        tuple((float(x), float(y), float(z)) for x, y, z in np.concatenate([key, sky])),
        tuple([float(key_weight)] * _KEY + [float(sky_weight)] * _SKY),
        sharp=_KEY,
        bounce=float(rng.uniform(0.3, 0.45)),
        colour=(strength * (1 - warm), strength, strength * (1 + warm)),
        pools=float(rng.uniform(0.3, 0.7)) if kind is Illumination.LAMPS else 0.0,
        pool_spacing=float(rng.uniform(3.0, 6.0)),
        slope=float(rng.choice([-1, 1]) * rng.uniform(0.06, 0.12)) if low else 0.0,
    )


def _directions(elevations: FloatArray, headings: FloatArray) -> FloatArray:
    level = np.cos(elevations)
    return np.stack([level * np.cos(headings), level * np.sin(headings), np.sin(elevations)], -1)


def _sky(rng: np.random.Generator) -> FloatArray:
    """Return directions spread over the upper half, down to what white walls send back."""
    turn = np.pi * (3 - np.sqrt(5))
    heights = (np.arange(_SKY) + 0.5) / _SKY * 0.9 + 0.06
    return _directions(np.arcsin(heights), turn * np.arange(_SKY) + rng.uniform(0, 2 * np.pi))
