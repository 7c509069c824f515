"""Hypotheses on axes that people can read: yaw in the forklift frame, and ground distance from the camera."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from palletloc.geometry import FloatArray, LevelPose, wrap_angle
from palletloc.refinement.patch import FacePatch


@dataclass(frozen=True, slots=True)
class SearchAxes:
    """Between poses and the table of a search, whose columns are distances along one viewing ray.

    A pose beside that ray has the distance of the point on the ray that is as deep: what it is shifted along the
    shelf does not move it from one column to another.
    """

    base: LevelPose
    """``forklift_from_pallet`` of the middle of the search, which the viewing ray goes through."""
    away: float
    """Ground distance of the camera from it, in metres."""
    depth: float
    """Distance of the camera from the plane of its face, in metres."""

    @classmethod
    def of(cls, patch: FacePatch) -> SearchAxes:
        """Return the axes of a search on a patch."""
        right, _, towards = (float(value) for value in patch.plane_from_camera)
        return cls(patch.base, float(np.hypot(right, towards)), towards)

    def yaws(self, turns: FloatArray) -> FloatArray:
        """Return the yaws of turns against the base, unwrapped, in radians."""
        return self.base.yaw + turns

    def ranges(self, factors: FloatArray) -> FloatArray:
        """Return the ground distances of multiples of the base's, in metres."""
        return self.away * factors

    def place(self, pose: LevelPose) -> FloatArray:
        """Return yaw in radians and ground distance in metres of a pose, (2,); the yaw is that next to the base's."""
        into = np.array([np.cos(self.base.yaw), np.sin(self.base.yaw)])
        behind = float(into @ [pose.x - self.base.x, pose.y - self.base.y])
        yaw = self.base.yaw + wrap_angle(pose.yaw - self.base.yaw)
        return np.array([yaw, self.away * (1 + behind / self.depth)])

    def covariance(self, covariance: FloatArray) -> FloatArray:
        """Return the (2, 2) covariance of `place` from that of (x, y, z, yaw)."""
        per_depth = self.away / self.depth
        change = np.array(
            [[0, 0, 0, 1], [per_depth * np.cos(self.base.yaw), per_depth * np.sin(self.base.yaw), 0, 0]]
        )
        return np.asarray(change @ covariance @ change.T)
