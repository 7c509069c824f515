"""The lens models that can be calibrated: parameters to pixels, with derivatives, and to cameras and back."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from calibration.least_squares import descend_damped, finite_cost
from palletloc.cameras import CameraModel, DoubleSphere, Eucm, KannalaBrandt, Mei, Pinhole, RationalPinhole
from palletloc.cameras.derivatives import (
    PlaneImage,
    double_sphere_image,
    eucm_image,
    kannala_brandt_image,
    mei_image,
    pinhole_image,
    rational_pinhole_image,
)
from palletloc.cameras.pinhole import PerspectiveLens
from palletloc.errors import PalletLocError, nearest_name
from palletloc.geometry import FloatArray

LensCamera = DoubleSphere | Eucm | KannalaBrandt | Mei | Pinhole | RationalPinhole
"""A camera of one lens with parameters."""
OPTICAL_FROM_CAMERA = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
"""Turns the camera frame (forward, left, up) into right, down, forward."""


_DAMPING, _MAX_STEPS, _SETTLED = 1e-3, 100, 1e-12
"""Of a match: its first damping; its steps, of which 10 are usual; the relative gain at which it ends."""
_FLOOR = 1e-12
"""Added to the diagonal of the normal equations: keeps unknowns of which nothing is told where they are."""


class UnknownLensError(PalletLocError):
    """A lens model that does not exist."""


@dataclass(frozen=True, slots=True, eq=False)
class Imaged:
    """Pixels of rays, with derivatives."""

    pixels: FloatArray
    """(n, 2); NaN where the model has no image."""
    by_ray: FloatArray
    """(n, 2, 3) by the ray in the camera frame."""
    by_values: FloatArray
    """(n, 2, k) by the parameters."""


class _Matched(NamedTuple):
    """Parameters, and the pixels that they give."""

    values: FloatArray
    imaged: Imaged


@dataclass(frozen=True, slots=True)
class LensModel:
    """One of the models."""

    name: str
    """As files have it."""
    shape: tuple[str, ...]
    """Names of the parameters after fx, fy, cx, cy, as the camera has them."""
    starts: tuple[tuple[float, ...], ...]
    """The shapes to begin with."""
    camera_type: type[LensCamera]
    """What it becomes."""
    image: Callable[[FloatArray, FloatArray], PlaneImage]
    """The image on the plane: of rays, by shape."""
    lower: tuple[float, ...]
    """Below this a shape describes no lens."""
    upper: tuple[float, ...]
    """Nor above this."""

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of all parameters."""
        return ("fx", "fy", "cx", "cy", *self.shape)

    @property
    def perspective(self) -> bool:
        """Whether it images less than a half sphere, and knows by itself how far it sees."""
        return issubclass(self.camera_type, PerspectiveLens)

    def start_values(self, focal: float, center: FloatArray) -> list[FloatArray]:
        """Return first parameters for each of the shapes; `focal` in pixels per radian, `center`, (2,), in pixels."""
        found = []
        for shape in self.starts:
            values = np.array([1.0, 1.0, 0.0, 0.0, *shape])
            along = focal / abs(float(self.evaluate(values, np.array([[1.0, 0.0, 0.0]])).by_ray[0, 0, 1]))
            found.append(np.array([along, along, *center, *shape]))
        return found

    def admits(self, values: FloatArray) -> bool:
        """Return whether parameters describe a lens at all."""
        shape = values[4:]
        inside = (shape >= np.array(self.lower)).all() and (shape <= np.array(self.upper)).all()
        return bool(np.isfinite(values).all() and (values[:2] > 0).all() and inside)

    def evaluate(self, values: FloatArray, rays: FloatArray) -> Imaged:
        """Return the pixels of rays, (n, 3) of any length in the lens's frame, with their derivatives."""
        with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
            plane = self.image(rays @ OPTICAL_FROM_CAMERA.T, values[4:])
        focal = values[:2]
        pixels = plane.points * focal + values[2:4]
        by_ray = focal[:, None] * (plane.by_ray @ OPTICAL_FROM_CAMERA)
        by_values = np.zeros((len(rays), 2, len(values)))
        by_values[:, 0, 0], by_values[:, 1, 1] = plane.points.T
        by_values[:, 0, 2] = by_values[:, 1, 3] = 1.0
        by_values[:, :, 4:] = focal[:, None] * plane.by_shape
        return Imaged(pixels, by_ray, by_values)

    def matched(self, start: FloatArray, rays: FloatArray, pixels: FloatArray) -> FloatArray:
        """Return the parameters whose pixels differ least from given ones, by damped least squares.

        Parameters
        ----------
        start : (k,) array
            Parameters to begin with.
        rays : (n, 3) array
            In the lens's camera frame.
        pixels : (n, 2) array
            Where they should appear.
        """

        def step(matched: _Matched) -> Callable[[float], _Matched | None]:
            derivatives = matched.imaged.by_values.reshape(-1, len(start))
            normal = derivatives.T @ derivatives
            gradient = derivatives.T @ (matched.imaged.pixels - pixels).ravel()

            def damped(damping: float) -> _Matched | None:
                whole = normal + damping * np.diag(np.diag(normal) + _FLOOR)
                values = matched.values - np.linalg.solve(whole, gradient)
                return _Matched(values, self.evaluate(values, rays)) if self.admits(values) else None

            return damped

        def cost(matched: _Matched) -> float:
            residuals = (matched.imaged.pixels - pixels).ravel()
            return finite_cost(residuals @ residuals)

        first = _Matched(start, self.evaluate(start, rays))
        return descend_damped(first, cost, step, _DAMPING, _MAX_STEPS, _SETTLED).values

    def values(self, camera: LensCamera) -> FloatArray:
        """Return the parameters of a camera of this model."""
        return np.array([getattr(camera, name) for name in self.parameters], dtype=np.float64)

    def camera(self, values: FloatArray, size: tuple[int, int], max_angle: float) -> LensCamera:
        """Return the camera with these parameters.

        Parameters
        ----------
        values : (k,) array
            The parameters.
        size : (int, int)
            Width and height of the image, in pixels.
        max_angle : float
            How far off axis it sees, in radians; a pinhole camera knows by itself.

        Raises
        ------
        ValueError
            If they describe no lens.
        """
        named: dict[str, Any] = dict(zip(self.parameters, values.tolist(), strict=True))
        if not self.perspective:
            named["max_angle"] = max_angle
        return self.camera_type(*size, **named)


_ANY = np.inf
"""No limit."""
MODELS = {
    model.name: model
    for model in (
        LensModel(
            "kannala_brandt", ("k1", "k2", "k3", "k4"), ((0.0,) * 4,), KannalaBrandt, kannala_brandt_image,
            (-_ANY,) * 4, (_ANY,) * 4,
        ),
        LensModel(
            "mei", ("xi", "k1", "k2", "p1", "p2"), ((1.0, 0.0, 0.0, 0.0, 0.0),), Mei, mei_image,
            (0.0, *(-_ANY,) * 4), (_ANY,) * 5,
        ),
        LensModel(
            "double_sphere", ("xi", "alpha"), ((-0.2, 0.55), (0.3, 0.65)), DoubleSphere, double_sphere_image,
            (-0.999, 0.0), (_ANY, 1.0),
        ),
        LensModel(
            "eucm", ("alpha", "beta"), ((0.55, 1.0),), Eucm, eucm_image,
            (0.0, 1e-6), (1.0, _ANY),
        ),
        LensModel(
            "pinhole", ("k1", "k2", "p1", "p2", "k3"), ((0.0,) * 5,), Pinhole, pinhole_image,
            (-_ANY,) * 5, (_ANY,) * 5,
        ),
        LensModel(
            "rational_pinhole", ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"), ((0.0,) * 8,), RationalPinhole,
            rational_pinhole_image, (-_ANY,) * 8, (_ANY,) * 8,
        ),
    )
}  # fmt: skip
"""The models by name."""


def lens_model(name: str) -> LensModel:
    """Return the model of this name.

    Raises
    ------
    UnknownLensError
        If there is none; the message names the nearest one.
    """
    if name not in MODELS:
        raise UnknownLensError(f"unknown lens model '{name}'{nearest_name(name, MODELS)}")
    return MODELS[name]


def model_of(camera: CameraModel) -> LensModel | None:
    """Return the model that a camera is of; None for a camera that is not a single lens."""
    return next((model for model in MODELS.values() if isinstance(camera, model.camera_type)), None)
