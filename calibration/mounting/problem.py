"""The equations between camera, targets and survey: residuals and their derivatives.

Unknown are the camera's pose on the forklift and the pose of every target. Corners seen along bearings tie the
camera to the targets; three surveyed corners of each tie the targets to the forklift, as Gaussian priors.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from calibration.bearings import cross_matrices, tangent_axes
from calibration.targets.observations import CornerObservation
from palletloc.geometry import BoolArray, FloatArray

CAMERA = 6
"""Parameters of the camera: three translations, then three rotations; the targets' follow in the same order."""


@dataclass(frozen=True, slots=True, eq=False)
class SurveyedTarget:
    """Corners of one target as they were surveyed."""

    name: str
    """Of the target."""
    outline: FloatArray
    """(3, 3) upper left, upper right and lower left corner of its pattern, in the board frame."""
    points: FloatArray
    """(3, 3) the same, surveyed, in the forklift frame."""
    sigma: float
    """Standard deviation of each coordinate, in metres."""

    def pose(self) -> RigidTransform:
        """Return ``forklift_from_board``: the rigid pose that is nearest to the surveyed corners."""
        middle, center = self.outline.mean(0), self.points.mean(0)
        rotation, _ = Rotation.align_vectors(self.points - center, self.outline - middle)
        return RigidTransform.from_components(center - rotation.apply(middle), rotation)


@dataclass(frozen=True, slots=True, eq=False)
class Poses:
    """Values of the unknowns."""

    camera: RigidTransform
    """``forklift_from_camera``."""
    boards: tuple[RigidTransform, ...]
    """``forklift_from_board`` of each target."""

    def moved(self, step: FloatArray) -> Poses:
        """Return the poses after steps of translation and rotation along and about the forklift's axes."""
        steps, poses = step.reshape(-1, 6), (self.camera, *self.boards)
        # All at once: SciPy's transforms take long to make, one by one.
        matrices = np.stack([pose.as_matrix() for pose in poses])
        matrices[:, :3, :3] = Rotation.from_rotvec(steps[:, 3:]).as_matrix() @ matrices[:, :3, :3]
        matrices[:, :3, 3] += steps[:, :3]
        moved = [RigidTransform(matrix, normalize=False) for matrix in matrices]
        return Poses(moved[0], tuple(moved[1:]))


@dataclass(frozen=True, slots=True, eq=False)
class MountingProblem:
    """All observations of one calibration."""

    surveys: tuple[SurveyedTarget, ...]
    """Of every target that is seen."""
    observations: tuple[CornerObservation, ...]
    """In every shot."""
    surveyed: tuple[bool, ...]
    """Which surveys count; the others are only predicted."""
    bearing_scale: float = 1.0
    """Factor on the bearings' standard deviations."""
    survey_scale: float = 1.0
    """Factor on the surveys' standard deviations."""

    @property
    def image_rows(self) -> int:
        """How many of the residuals belong to bearings; those of the surveys follow."""
        return 2 * sum(len(corners.points) for corners in self.observations)

    def without_survey(self, target: int) -> MountingProblem:
        """Return the problem in which one target is only predicted, not held by its survey."""
        return replace(self, surveyed=tuple(k and i != target for i, k in enumerate(self.surveyed)))

    def kept(self, chosen: Sequence[BoolArray]) -> MountingProblem:
        """Return the problem with only the chosen corners of each observation."""
        kept = (seen.kept(mask) for seen, mask in zip(self.observations, chosen, strict=True))
        return replace(self, observations=tuple(kept))

    def residuals(self, poses: Poses) -> FloatArray:
        """Return the residuals in units of their standard deviations: bearings first, then surveys, (m,)."""
        return np.concatenate([*self._bearing_residuals(poses), *self._survey_residuals(poses)])

    def _bearing_residuals(self, poses: Poses) -> list[FloatArray]:
        camera_from_forklift = poses.camera.inv()
        rows = []
        for corners in self.observations:
            rays = camera_from_forklift.apply(poses.boards[corners.target].apply(corners.points)) - corners.origins
            rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
            tangent = np.einsum("nij,nj->ni", tangent_axes(corners.bearings), rays)
            rows.append((tangent / (self.bearing_scale * corners.sigma[:, None])).ravel())
        return rows

    def _survey_residuals(self, poses: Poses) -> list[FloatArray]:
        return [
            ((pose.apply(survey.outline) - survey.points) / (self.survey_scale * survey.sigma)).ravel()
            for survey, pose, counts in zip(self.surveys, poses.boards, self.surveyed, strict=True)
            if counts
        ]

    def jacobian(self, poses: Poses) -> FloatArray:
        """Return the derivatives of the residuals by steps as `Poses.moved` takes them, (m, 6 + 6 k)."""
        size = CAMERA * (1 + len(self.surveys))
        blocks = [self._bearing_rows(corners, poses, size) for corners in self.observations]
        for k, (survey, counts) in enumerate(zip(self.surveys, self.surveyed, strict=True)):
            if counts:
                rows = np.zeros((9, size))
                rows[:, board_columns(k)] = self.predicted_rows(k, poses) / (self.survey_scale * survey.sigma)
                blocks.append(rows)
        return np.concatenate(blocks)

    def predicted_rows(self, target: int, poses: Poses) -> FloatArray:
        """Return the derivatives of a target's outline in the forklift frame by its own pose, (9, 6)."""
        turned = poses.boards[target].rotation.apply(self.surveys[target].outline)
        return _motion(turned).reshape(9, 6)

    def _bearing_rows(self, corners: CornerObservation, poses: Poses, size: int) -> FloatArray:
        pose, camera = poses.boards[corners.target], poses.camera
        inverse = camera.rotation.as_matrix().T
        points = pose.apply(corners.points)
        rays = (points - camera.translation) @ inverse.T - corners.origins
        distance = np.linalg.norm(rays, axis=-1)
        units = rays / distance[:, None]
        across = tangent_axes(corners.bearings) / (self.bearing_scale * corners.sigma * distance)[:, None, None]
        across -= np.einsum("nij,nj,nk->nik", across, units, units)
        by_point = across @ inverse
        rows = np.zeros((2 * len(points), size))
        rows[:, :CAMERA] = -(by_point @ _motion(points - camera.translation)).reshape(-1, 6)
        rows[:, board_columns(corners.target)] = (by_point @ _motion(points - pose.translation)).reshape(-1, 6)
        return rows

    def by_lens_distance(self, poses: Poses, axis: FloatArray) -> FloatArray:
        """Return the derivatives of the residuals by the distance of two lens centres along an axis, (m,).

        Parameters
        ----------
        poses : Poses
            Where to take them.
        axis : (3,) array
            Unit vector in the camera frame: the front lens looks along it, the back lens against it.
        """
        rows = []
        for corners in self.observations:
            shift = np.sign(corners.bearings @ axis)[:, None] * axis / 2
            rays = poses.camera.inv().apply(poses.boards[corners.target].apply(corners.points)) - corners.origins
            distance = np.linalg.norm(rays, axis=-1)[:, None]
            units = rays / distance
            moved = -(shift - np.sum(shift * units, -1, keepdims=True) * units) / distance
            tangent = np.einsum("nij,nj->ni", tangent_axes(corners.bearings), moved)
            rows.append((tangent / (self.bearing_scale * corners.sigma[:, None])).ravel())
        return np.concatenate([*rows, np.zeros(9 * sum(self.surveyed))])

    def with_lens_distance(self, distance: float, axis: FloatArray) -> MountingProblem:
        """Return the problem in which bearings start from two centres, this far apart along an axis, in metres."""
        observations = tuple(
            replace(
                corners, origins=corners.origins + np.sign(corners.bearings @ axis)[:, None] * axis * distance / 2
            )
            for corners in self.observations
        )
        return replace(self, observations=observations)

    def by_survey_scale(self) -> FloatArray:
        """Return the derivatives of the residuals by a factor on all surveyed coordinates, (m,)."""
        rows = [
            -survey.points.ravel() / (self.survey_scale * survey.sigma)
            for survey, counts in zip(self.surveys, self.surveyed, strict=True)
            if counts
        ]
        return np.concatenate([np.zeros(self.image_rows), *rows])


def board_columns(target: int) -> slice:
    """Return the columns of a target's parameters."""
    return slice(CAMERA * (target + 1), CAMERA * (target + 2))


def _motion(arms: FloatArray) -> FloatArray:
    """Return how points move by translations and rotations when they lie at these arms, (n, 3, 6)."""
    eye = np.broadcast_to(np.eye(3), (len(arms), 3, 3))
    return np.concatenate([eye, -cross_matrices(arms)], axis=-1)
