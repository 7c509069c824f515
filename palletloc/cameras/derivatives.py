"""The lens models' images on the plane one focal length ahead, with their derivatives by the ray and the lens.

Rays are given against the optical axis: right, down, forward. Their length does not matter. The values are those of
the cameras of the same name; a shape is the camera's parameters after fx, fy, cx and cy. Sources stand there.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from palletloc.cameras.lens import unified_depth
from palletloc.geometry import FloatArray

_AXIS = np.array([0.0, 0.0, 1.0])
"""The optical axis."""
_TINY = 1e-9
"""A part across the axis, or a depth, that counts as none: of a ray of unit length, so that 1 / it stays finite."""


@dataclass(frozen=True, slots=True, eq=False)
class PlaneImage:
    """Where rays meet the plane, and how that changes."""

    points: FloatArray
    """(n, 2); NaN where the model has no image."""
    by_ray: FloatArray
    """(n, 2, 3) derivatives by the ray."""
    by_shape: FloatArray
    """(n, 2, s) derivatives by the shape parameters."""


def pinhole_image(rays: FloatArray, shape: FloatArray) -> PlaneImage:
    """Return the image in a `Pinhole` camera.

    Parameters
    ----------
    rays : (n, 3) array
        Right, down, forward, of any length.
    shape : (5,) array
        k1, k2, p1, p2, k3.
    """
    return _distorted(_divided(rays, _perspective_depth(rays, shape[:0])), shape)


def rational_pinhole_image(rays: FloatArray, shape: FloatArray) -> PlaneImage:
    """Return the image in a `RationalPinhole` camera.

    Parameters
    ----------
    rays : (n, 3) array
        Right, down, forward, of any length.
    shape : (8,) array
        k1, k2, p1, p2, k3, k4, k5, k6.
    """
    return _distorted(_divided(rays, _perspective_depth(rays, shape[:0])), shape)


def mei_image(rays: FloatArray, shape: FloatArray) -> PlaneImage:
    """Return the image in a camera of `Mei`.

    Parameters
    ----------
    rays : (n, 3) array
        Right, down, forward, of any length.
    shape : (5,) array
        xi, k1, k2, p1, p2.
    """
    return _distorted(_divided(rays, _mei_depth(rays, shape[:1])), shape[1:])


def eucm_image(rays: FloatArray, shape: FloatArray) -> PlaneImage:
    """Return the image in an `Eucm` camera.

    Parameters
    ----------
    rays : (n, 3) array
        Right, down, forward, of any length.
    shape : (2,) array
        alpha, beta.
    """
    return _divided(rays, _eucm_depth(rays, shape))


def double_sphere_image(rays: FloatArray, shape: FloatArray) -> PlaneImage:
    """Return the image in a `DoubleSphere` camera.

    Parameters
    ----------
    rays : (n, 3) array
        Right, down, forward, of any length.
    shape : (2,) array
        xi, alpha.
    """
    return _divided(rays, _double_sphere_depth(rays, shape))


def kannala_brandt_image(rays: FloatArray, shape: FloatArray) -> PlaneImage:
    """Return the image in a `KannalaBrandt` lens.

    Parameters
    ----------
    rays : (n, 3) array
        Right, down, forward, of any length.
    shape : (4,) array
        k1, k2, k3, k4.
    """
    across = np.hypot(rays[:, 0], rays[:, 1])
    forward = rays[:, 2]
    safe = np.maximum(across, _TINY)
    squared = across**2 + forward**2
    angle = np.arctan2(across, forward)
    powers = angle[:, None] ** np.array([3, 5, 7, 9])
    radius = angle + powers @ shape
    slope = 1 + (angle[:, None] ** np.array([2, 4, 6, 8]) * [3, 5, 7, 9]) @ shape
    near = across > _TINY
    scale = np.where(near, radius / safe, 1 / forward)
    by_across = np.where(near, (slope * forward / squared - scale) / safe, 0.0)
    by_forward = np.where(near, -slope * across / squared / safe, -1 / forward**2)
    unit = rays[:, :2] / safe[:, None]
    by_ray = np.zeros((len(rays), 2, 3))
    by_ray[:, :, :2] = scale[:, None, None] * np.eye(2)
    by_ray[:, :, :2] += by_across[:, None, None] * rays[:, :2, None] * unit[:, None]
    by_ray[:, :, 2] = by_forward[:, None] * rays[:, :2]
    return PlaneImage(scale[:, None] * rays[:, :2], by_ray, unit[:, :, None] * powers[:, None])


@dataclass(frozen=True, slots=True, eq=False)
class _Depth:
    """What the part of a ray across the axis is divided by."""

    value: FloatArray
    """(n,)."""
    by_ray: FloatArray
    """(n, 3)."""
    by_shape: FloatArray
    """(n, s)."""


def _perspective_depth(rays: FloatArray, shape: FloatArray) -> _Depth:
    """Return the depth of a perspective image; it has no shape parameter."""
    return _Depth(rays[:, 2], np.broadcast_to(_AXIS, rays.shape), np.zeros((len(rays), len(shape))))


def _mei_depth(rays: FloatArray, shape: FloatArray) -> _Depth:
    """Return the depth in Mei's model, with the shape xi."""
    distance = np.linalg.norm(rays, axis=-1)
    value = rays[:, 2] + shape[0] * distance
    return _Depth(value, _AXIS + shape[0] * rays / distance[:, None], distance[:, None])


def _eucm_depth(rays: FloatArray, shape: FloatArray) -> _Depth:
    """Return the depth in the enhanced unified model, with the shape alpha, beta."""
    alpha, beta = shape
    across = rays[:, 0] ** 2 + rays[:, 1] ** 2
    length = np.sqrt(beta * across + rays[:, 2] ** 2)
    value = unified_depth(alpha, length, rays[:, 2])
    by_ray = alpha * rays * np.array([beta, beta, 1.0]) / length[:, None] + (1 - alpha) * _AXIS
    by_shape = np.stack([length - rays[:, 2], alpha * across / (2 * length)], axis=-1)
    return _Depth(value, by_ray, by_shape)


def _double_sphere_depth(rays: FloatArray, shape: FloatArray) -> _Depth:
    """Return the depth in the double sphere model, with the shape xi, alpha."""
    xi, alpha = shape
    distance = np.linalg.norm(rays, axis=-1)
    second = rays + np.outer(xi * distance, _AXIS)
    length = np.linalg.norm(second, axis=-1)
    forward = second[:, 2]
    forward_by_ray = xi * rays / distance[:, None] + _AXIS
    by_ray = alpha * (rays * [1.0, 1.0, 0.0] + forward[:, None] * forward_by_ray) / length[:, None]
    by_ray += (1 - alpha) * forward_by_ray
    by_xi = distance * (alpha * forward / length + 1 - alpha)
    value = unified_depth(alpha, length, forward)
    return _Depth(value, by_ray, np.stack([by_xi, length - forward], axis=-1))


def _divided(rays: FloatArray, depth: _Depth) -> PlaneImage:
    """Return the image of rays whose part across the axis is divided by a depth."""
    value = np.where(depth.value > _TINY * np.linalg.norm(rays, axis=-1), depth.value, np.nan)
    points = rays[:, :2] / value[:, None]
    by_ray = (np.eye(2, 3) - points[:, :, None] * depth.by_ray[:, None]) / value[:, None, None]
    by_shape = -points[:, :, None] * depth.by_shape[:, None] / value[:, None, None]
    return PlaneImage(points, by_ray, by_shape)


def _distorted(image: PlaneImage, terms: FloatArray) -> PlaneImage:
    """Return an image with Brown's distortion k1, k2, p1, p2 and, if given, k3 to k6, as further shape parameters."""
    _, _, p1, p2, *rest = terms
    x, y = image.points.T
    squared = x * x + y * y
    factor, slope = _radial(terms, squared)
    tangential = np.stack([2 * x * y, squared + 2 * x * x, squared + 2 * y * y], axis=-1)
    points = image.points * factor[:, None]
    points[:, 0] += p1 * tangential[:, 0] + p2 * tangential[:, 1]
    points[:, 1] += p1 * tangential[:, 2] + p2 * tangential[:, 0]
    bend = 2 * slope[:, None, None] * image.points[:, :, None] * image.points[:, None]
    bend += factor[:, None, None] * np.eye(2)
    bend[:, 0, 0] += 2 * p1 * y + 6 * p2 * x
    bend[:, 1, 1] += 6 * p1 * y + 2 * p2 * x
    bend[:, 0, 1] += 2 * p1 * x + 2 * p2 * y
    bend[:, 1, 0] += 2 * p1 * x + 2 * p2 * y
    below = 1 + squared[:, None] ** np.array([1, 2, 3]) @ terms[5:] if len(rest) > 1 else np.ones_like(squared)
    powers = [image.points * (squared**power / below)[:, None] for power in (1, 2, 3)]
    columns = [
        *powers[:2],
        np.stack([tangential[:, 0], tangential[:, 2]], axis=-1),
        np.stack([tangential[:, 1], tangential[:, 0]], axis=-1),
        *(powers[2:] if rest else []),
        *([-factor[:, None] * power for power in powers] if len(rest) > 1 else []),
    ]
    by_shape = np.concatenate([bend @ image.by_shape, np.stack(columns, axis=-1)], axis=-1)
    return PlaneImage(points, bend @ image.by_ray, by_shape)


def _radial(terms: FloatArray, squared: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the radial factor of Brown's distortion and its derivative, both by the squared radius."""
    k1, k2, _, _, *rest = terms
    k3, k4, k5, k6 = [*rest, 0.0, 0.0, 0.0, 0.0][:4]
    factor = 1 + squared * (k1 + squared * (k2 + squared * k3))
    slope = k1 + squared * (2 * k2 + 3 * squared * k3)
    if len(rest) > 1:
        below = 1 + squared * (k4 + squared * (k5 + squared * k6))
        slope = (slope - factor / below * (k4 + squared * (2 * k5 + 3 * squared * k6))) / below
        factor = factor / below
    return factor, slope
