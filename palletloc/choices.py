"""What a user chooses, by name or within limits; light to import, so that a command can list its options at once."""

from __future__ import annotations

from enum import StrEnum

MAX_RANGE = 4.5
"""Farthest pallet that a method can be blamed for missing, in metres, where nothing else is asked."""
NEAREST_LIMIT = 0.01
"""How far a nearest sample of the truth may lie from a shot, in seconds: at 1 m/s the forklift moves 1 cm."""


class Method(StrEnum):
    """How a pose is measured from where a pallet may stand."""

    REFINED = "refined"
    """Hypotheses scored in the image, then all edges of the face to a fraction of a pixel."""
    HORIZONTAL_PLANE = "horizontal_plane"
    """Yaw from the horizontal plane by sub-pixel lines, position by the sweep and the face's edges."""
    PAPER = "paper"
    """As the paper states it: the Hough transform's angle, and the sweep without any height prior."""
    JOINT_SEARCH = "joint_search"
    """The paper's baseline: yaw and distance searched jointly in the vertical projection."""


class Side(StrEnum):
    """On which side of the forklift the shelf is."""

    LEFT = "left"
    """To the left of the direction of travel."""
    RIGHT = "right"
    """To the right."""

    @property
    def other(self) -> Side:
        """The side across the aisle."""
        return Side.RIGHT if self is Side.LEFT else Side.LEFT


class CameraKind(StrEnum):
    """A kind of camera."""

    EQUIRECTANGULAR = "equirectangular"
    """A stitched 360-degree image, twice as wide as high."""
    DUAL_FISHEYE = "dual_fisheye"
    """Two fisheye lenses, one to each side, twice as wide as high."""
    KANNALA_BRANDT = "kannala_brandt"
    """One fisheye lens, looking to the shelf and ahead."""
    PINHOLE = "pinhole"
    """A wide-angle lens, looking to the shelf and ahead."""


class Illumination(StrEnum):
    """How a scene is lit."""

    EVEN = "even"
    """Many lamps; hardly a shadow."""
    LAMPS = "lamps"
    """Rows of lamps with darker floor between them."""
    WINDOW = "window"
    """From one end, brighter there, with long shadows."""
    SPOT = "spot"
    """One strong lamp: hard shadows."""
    DIM = "dim"
    """A quarter of the light."""


class TimeRule(StrEnum):
    """How a value at a wanted time is taken from samples."""

    NEAREST = "nearest"
    """The sample nearest in time."""
    INTERPOLATED = "interpolated"
    """Between the samples before and after; never outside the first and last one."""
