"""A camera in another lens model: the parameters that image the same rays at the same pixels, and what is left."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calibration.lenses.models import LensCamera, LensModel
from palletloc.cameras import CameraModel
from palletloc.errors import PalletLocError
from palletloc.geometry import FloatArray

_GRID = 60
"""Rays per side that cameras are compared at; also the fewest that must be seen: 3600 settle 9 parameters."""
_PERSPECTIVE = float(np.radians(80.0))
"""How far off axis a pinhole is asked to image, in radians: beyond, its image grows without bound."""
_STEP = 1e-4
"""Of the differences that tell the focal length on the axis, as a part of the distance."""


class ConversionError(PalletLocError):
    """A camera that has no form in a model."""


@dataclass(frozen=True, slots=True)
class LensDifference:
    """How two cameras differ over the field that was compared."""

    rms: float
    """Root mean square distance of pixels."""
    largest: float
    """Largest distance of pixels."""
    max_angle: float
    """Largest angle off axis that was compared, in radians."""
    unseen: float
    """Share of the field that the second one does not see."""


def _field_rays(camera: CameraModel, max_angle: float) -> tuple[FloatArray, FloatArray]:
    """Return rays all over a camera's field, (n, 3), and their pixels, (n, 2).

    Raises
    ------
    ConversionError
        If it sees next to nothing there.
    """
    u, v = np.meshgrid(np.linspace(0, camera.width - 1, _GRID), np.linspace(0, camera.height - 1, _GRID))
    pixels = np.stack([u.ravel(), v.ravel()], axis=-1)
    rays, _, valid = camera.unproject(pixels)
    valid &= rays[:, 0] >= np.cos(max_angle)
    if valid.sum() < _GRID:
        raise ConversionError(f"the camera sees next to nothing within {np.degrees(max_angle):.0f} degrees off axis")
    return rays[valid], pixels[valid]


def convert_lens(camera: CameraModel, model: LensModel, max_angle: float = np.pi) -> LensCamera:
    """Return the camera of a model that differs least, by pixels, from a given one.

    Parameters
    ----------
    camera : CameraModel
        With one centre.
    model : LensModel
        What it is to become; a pinhole takes 80 degrees of the field at most.
    max_angle : float
        Largest angle off axis that counts, in radians.

    Raises
    ------
    ConversionError
        If the model cannot image that field.
    """
    if isinstance(camera, model.camera_type):
        return model.camera(model.values(camera), (camera.width, camera.height), _own_angle(camera, max_angle))
    if model.perspective:
        max_angle = min(max_angle, _PERSPECTIVE)
    rays, pixels = _field_rays(camera, max_angle)
    reach = float(np.arccos(np.clip(rays[:, 0].min(), -1, 1)))
    center, focal = _axis(camera)
    candidates = []
    for start in model.start_values(focal, center):
        values = model.matched(start, rays, pixels)
        try:
            candidates.append(model.camera(values, (camera.width, camera.height), reach + 1e-9))
        except ValueError:
            continue
    found = [(difference(camera, candidate, max_angle), candidate) for candidate in candidates]
    seen = [(left.rms, candidate) for left, candidate in found if left.unseen < 0.5]
    if not seen:
        raise ConversionError(
            f"{model.name} cannot image {np.degrees(reach):.0f} degrees off axis as this camera does;"
            " expected a smaller field (--max-angle-deg) or another model"
        )
    return min(seen, key=lambda found: found[0])[1]


def _own_angle(camera: CameraModel, max_angle: float) -> float:
    own = getattr(camera, "max_angle", np.pi)
    return float(min(own, max_angle))


def _axis(camera: CameraModel) -> tuple[FloatArray, float]:
    """Return the pixel of the axis and the pixels per radian there."""
    around = np.array([[1.0, 0.0, 0.0], [1.0, _STEP, 0.0], [1.0, -_STEP, 0.0], [1.0, 0.0, _STEP], [1.0, 0.0, -_STEP]])
    pixels, valid = camera.project(around)
    if not valid.all():
        raise ConversionError("the camera does not see along its own axis")
    lengths = np.linalg.norm(pixels[[1, 3]] - pixels[[2, 4]], axis=-1)
    return pixels[0], float(lengths.mean() / (2 * _STEP))


def difference(first: CameraModel, second: CameraModel, max_angle: float = np.pi) -> LensDifference:
    """Return how a second camera differs from the first one over its field.

    Parameters
    ----------
    first, second : CameraModel
        With one centre and images of one size.
    max_angle : float
        Largest angle off axis that counts, in radians.
    """
    rays, pixels = _field_rays(first, max_angle)
    shown, valid = second.project(rays)
    # A pixel at the border may fall off the other's image.
    inner = (pixels > 1).all(-1) & (pixels < (first.width - 2, first.height - 2)).all(-1)
    off = np.linalg.norm(shown - pixels, axis=-1)[valid]
    reach = float(np.arccos(np.clip(rays[:, 0].min(), -1, 1)))
    if not off.size:
        return LensDifference(np.inf, np.inf, reach, 1.0)
    return LensDifference(
        float(np.sqrt((off**2).mean())), float(off.max()), reach, float((~valid & inner).sum() / inner.sum())
    )
