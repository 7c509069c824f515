"""Arrays, angles and poses: the little geometry that is ours; rotations and transforms are SciPy's."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

FloatArray = NDArray[np.float64]
"""Float64 array; the shape is given where it is used."""
BoolArray = NDArray[np.bool_]
"""Boolean array, usually a validity mask."""
Image = NDArray[np.uint8]
"""8-bit image, (height, width) gray or (height, width, 3) in blue-green-red order."""

_Angle = TypeVar("_Angle", float, FloatArray)


def wrap_angle(angle: _Angle) -> _Angle:
    """Wrap angles to [-pi, pi).

    Parameters
    ----------
    angle : float or (...) array
        Angles in radians.

    Returns
    -------
    float or (...) array
        The same directions in [-pi, pi).

    Examples
    --------
    >>> round(wrap_angle(3.5), 6)
    -2.783185
    """
    return (angle + math.pi) % (2 * math.pi) - math.pi


@dataclass(frozen=True, slots=True)
class LevelPose:
    """A pose with roll = pitch = 0: what a pallet on a shelf and a forklift on a floor have.

    Named ``target_from_source`` like every transform.
    """

    x: float
    """Forward, in metres."""
    y: float
    """Left, in metres."""
    z: float
    """Up, in metres."""
    yaw: float
    """Heading of the source's x axis in the target frame, in radians."""

    def transform(self) -> RigidTransform:
        """Return the pose as a rigid transform, to be composed with others.

        Examples
        --------
        >>> odom_from_forklift = LevelPose(1.0, 0.0, 0.0, np.pi / 2)
        >>> forklift_from_pallet = LevelPose(2.0, 0.0, 0.1, 0.0)
        >>> odom_from_pallet = odom_from_forklift.transform() * forklift_from_pallet.transform()
        >>> level_pose(odom_from_pallet).as_array().round(6).tolist()
        [1.0, 2.0, 0.1, 1.570796]
        """
        return RigidTransform(self.matrix(), normalize=False, copy=False)

    def matrix(self) -> FloatArray:
        """Return the pose as a (4, 4) homogeneous matrix."""
        cos, sin = np.cos(self.yaw), np.sin(self.yaw)
        return np.array([[cos, -sin, 0, self.x], [sin, cos, 0, self.y], [0, 0, 1, self.z], [0, 0, 0, 1.0]])

    def as_array(self) -> FloatArray:
        """Return (x, y, z, yaw) as a (4,) array."""
        return np.array([self.x, self.y, self.z, self.yaw])

    def minus(self, other: LevelPose) -> FloatArray:
        """Return how far this pose is from another one in the same frame: (4,), the yaw wrapped.

        Examples
        --------
        >>> LevelPose(1.0, 2.0, 0.0, 3.1).minus(LevelPose(0.5, 2.0, 0.0, -3.1)).round(6).tolist()
        [0.5, 0.0, 0.0, -0.083185]
        """
        apart = self.as_array() - other.as_array()
        apart[3] = wrap_angle(apart[3])
        return apart


def level_pose(target_from_source: RigidTransform) -> LevelPose:
    """Return the level part of a transform: its translation and its heading.

    Parameters
    ----------
    target_from_source : RigidTransform
        A single transform; its roll and pitch are dropped.

    Returns
    -------
    LevelPose
        With the yaw of the source's x axis.
    """
    matrix = target_from_source.as_matrix()
    x, y, z = (float(v) for v in matrix[:3, 3])
    return LevelPose(x, y, z, float(np.arctan2(matrix[1, 0], matrix[0, 0])))
