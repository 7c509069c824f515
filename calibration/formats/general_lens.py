"""A lens as other programs describe it, and the camera of ours that images as it does, or nearly.

A projection takes the ray onto a plane one focal length ahead. Radial terms, decentring (Brown's tangential terms),
thin prism terms and a tilted sensor follow, and an affine map to pixels. That is OpenCV's order (module calib3d,
"Camera Calibration and 3D Reconstruction"); COLMAP (``src/colmap/sensor/models``) and Metashape (user manual, "Camera
models") have parts of it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from calibration.formats.camera_file import FiledCamera, alone, filed_lens
from calibration.formats.fields import Fields
from calibration.lenses.models import MODELS, OPTICAL_FROM_CAMERA
from palletloc.cameras import CameraModel
from palletloc.geometry import FloatArray

GOOD_PX = 0.5
"""Largest error of a camera that stands for another, in pixels: half a pixel at 3 m is some millimetres."""
_RINGS, _SPOKES = 120, (20, 92)
"""Angles off axis of the rays that cameras are compared at, and directions: to fit, and to compare."""
_WIDEST_DEG = {"perspective": 85.0, "division": 89.0, "fov": 89.0, "equidistant": 179.0, "equisolid": 179.0}
"""How far off axis a projection is asked to image, in degrees: short of where it ends."""
_FITTED = ("kannala_brandt", "mei", "rational_pinhole")
"""Models of ours that are tried for a lens that none of them is."""


@dataclass(frozen=True, slots=True)
class GeneralLens:
    """A lens by all terms that any of the programs has."""

    projection: str
    """``perspective``, ``equidistant``, ``equisolid``, ``fov`` (Devernay, Faugeras) or ``division`` (Fitzgibbon)."""
    width: int
    """Image width in pixels."""
    height: int
    """Image height in pixels."""
    lens: tuple[float, ...]
    """fx, fy, cx, cy, in pixels; the first pixel's centre at 0."""
    radial: tuple[float, ...] = ()
    """Of r^2, r^4, ..."""
    divisor: tuple[float, ...] = ()
    """Of r^2, r^4, ..., by whose polynomial the radial one is divided."""
    tangential: tuple[float, ...] = (0.0, 0.0)
    """p1, p2 in OpenCV's order: p2 goes with r^2 + 2 x^2."""
    prism: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0)
    """s1 r^2 + s2 r^4 along columns, s3 r^2 + s4 r^4 along rows."""
    tilt: tuple[float, ...] = (0.0, 0.0)
    """Of the sensor about its rows and columns, in radians."""
    skew: float = 0.0
    """Pixels along columns per unit of y."""
    shape: float = 0.0
    """omega of ``fov``, k of ``division``."""
    successive: bool = False
    """Whether the terms after the radial ones take the point that those have moved."""

    def on_plane(self, rays: FloatArray) -> FloatArray:
        """Return where rays, (..., 3) right, down, forward, meet the plane, (..., 2); NaN where they do not."""
        across = np.hypot(rays[..., 0], rays[..., 1])
        radius = _PROJECTIONS[self.projection](across, rays[..., 2], self.shape)
        scale = np.where(across > 0, radius / np.maximum(across, 1e-300), 0.0)
        point: FloatArray = rays[..., :2] * scale[..., None]
        return self._distorted(point)

    def _distorted(self, point: FloatArray) -> FloatArray:
        moved = point * self._factor((point**2).sum(-1))[..., None]
        base = moved if self.successive else point
        (x, y), squared = np.moveaxis(base, -1, 0), (base**2).sum(-1)
        p1, p2, (s1, s2, s3, s4) = *self.tangential, self.prism
        right = 2 * p1 * x * y + p2 * (squared + 2 * x * x) + squared * (s1 + s2 * squared)
        down = 2 * p2 * x * y + p1 * (squared + 2 * y * y) + squared * (s3 + s4 * squared)
        return self._tilted(moved + np.stack([right, down], axis=-1))

    def _factor(self, squared: FloatArray) -> FloatArray:
        above, below = (
            np.polynomial.polynomial.polyval(squared, (1.0, *terms)) for terms in (self.radial, self.divisor)
        )
        return np.asarray(above / below)

    def _tilted(self, point: FloatArray) -> FloatArray:
        if not any(self.tilt):
            return point
        about_x, about_y = (np.array([[np.cos(a), np.sin(a)], [-np.sin(a), np.cos(a)]]) for a in self.tilt)
        first, second = np.eye(3), np.eye(3)
        first[1:, 1:] = about_x
        second[::2, ::2] = about_y.T
        turned = second @ first
        straight = np.array([[turned[2, 2], 0, -turned[0, 2]], [0, turned[2, 2], -turned[1, 2]], [0, 0, 1]])
        ahead = np.concatenate([point, np.ones((*point.shape[:-1], 1))], axis=-1) @ (straight @ turned).T
        flat: FloatArray = ahead[..., :2] / ahead[..., 2:]
        return flat

    def pixels(self, rays: FloatArray) -> FloatArray:
        """Return the pixels of rays, (..., 3) right, down, forward."""
        fx, fy, cx, cy = self.lens
        x, y = np.moveaxis(self.on_plane(rays), -1, 0)
        return np.stack([fx * x + self.skew * y + cx, fy * y + cy], axis=-1)

    def exact(self) -> tuple[str, tuple[float, ...]] | None:
        """Return the model of ours that is this lens, and its numbers after fx, fy, cx, cy; None where none is."""
        if any(self.prism) or any(self.tilt) or self.skew or (self.successive and any(self.tangential)):
            return None
        radial, divisor = _shortest(self.radial), _shortest(self.divisor)
        if self.projection == "equidistant" and not divisor and not any(self.tangential) and len(radial) <= 4:
            return "kannala_brandt", (*radial, *(0.0,) * (4 - len(radial)))
        if self.projection != "perspective" or max(len(radial), len(divisor)) > 3:
            return None
        k1, k2, k3 = (*radial, *(0.0,) * (3 - len(radial)))
        brown = (k1, k2, *self.tangential, k3)
        return (
            ("rational_pinhole", (*brown, *divisor, *(0.0,) * (3 - len(divisor)))) if divisor else ("pinhole", brown)
        )


def _shortest(terms: tuple[float, ...]) -> tuple[float, ...]:
    """Return terms without the zeros at their end."""
    used = len(terms)
    while used and not terms[used - 1]:
        used -= 1
    return terms[:used]


def _perspective(across: FloatArray, forward: FloatArray, _: float) -> FloatArray:
    return np.where(forward > 0, across / np.where(forward > 0, forward, 1.0), np.nan)


def _equidistant(across: FloatArray, forward: FloatArray, _: float) -> FloatArray:
    return np.arctan2(across, forward)


def _equisolid(across: FloatArray, forward: FloatArray, _: float) -> FloatArray:
    return np.asarray(2 * np.sin(np.arctan2(across, forward) / 2))


def _fov(across: FloatArray, forward: FloatArray, omega: float) -> FloatArray:
    flat = _perspective(across, forward, 0.0)
    return flat if abs(omega) < 1e-6 else np.arctan(2 * flat * np.tan(omega / 2)) / omega


def _division(across: FloatArray, forward: FloatArray, k: float) -> FloatArray:
    inner = forward**2 - 4 * k * across**2
    below = forward + np.sqrt(np.where(inner >= 0, inner, np.nan))
    return np.where(below > 0, 2 * across / np.where(below > 0, below, 1.0), np.nan)


_PROJECTIONS: dict[str, Callable[[FloatArray, FloatArray, float], FloatArray]] = {
    "perspective": _perspective,
    "equidistant": _equidistant,
    "equisolid": _equisolid,
    "fov": _fov,
    "division": _division,
}
"""Radius on the plane, by the parts of a ray across the axis and along it, and the shape."""


def filed_general(fields: Fields, name: str, lens: GeneralLens) -> FiledCamera:
    """Return a lens as a camera of ours; its note says the error where it is not exactly that lens.

    Parameters
    ----------
    fields : Fields
        Where it stands, for errors.
    name : str
        Of the camera.
    lens : GeneralLens
        The lens.

    Raises
    ------
    FormatError
        If the numbers describe no lens, or none of our models comes nearer than `GOOD_PX`; names the nearest.
    """
    exact, size = lens.exact(), (lens.width, lens.height)
    if exact is not None:
        return alone(name, filed_lens(fields, exact[0], size, lens.lens, exact[1]))
    with np.errstate(all="ignore"):
        few, many = (_seen(lens, spokes) for spokes in _SPOKES)
        if len(few[0]) < _RINGS:
            raise fields.wrong("describes a lens that sees next to nothing")
        fits = [_fitted(lens, model, few, many) for model in _FITTED]
    found = [fit for fit in fits if fit is not None]
    error, model, camera = min(found, key=lambda fit: fit[0]) if found else (np.inf, _FITTED[0], None)
    if camera is None or not error <= GOOD_PX:
        raise fields.wrong(
            f"this lens has no form here: {model} comes nearest, {error:.2g} px off, where {GOOD_PX:g} px are"
            " allowed; expected another lens model from the program that wrote it"
        )
    note = f"has no form of its own here; read as {model}, {error:.2g} px off at most"
    return alone(name, camera, note)


def _seen(lens: GeneralLens, spokes: int) -> tuple[FloatArray, FloatArray]:
    """Return rays all over the image in the camera frame, (n, 3), and their pixels: as far out as pixels move out."""
    angle = np.radians(np.linspace(0.0, _WIDEST_DEG[lens.projection], _RINGS))[:, None]
    corners = [np.arctan2(y - lens.lens[3], x - lens.lens[2]) for x in (0, lens.width) for y in (0, lens.height)]
    turn = np.append(np.linspace(0.0, 2 * np.pi, spokes, endpoint=False), corners)
    parts = (np.sin(angle) * np.cos(turn), np.sin(angle) * np.sin(turn), np.cos(angle) + 0 * turn)
    rays = np.stack(parts, axis=-1)
    pixels = lens.pixels(rays)
    out = np.linalg.norm(pixels - pixels[0, 0], axis=-1)
    rises = np.cumprod(np.diff(out, axis=0, prepend=-1.0) > 0, axis=0) > 0
    inside = (pixels >= -0.5).all(-1) & (pixels <= (lens.width - 0.5, lens.height - 0.5)).all(-1)
    shown = inside & rises.all(-1, keepdims=True)
    return rays[shown] @ OPTICAL_FROM_CAMERA, pixels[shown]


def _fitted(
    lens: GeneralLens, name: str, few: tuple[FloatArray, FloatArray], many: tuple[FloatArray, FloatArray]
) -> tuple[float, str, CameraModel] | None:
    """Return the largest error of a model, its name, and its camera; None where it cannot image these rays.

    It is fitted to few rays and their pixels, and compared with many.
    """
    model, reach = MODELS[name], float(np.arccos(np.clip(many[0][:, 0].min(), -1.0, 1.0)))
    if model.perspective and reach > np.radians(_WIDEST_DEG["perspective"]):
        return None
    focal = float(np.sqrt(lens.lens[0] * lens.lens[1]))
    found: list[tuple[float, str, CameraModel]] = []
    for start in model.start_values(focal, np.array(lens.lens[2:])):
        try:
            values = model.matched(start, *few)
            camera = model.camera(values, (lens.width, lens.height), min(reach + 1e-3, np.pi))
        except (ValueError, np.linalg.LinAlgError):
            continue
        error = np.linalg.norm(model.evaluate(values, many[0]).pixels - many[1], axis=-1).max()
        found.append((float(error), name, camera))
    return min(found, key=lambda fit: fit[0], default=None)
