import math
from collections.abc import Callable

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import RigidTransform, Rotation
from scipy.stats import chi2

from palletloc.geometry import FloatArray, LevelPose, wrap_angle
from palletloc.survey.rigid_body import (
    BodyFit,
    FitError,
    UncertainPose,
    fit_level,
    fit_rigid,
    free_scale,
    is_mirrored,
    relative_pose,
)

FORKLIFT = np.array([[-0.9, 0.45, 2.1], [-0.9, -0.45, 2.08], [0.55, -0.4, 1.2]])
FRONT = np.array([[0, 0.55, 0.012], [0, -0.55, 0.012], [0, 0.55, 0.132]])
SOLID = np.vstack([FORKLIFT, [[0.3, 0.5, 0.4]]])
POSE = RigidTransform.from_components([12.0, -3.0, 0.4], Rotation.from_euler("ZYX", [2.5, 0.02, -0.01]))
SIGMA = 1e-3
Fit = Callable[[FloatArray, FloatArray, float], BodyFit]


def small_error(true: RigidTransform, estimate: RigidTransform) -> FloatArray:
    """Return the six small errors of an estimate, as the covariance means them."""
    turn = (estimate.rotation * true.rotation.inv()).as_rotvec()
    return np.concatenate([np.asarray(estimate.translation) - np.asarray(true.translation), turn])


@pytest.mark.parametrize("body", [FORKLIFT, FRONT, SOLID], ids=["forklift", "front", "solid"])
def test_exact_points_give_the_exact_pose(body: FloatArray) -> None:
    fit = fit_rigid(body, POSE.apply(body), SIGMA)
    assert_allclose(fit.pose.target_from_source.as_matrix(), POSE.as_matrix(), atol=1e-12)
    assert fit.rms < 1e-12
    assert fit.freedom == 3 * len(body) - 6
    assert np.nanmax(fit.leave_one_out) < 1e-11


def test_a_level_fit_finds_heading_and_place() -> None:
    level = LevelPose(3.0, -2.0, 0.7, -2.9)
    fit = fit_level(FRONT[:2], level.transform().apply(FRONT[:2]), SIGMA)
    assert_allclose(fit.pose.level.as_array(), level.as_array(), atol=1e-12)
    assert fit.assumed_level
    assert fit.pose.tilt == 0
    assert np.isnan(fit.leave_one_out).all()


@pytest.mark.parametrize(("sigma", "degrees"), [(1e-3, 0.07), (2e-3, 0.15), (5e-3, 0.37)])
def test_the_heading_by_two_points_is_known_as_their_distance_allows(sigma: float, degrees: float) -> None:
    fit = fit_level(FRONT[:2], FRONT[:2], sigma)
    assert math.degrees(fit.pose.yaw_sigma) == pytest.approx(degrees, abs=0.006)
    assert fit.pose.yaw_sigma == pytest.approx(math.sqrt(2) * sigma / 1.1)


def draws(
    body: FloatArray, level: bool, count: int, rng: np.random.Generator
) -> list[tuple[BodyFit, RigidTransform]]:
    pose = LevelPose(12.0, -3.0, 0.4, 2.5).transform() if level else POSE
    fit = fit_level if level else fit_rigid
    exact = pose.apply(body)
    return [(fit(body, exact + rng.normal(0, SIGMA, body.shape), SIGMA), pose) for _ in range(count)]


@pytest.mark.parametrize(("body", "level"), [(FORKLIFT, False), (FRONT, False), (SOLID, False), (FRONT[:2], True)])
def test_the_covariance_of_a_pose_and_of_its_residuals_is_true(
    body: FloatArray, level: bool, rng: np.random.Generator
) -> None:
    count = 200
    nees = six = residual = 0.0
    for fit, pose in draws(body, level, count, rng):
        uncertain = UncertainPose(pose, fit.pose.covariance)
        error = fit.pose.level.as_array() - uncertain.level.as_array()
        error[3] = wrap_angle(float(error[3]))
        nees += float(error @ np.linalg.solve(fit.pose.level_covariance, error))
        free = [0, 1, 2, 5] if level else [0, 1, 2, 3, 4, 5]
        small = small_error(pose, fit.pose.target_from_source)[free]
        six += float(small @ np.linalg.solve(fit.pose.covariance[np.ix_(free, free)], small))
        residual += fit.chi2
    for total, freedom in ((nees, 4), (six, 4 if level else 6), (residual, fit.freedom)):
        assert chi2.ppf(0.001, freedom * count) < total < chi2.ppf(0.999, freedom * count)


def test_a_covariance_for_a_quarter_of_the_variance_would_be_caught(rng: np.random.Generator) -> None:
    count = 100
    nees = 0.0
    for fit, pose in draws(FORKLIFT, False, count, rng):
        error = small_error(pose, fit.pose.target_from_source)
        nees += float(error @ np.linalg.solve(fit.pose.covariance / 4, error))
    assert nees > 2 * chi2.ppf(0.999, 6 * count)


def test_a_relative_pose_has_the_uncertainty_of_both(rng: np.random.Generator) -> None:
    true_a, true_b = POSE, LevelPose(14.5, 0.5, 1.5, 1.1).transform()
    true = UncertainPose(true_a.inv() * true_b, np.zeros((6, 6)))
    count, total, small_total = 200, 0.0, 0.0
    for _ in range(count):
        a, b = (
            fit_rigid(body, pose.apply(body) + rng.normal(0, SIGMA, body.shape), SIGMA).pose
            for body, pose in ((FORKLIFT, true_a), (FRONT, true_b))
        )
        found = relative_pose(a, b)
        error = found.level.as_array() - true.level.as_array()
        total += float(error @ np.linalg.solve(found.level_covariance, error))
        small = small_error(true.target_from_source, found.target_from_source)
        small_total += float(small @ np.linalg.solve(found.covariance, small))
    for value, freedom in ((total, 4), (small_total, 6)):
        assert chi2.ppf(0.001, freedom * count) < value < chi2.ppf(0.999, freedom * count)


def test_an_uncertain_heading_of_the_vehicle_moves_what_is_far_ahead() -> None:
    a = fit_level(FRONT[:2], FRONT[:2], SIGMA).pose
    near, far = (
        relative_pose(a, UncertainPose(RigidTransform.from_translation([x, 0, 0]), np.zeros((6, 6))))
        for x in (0.0, 4.0)
    )
    assert far.level_covariance[1, 1] == pytest.approx(near.level_covariance[1, 1] + (4 * a.yaw_sigma) ** 2)


def test_leave_one_out_names_the_bad_point_and_the_free_scale_is_no_part_of_the_pose() -> None:
    world = POSE.apply(SOLID)
    world[2, 0] += 0.05
    fit = fit_rigid(SOLID, world, SIGMA)
    assert fit.leave_one_out.argmax() == 2
    assert fit.leave_one_out[2] == pytest.approx(0.05, rel=1e-6)
    world = 3.2808 * POSE.apply(SOLID)
    assert free_scale(SOLID, world) == pytest.approx(3.2808)
    assert_allclose(np.linalg.det(fit_rigid(SOLID, world, SIGMA).pose.target_from_source.as_matrix()), 1.0)


@pytest.mark.parametrize(
    ("solve", "body", "said"),
    [
        (fit_rigid, FORKLIFT[:2], "it has 2 points, expected at least 3"),
        (fit_rigid, np.array([[0, 0.5, 0.1], [0, 0, 0.1], [0, -0.5, 0.1]]), "its 3 points lie on one line"),
        (fit_rigid, np.zeros((3, 3)), "lie on one line"),
        (fit_level, FRONT[:1], "it has 1 point, expected at least 2"),
        (fit_level, FRONT[[0, 2]], "its 2 points stand above one another"),
    ],
)
def test_points_that_fix_no_pose_are_refused_with_the_reason(solve: Fit, body: FloatArray, said: str) -> None:
    with pytest.raises(FitError, match=said):
        solve(body, body, SIGMA)


def test_a_mirrored_solid_body_is_known_as_such_and_not_fitted_by_a_reflection() -> None:
    world = POSE.apply(SOLID)
    assert not is_mirrored(SOLID, world, 0.003)
    mirrored = world[:, [1, 0, 2]]
    assert is_mirrored(SOLID, mirrored, 0.003)
    fit = fit_rigid(SOLID, mirrored, SIGMA)
    assert np.linalg.det(fit.pose.target_from_source.as_matrix()[:3, :3]) == pytest.approx(1.0)
    assert fit.rms > 0.05


def test_the_level_part_of_a_tilted_pose_keeps_the_heading_of_its_x_axis() -> None:
    # The slope of the heading by a small rotation, against small rotations themselves.
    pose = RigidTransform.from_rotation(Rotation.from_euler("ZYX", [0.7, 0.3, -0.2]))
    step = 1e-6
    for axis in range(3):
        turn = RigidTransform.from_rotation(Rotation.from_rotvec(step * np.eye(3)[axis]))
        covariance = np.zeros((6, 6))
        covariance[3 + axis, 3 + axis] = 1.0
        uncertain = UncertainPose(pose, covariance)
        moved = UncertainPose(turn * pose, covariance)
        slope = (moved.level.yaw - uncertain.level.yaw) / step
        assert uncertain.yaw_sigma == pytest.approx(abs(slope), abs=1e-5)
