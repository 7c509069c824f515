"""Poses on the floor as arrays (..., 3) of x, y and yaw, in metres and radians: many at once."""

from __future__ import annotations

import numpy as np

from palletloc.geometry import FloatArray, wrap_angle


def compose(pose: FloatArray, step: FloatArray) -> FloatArray:
    """Return a pose moved by a step that is given in its own frame; both (..., 3) as x, y, yaw.

    Examples
    --------
    >>> compose(np.array([1.0, 0.0, np.pi / 2]), np.array([2.0, 0.0, 0.0])).round(6).tolist()
    [1.0, 2.0, 1.570796]
    """
    cos, sin = np.cos(pose[..., 2]), np.sin(pose[..., 2])
    x, y = step[..., 0], step[..., 1]
    return np.stack(
        [pose[..., 0] + cos * x - sin * y, pose[..., 1] + sin * x + cos * y, pose[..., 2] + step[..., 2]], -1
    )


def relative(pose: FloatArray, other: FloatArray) -> FloatArray:
    """Return another pose in the frame of a pose: the inverse of `compose`; yaw in [-pi, pi)."""
    cos, sin = np.cos(pose[..., 2]), np.sin(pose[..., 2])
    dx, dy = other[..., 0] - pose[..., 0], other[..., 1] - pose[..., 1]
    return np.stack([cos * dx + sin * dy, cos * dy - sin * dx, wrap_angle(other[..., 2] - pose[..., 2])], -1)


def relative_slopes(pose: FloatArray, other: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the derivatives of `relative` by both poses, (n, 3, 3) each.

    Parameters
    ----------
    pose, other : (n, 3) array
        As `relative` takes them.
    """
    cos, sin = np.cos(pose[:, 2]), np.sin(pose[:, 2])
    by_other = np.zeros((len(pose), 3, 3))
    by_other[:, 0, 0] = by_other[:, 1, 1] = cos
    by_other[:, 0, 1], by_other[:, 1, 0], by_other[:, 2, 2] = sin, -sin, 1.0
    by_pose = -by_other
    by_pose[:, :2, 2] = -quarter(relative(pose, other)[:, :2])
    return by_pose, by_other


def turned(places: FloatArray, angle: FloatArray) -> FloatArray:
    """Return places on the floor, (n, 2), each turned about the origin by its angle, (n,)."""
    cos, sin = np.cos(angle), np.sin(angle)
    return np.stack([cos * places[:, 0] - sin * places[:, 1], sin * places[:, 0] + cos * places[:, 1]], axis=1)


def quarter(places: FloatArray) -> FloatArray:
    """Return places on the floor, (n, 2), a quarter turn to the left: the derivative of `turned` by the angle."""
    return np.stack([-places[:, 1], places[:, 0]], axis=1)
