"""What a planned layout of targets will give: standard deviations of the mounting before anything is measured.

Given the camera's pose, targets say something about it independently of each other: the information of a layout is
the sum of what each target gives, after its own pose is eliminated (the Schur complement).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import RigidTransform

from calibration.degeneracy import LIMITS, in_words
from calibration.mounting.assessment import MAX_POSITION_SIGMA, MAX_ROTATION_SIGMA
from calibration.mounting.problem import CAMERA, MountingProblem, Poses, SurveyedTarget
from calibration.mounting.two_centres import LENS_AXIS
from calibration.targets.observations import CornerObservation
from calibration.targets.patches import pixel_density
from calibration.targets.targets import PrintedPattern, on_board
from palletloc.cameras.protocol import CameraModel
from palletloc.geometry import FloatArray

ACCEPTED = np.array([MAX_POSITION_SIGMA] * 3 + [MAX_ROTATION_SIGMA] * 3)
"""Standard deviations up to which a calibration passes, in metres and radians."""
LEAST_MARKER_PX, GOOD_MARKER_PX = 8.0, 15.0
"""Markers that are narrower are not found; those that are narrower than the second are not always found."""
MOST_OBLIQUE = np.radians(80.0)
"""A print whose normal is farther off the line of sight is not found, in radians."""
_OPEN = 1e12
"""What nothing tells has this variance, in units of `LIMITS`: finite, so that sums and inverses stay so."""
_EXACT = 100.0
"""A survey that is so many times as good counts as exact."""


@dataclass(frozen=True, slots=True, eq=False)
class PlannedTarget:
    """One target as it will hang."""

    pattern: PrintedPattern
    """What will be printed."""
    survey: SurveyedTarget
    """Its name, its corners in the forklift frame, and how well they will be surveyed."""


@dataclass(frozen=True, slots=True, eq=False)
class Layout:
    """What is planned."""

    camera: CameraModel
    """The camera."""
    forklift_from_camera: RigidTransform
    """Roughly where it is."""
    targets: tuple[PlannedTarget, ...]
    """All around it."""
    corner_px: float
    """How well a corner will be measured, in pixels."""
    corner_angle: float | None = None
    """The same as an angle, in radians; counts where it is given."""


@dataclass(frozen=True, slots=True, eq=False)
class PredictedTarget:
    """How the camera will see one target, and what that gives."""

    planned: PlannedTarget
    """The target."""
    corners: CornerObservation
    """Its corners that the camera sees."""
    distance: float
    """From the camera to the pattern's middle, in metres."""
    direction: FloatArray
    """(3,) unit vector to it in the forklift frame."""
    obliqueness: float
    """Angle between the pattern's normal and the line of sight, in radians; beyond a right angle: its back."""
    marker_px: float
    """Side of its markers in the image, seen from the front."""
    information: FloatArray
    """(7, 7) about the camera's six numbers and the distance of two lens centres; zero where it is not found."""

    @property
    def found(self) -> bool:
        """Whether the camera will find it."""
        facing = self.obliqueness < MOST_OBLIQUE
        return bool(len(self.corners.points) >= 4 and facing and self.marker_px >= LEAST_MARKER_PX)


@dataclass(frozen=True, slots=True, eq=False)
class LayoutPrediction:
    """What a layout will give."""

    layout: Layout
    """What was planned."""
    targets: tuple[PredictedTarget, ...]
    """How the camera will see each target."""

    @property
    def information(self) -> FloatArray:
        """(7, 7) of all targets together."""
        return _total(self.targets)

    @property
    def covariance(self) -> FloatArray:
        """(6, 6) of translation and rotation, along and about the forklift's axes; huge where nothing tells."""
        return covariance(self.information[:CAMERA, :CAMERA])

    @property
    def sigma(self) -> FloatArray:
        """(6,) standard deviations, in metres and radians."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def lens_sigma(self) -> float:
        """Standard deviation of the distance of two lens centres, if there were two, in metres."""
        rest, column, own = (
            self.information[:CAMERA, :CAMERA],
            self.information[:CAMERA, CAMERA],
            self.information[6, 6],
        )
        free = own - column @ covariance(rest) @ column
        return float(free**-0.5) if free > 1e-9 * own > 0 else np.inf

    def without(self, index: int) -> FloatArray:
        """Return the standard deviations without one of the targets, (6,)."""
        rest = _total([target for i, target in enumerate(self.targets) if i != index])
        return np.sqrt(np.diag(covariance(rest[:CAMERA, :CAMERA])))

    def lost(self) -> list[str]:
        """Return in words the directions that stay open: beyond 50 mm or 2 degrees."""
        values, vectors = np.linalg.eigh(self.covariance / np.outer(LIMITS, LIMITS))
        return [in_words(vectors[:, i]) for i in np.argsort(-values) if values[i] > 1]


def _total(targets: Iterable[PredictedTarget]) -> FloatArray:
    total = np.zeros((CAMERA + 1, CAMERA + 1))
    for target in targets:
        total += target.information
    return total


def predict(layout: Layout) -> LayoutPrediction:
    """Predict what the calibration will state, without scale factors: bearings and survey as good as planned."""
    return LayoutPrediction(layout, tuple(_predicted(layout, target) for target in layout.targets))


def with_exact_survey(layout: Layout) -> Layout:
    """Return the layout with a survey that is as good as exact."""
    targets = (
        replace(target, survey=replace(target.survey, sigma=target.survey.sigma / _EXACT))
        for target in layout.targets
    )
    return replace(layout, targets=tuple(targets))


def covariance(information: FloatArray) -> FloatArray:
    """Return the inverse of an information matrix about the six numbers; huge along what it leaves open.

    Parameters
    ----------
    information : (6, 6) array
        In units of metres and radians.

    Examples
    --------
    >>> sigma = np.sqrt(np.diag(covariance(np.diag([1e6, 1e6, 0.0, 1e8, 1e8, 1e8]))))
    >>> sigma[0].round(6).item(), sigma[2].item() > 1000
    (0.001, True)
    """
    values, vectors = np.linalg.eigh(information * np.outer(LIMITS, LIMITS))
    scaled = vectors / np.maximum(values, 1 / _OPEN) @ vectors.T
    return np.asarray(scaled * np.outer(LIMITS, LIMITS))


def worst(sigma: FloatArray) -> float:
    """Return the largest of six standard deviations over those with which a calibration passes."""
    return float((sigma / ACCEPTED).max())


def planned_problem(targets: Iterable[PredictedTarget], camera: RigidTransform) -> tuple[MountingProblem, Poses]:
    """Return the equations that the found targets will give, free of errors, and their solution.

    Parameters
    ----------
    targets : iterable of PredictedTarget
        Those that are not found are left out.
    camera : RigidTransform
        ``forklift_from_camera``.
    """
    found = [target for target in targets if target.found]
    surveys = tuple(target.planned.survey for target in found)
    numbered = tuple(replace(target.corners, target=k) for k, target in enumerate(found))
    problem = MountingProblem(surveys, numbered, (True,) * len(found))
    return problem, Poses(camera, tuple(survey.pose() for survey in surveys))


def _predicted(layout: Layout, planned: PlannedTarget) -> PredictedTarget:
    pattern, board = planned.pattern, planned.survey.pose()
    points = on_board(pattern.corners)
    rays = layout.forklift_from_camera.inv().apply(board.apply(points))
    seen = layout.camera.project(rays).valid
    points, rays = points[seen], rays[seen]
    origins = layout.camera.centers(rays)
    bearings = (rays - origins) / np.linalg.norm(rays - origins, axis=-1, keepdims=True)
    pixel = _pixel_angle(layout.camera, bearings)
    angle = layout.corner_px * pixel if layout.corner_angle is None else layout.corner_angle
    corners = CornerObservation(0, points, bearings, origins, np.full(len(points), angle))

    middle = board.apply(on_board(np.array([[pattern.width, pattern.height]]) / 2))[0]
    away = middle - layout.forklift_from_camera.translation
    distance = float(np.linalg.norm(away))
    into = board.rotation.apply([0.0, 0.0, 1.0])
    obliqueness = float(np.arccos(np.clip(into @ away / distance, -1, 1)))
    side = float(np.linalg.norm(pattern.marker_corners[0, 1] - pattern.marker_corners[0, 0]))
    marker = side / distance / pixel
    target = PredictedTarget(planned, corners, distance, away / distance, obliqueness, marker, np.zeros((7, 7)))
    return replace(target, information=_information(target, layout.forklift_from_camera)) if target.found else target


def _pixel_angle(camera: CameraModel, bearings: FloatArray) -> float:
    """Return the side of a pixel where a target is seen, in radians; infinite where it is not."""
    if not len(bearings):
        return np.inf
    density = pixel_density(camera, bearings[:: max(1, len(bearings) // 4)])
    return float(1 / np.nanmedian(density)) if np.isfinite(density).any() else np.inf


def _information(target: PredictedTarget, camera: RigidTransform) -> FloatArray:
    """Return what one target tells, after its own pose is eliminated."""
    problem, poses = planned_problem([target], camera)
    lens = problem.by_lens_distance(poses, LENS_AXIS)
    jacobian = np.insert(problem.jacobian(poses), CAMERA, lens, axis=1)
    normal, kept = jacobian.T @ jacobian, CAMERA + 1
    own = np.linalg.solve(normal[kept:, kept:], normal[kept:, :kept])
    information: FloatArray = normal[:kept, :kept] - normal[:kept, kept:] @ own
    return (information + information.T) / 2
