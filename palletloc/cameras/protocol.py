"""What every camera model can do."""

from __future__ import annotations

from typing import NamedTuple, Protocol

from palletloc.geometry import BoolArray, FloatArray


class Projection(NamedTuple):
    """Where points appear in the image."""

    pixels: FloatArray
    """(..., 2) columns and rows, pixel centres at integers; NaN where not valid."""
    valid: BoolArray
    """(...); False where the camera does not see the point."""


class Rays(NamedTuple):
    """What pixels look along."""

    directions: FloatArray
    """(..., 3) unit vectors in the camera frame; NaN where not valid."""
    origins: FloatArray
    """(..., 3) where each ray starts: zero for a camera with one centre, else the centre of its lens, in metres."""
    valid: BoolArray
    """(...); False where the image shows nothing."""


class CameraModel(Protocol):
    """A calibrated camera in the frame x forward (image centre), y left, z up.

    All arrays are float64 and may have any leading shape.
    """

    @property
    def width(self) -> int:
        """Image width in pixels."""

    @property
    def height(self) -> int:
        """Image height in pixels."""

    @property
    def period_px(self) -> float | None:
        """After how many columns the image repeats; None where it does not close around."""

    def project(self, points_camera: FloatArray) -> Projection:
        """Project points to pixels.

        Parameters
        ----------
        points_camera : (..., 3) array
            Points in the camera frame, in metres.
        """

    def unproject(self, pixels: FloatArray) -> Rays:
        """Return the rays that pixels look along: the inverse of `project` up to the distance.

        Parameters
        ----------
        pixels : (..., 2) array
            Columns and rows, pixel centres at integers.
        """

    def centers(self, points_camera: FloatArray) -> FloatArray:
        """Return the optical centres that see the points, (..., 3) in the camera frame, in metres."""
