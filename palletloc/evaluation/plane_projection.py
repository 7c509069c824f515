"""Poses seen in one coordinate plane: what a forklift's floor leaves of a trajectory."""

from __future__ import annotations

from enum import StrEnum

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation


class Plane(StrEnum):
    """A coordinate plane."""

    XY = "xy"
    """The floor, where z is up."""
    XZ = "xz"
    """The floor of a camera whose y points down."""
    YZ = "yz"
    """The third one."""


_NORMAL = {Plane.XY: 2, Plane.XZ: 1, Plane.YZ: 0}


def project(poses: RigidTransform, plane: Plane) -> RigidTransform:
    """Return poses projected to a plane.

    Parameters
    ----------
    poses : RigidTransform
        n of them.
    plane : Plane
        In the poses' target frame.

    Returns
    -------
    RigidTransform
        The coordinate across the plane is zero. Of the rotation ``Rz(yaw) Ry(pitch) Rx(roll)`` only the
        angle about the plane's normal is kept: the yaw, for the floor.
    """
    normal = _NORMAL[plane]
    positions = np.array(poses.translation)
    positions[..., normal] = 0.0
    R = poses.rotation.as_matrix()
    angles = (
        np.arctan2(R[..., 2, 1], R[..., 2, 2]),
        np.arctan2(-R[..., 2, 0], np.hypot(R[..., 0, 0], R[..., 1, 0])),
        np.arctan2(R[..., 1, 0], R[..., 0, 0]),
    )
    turns = Rotation.from_rotvec(angles[normal][..., None] * np.eye(3)[normal])
    return RigidTransform.from_components(positions, turns)
