"""Poses from bearings without a start: linear equations on the unit sphere, then a refinement.

Bearings are unit vectors in any direction, also beyond 90 degrees, where no normalised image plane exists. A
point ``P`` seen along ``b`` satisfies ``b x (R P + t) = 0``, which is linear in ``R`` and ``t``.
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import RigidTransform, Rotation

from palletloc.geometry import FloatArray

_FLAT, _LINE = 1e-3, 1e-3
"""Points thinner than this part of their extent lie in a plane, and on a line: what is printed is flatter."""


def pose_from_bearings(points: FloatArray, bearings: FloatArray) -> RigidTransform | None:
    """Return the pose that maps points onto bearings, from the linear equations alone.

    Parameters
    ----------
    points : (n, 3) array
        In the target's frame, in metres: at least 6, or at least 4 where all lie in one plane.
    bearings : (n, 3) array
        Unit vectors to them in the camera frame, from one centre.

    Returns
    -------
    RigidTransform, optional
        ``camera_from_target``; None where the points are too few, lie on a line, or fit only when mirrored.
    """
    center = points.mean(0)
    _, extent, axes = np.linalg.svd(points - center, full_matrices=False)
    if len(points) < 4 or not extent[1] > _LINE * extent[0]:
        return None
    flat = bool(extent[2] < _FLAT * extent[0])
    if not flat and len(points) < 6:
        return None
    if np.linalg.det(axes) < 0:
        axes = axes * np.array([[1.0], [1.0], [-1.0]])
    local = (points - center) @ axes.T / extent[0]
    matrix = _null_vector(local[:, :2] if flat else local, bearings)
    if flat:
        matrix = np.insert(matrix, 2, np.cross(matrix[:, 0], matrix[:, 1]) / np.linalg.norm(matrix[:, 0]), axis=1)
    left, scale, right = np.linalg.svd(matrix[:, :3])
    if np.linalg.det(left @ right) < 0 or not scale[1] > 0:
        return None
    turned = left @ right @ axes
    translation = matrix[:, 3] / scale[:2].mean() * extent[0] - turned @ center
    return RigidTransform.from_components(translation, Rotation.from_matrix(turned))


def _null_vector(local: FloatArray, bearings: FloatArray) -> FloatArray:
    """Return ``[R | t]`` up to a positive scale, (3, d + 1), for points of d coordinates."""
    known = np.concatenate([local, np.ones((len(local), 1))], axis=1)
    equations = np.einsum("nij,nk->nikj", cross_matrices(bearings), known).reshape(3 * len(local), -1)
    matrix = np.linalg.svd(equations, full_matrices=False)[2][-1].reshape(-1, 3).T
    depth = np.einsum("ni,ij,nj->n", bearings, matrix, known)
    ahead: FloatArray = matrix if np.median(depth) > 0 else -matrix
    return ahead


def cross_matrices(vectors: FloatArray) -> FloatArray:
    """Return the matrices [v]x with ``[v]x w == cross(v, w)``, (..., 3, 3)."""
    x, y, z = np.moveaxis(vectors, -1, 0)
    zero = np.zeros_like(x)
    rows = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=-1)
    return rows.reshape(*vectors.shape, 3)


def tangent_axes(bearings: FloatArray) -> FloatArray:
    """Return two unit vectors across each bearing, (n, 2, 3).

    Examples
    --------
    >>> tangent_axes(np.array([[1.0, 0.0, 0.0]])).round(3).tolist()
    [[[0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]]
    """
    least = np.eye(3)[np.argmin(np.abs(bearings), axis=-1)]
    first = np.cross(bearings, least)
    first /= np.linalg.norm(first, axis=-1, keepdims=True)
    return np.stack([first, np.cross(bearings, first)], axis=-2)


def refine_pose(
    start: RigidTransform, points: FloatArray, bearings: FloatArray, origins: FloatArray, sigma: FloatArray
) -> RigidTransform:
    """Return the pose with the least robust residuals on the tangent planes of the bearings.

    Parameters
    ----------
    start : RigidTransform
        ``camera_from_target``.
    points : (n, 3) array
        In the target's frame, in metres.
    bearings, origins : (n, 3) arrays
        Unit vectors in the camera frame, and where they start.
    sigma : (n,) array
        Standard deviation of each bearing, in radians.
    """
    across = tangent_axes(bearings)

    def residuals(step: FloatArray) -> FloatArray:
        rays = Rotation.from_rotvec(step[:3]).apply(rotated) + start.translation + step[3:] - origins
        rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
        tangent: FloatArray = (np.einsum("nij,nj->ni", across, rays) / sigma[:, None]).ravel()
        return tangent

    rotated = start.rotation.apply(points)
    step = least_squares(residuals, np.zeros(6), loss="soft_l1", f_scale=2.0, x_scale="jac", max_nfev=30).x
    return RigidTransform.from_components(
        start.translation + step[3:], Rotation.from_rotvec(step[:3]) * start.rotation
    )
