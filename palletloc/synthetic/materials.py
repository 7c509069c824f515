"""Materials of warehouses, and the choices from which a scene draws."""

from __future__ import annotations

from palletloc.synthetic.scene import Material
from palletloc.synthetic.texture import Colour, Texture, TexturePattern, srgb

_CLOUD, _SPECKLE, _STREAK = TexturePattern.CLOUD, TexturePattern.SPECKLE, TexturePattern.STREAK
"""What textures are made of."""
_GRAINS = (Texture(_STREAK, 0.9, 0.10), Texture(_CLOUD, 0.6, 0.07), Texture(_SPECKLE, 0.5, 0.03))
"""Of wood."""
_MOULDED = (Texture(_CLOUD, 0.8, 0.04), Texture(_SPECKLE, 0.4, 0.02))
"""Of moulded plastic."""
_PAINTED = (Texture(_STREAK, 1.2, 0.02), Texture(_CLOUD, 1.0, 0.02))
"""Of painted steel."""
_PAPER = (Texture(_CLOUD, 0.9, 0.05), Texture(_STREAK, 0.5, 0.012), Texture(_SPECKLE, 0.4, 0.012))
"""Of cardboard."""

WOODS = tuple(
    Material(colour, _GRAINS)
    for colour in (srgb(176, 142, 104), srgb(152, 120, 88), srgb(196, 168, 128), srgb(128, 108, 90))
)
"""Wood of pallets: new, used, pale, weathered."""

PLASTICS = tuple(
    Material(colour, _MOULDED, gloss=0.5)
    for colour in (srgb(40, 78, 178), srgb(60, 62, 66), srgb(150, 152, 150), srgb(40, 120, 80), srgb(178, 60, 40))
)
"""Moulded plastic of pallets and bins: blue, black, grey, green, red."""

PAINTS = tuple(
    Material(colour, _PAINTED, gloss=0.4)
    for colour in (srgb(226, 106, 32), srgb(52, 74, 144), srgb(228, 186, 40), srgb(150, 152, 156), srgb(52, 110, 78))
)
"""Painted steel of racks: orange, blue, yellow, grey, green."""

CARTONS = tuple(
    Material(colour, _PAPER)
    for colour in (srgb(168, 132, 96), srgb(186, 152, 112), srgb(146, 112, 80), srgb(214, 206, 192))
)
"""Cardboard: brown ones and a white one."""

FILM = Material(srgb(206, 208, 206), (Texture(_STREAK, 0.7, 0.06), Texture(_CLOUD, 0.5, 0.05)), 0.8)
"""A load in stretch film."""

CONCRETES = tuple(
    Material(colour, (Texture(_CLOUD, 7.3, blotches), Texture(_SPECKLE, 1.1, grains), Texture(_CLOUD, 1.9, 0.03)))
    for colour, blotches, grains in (
        (srgb(152, 150, 144), 0.10, 0.05),
        (srgb(128, 130, 132), 0.05, 0.03),
        (srgb(168, 160, 148), 0.14, 0.07),
        (srgb(106, 116, 110), 0.04, 0.02),
    )
)
"""Floors."""

PLASTERS = tuple(
    Material(colour, (Texture(_CLOUD, 5.0, 0.03), Texture(_SPECKLE, 1.0, 0.015)))
    for colour in (srgb(172, 172, 166), srgb(202, 204, 206), srgb(140, 146, 150))
)
"""Walls."""

CEILING = Material(srgb(160, 160, 160), (Texture(_CLOUD, 4.0, 0.04),))
"""Ceiling."""

LABEL: Colour = srgb(232, 232, 228)
"""White paper."""
INK: Colour = srgb(40, 40, 42)
"""Print and holes."""
TAPE: Colour = srgb(178, 140, 92)
"""Brown tape."""
RUBBER: Colour = srgb(78, 78, 78)
"""Tyre marks."""
LINES: tuple[Colour, ...] = (srgb(232, 196, 40), srgb(228, 228, 224), srgb(60, 110, 170))
"""Floor lines."""
LAMP: Colour = (2.2, 2.3, 2.3)
"""Radiance of a lamp."""
