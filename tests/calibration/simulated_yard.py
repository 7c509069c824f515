"""Yards of targets with their truth, as bearings without an image: what a layout gives, before anyone prints."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import RigidTransform
from scipy.stats import chi2

from calibration.mounting.fit import turn_to
from calibration.mounting.problem import MountingProblem, Poses, SurveyedTarget
from calibration.targets.observations import CornerObservation
from calibration.targets.targets import PrintedPattern, facing, on_board
from palletloc.geometry import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Yard:
    """Targets around a camera."""

    problem: MountingProblem
    """What the camera and the survey say."""
    truth: Poses
    """What is the case."""


@dataclass(frozen=True, slots=True)
class YardErrors:
    """How wrong a yard's observations are."""

    survey: float = 0.0005
    """Standard deviation of each surveyed coordinate, in metres."""
    bearing: float = 5e-5
    """Standard deviation of each bearing across itself, in radians."""
    drawn: bool = True
    """Whether errors of that size are drawn; else the observations are exact."""
    lens_distance: float = 0.0
    """Between the centres of two lenses along the camera's x axis, in metres."""


def simulate_yard(
    pattern: PrintedPattern, forklift_from_camera: RigidTransform, boards: Sequence[RigidTransform],
    errors: YardErrors = YardErrors(), seed: int = 0,
) -> Yard:  # fmt: skip
    """Return what a camera with one shot and a surveyor would say about targets at ``forklift_from_board``."""
    rng = np.random.default_rng(seed)
    outline, points = on_board(pattern.outline), on_board(pattern.corners)
    surveys, observations = [], []
    for k, pose in enumerate(boards):
        measured = pose.apply(outline) + errors.drawn * rng.normal(0.0, errors.survey, (3, 3))
        surveys.append(SurveyedTarget(f"B{k + 1}", outline, measured, errors.survey))
        rays = forklift_from_camera.inv().apply(pose.apply(points))
        rays[:, 0] -= np.sign(rays[:, 0]) * errors.lens_distance / 2
        observations.append(seen(k, points, rays, errors.bearing, rng if errors.drawn else None))
    problem = MountingProblem(tuple(surveys), tuple(observations), (True,) * len(boards))
    return Yard(problem, Poses(forklift_from_camera, tuple(boards)))


def boards_around(eye: FloatArray, azimuths: Sequence[float], seed: int = 0) -> list[RigidTransform]:
    """Return boards in these directions (radians) from an eye, at random distances, heights and turns; z is up."""
    rng = np.random.default_rng([seed, 1])
    boards = []
    for azimuth in azimuths:
        distance, height = rng.uniform(1.6, 2.8), rng.uniform(-1.2, 0.4)
        place = eye + np.array([distance * np.cos(azimuth), distance * np.sin(azimuth), height])
        boards.append(facing(place, eye, rng.normal(0.0, 0.2), rng.normal(0.0, 0.15)))
    return boards


def seen(
    target: int, points: FloatArray, rays: FloatArray, sigma: float, rng: np.random.Generator | None
) -> CornerObservation:
    """Return a target's points in the camera frame, `rays`, as bearings with errors or, without `rng`, exact."""
    noise = 0.0 if rng is None else rng.normal(0.0, sigma, rays.shape)
    return CornerObservation(
        target, points, _unit(_unit(rays) + noise), np.zeros_like(rays), np.full(len(rays), sigma)
    )


def pose_error(found: RigidTransform, truth: RigidTransform) -> FloatArray:
    """Return how a pose has to move, in metres, and turn, in radians, to be the true one."""
    return np.concatenate([truth.translation - found.translation, turn_to(found.rotation, truth.rotation)])


def assert_consistent(squares: Sequence[float], freedom: int = 6) -> None:
    """Hold that squares of errors over their covariance are as large as chance makes them."""
    low, high = (chi2.ppf(level, freedom * len(squares)) / len(squares) for level in (0.005, 0.995))
    assert low < np.mean(squares) < high


def _unit(rays: FloatArray) -> FloatArray:
    unit: FloatArray = rays / np.linalg.norm(rays, axis=-1, keepdims=True)
    return unit
