"""What all adjustments share: descents that find the least squares, what residuals tell, and poses from bearings."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from calibration.bearings import cross_matrices, pose_from_bearings, refine_pose, tangent_axes
from calibration.least_squares import (
    MEDIAN_LENGTH,
    descend,
    descend_damped,
    error_factor,
    inverse_normal,
    redundancies,
    within_gate,
)
from palletloc.geometry import FloatArray
from tests.calibration.expecting import present

DESIGN = np.random.default_rng(0).normal(size=(40, 3))
TRUTH = np.array([2.0, -1.0, 0.5])


@dataclass(frozen=True)
class Values:
    x: FloatArray

    def moved(self, step: FloatArray) -> "Values":
        return Values(self.x + step)


def residuals_to(seen: FloatArray) -> Callable[[Values], FloatArray]:
    return lambda values: np.asarray(DESIGN @ values.x - seen)


@pytest.mark.parametrize("derivatives", [None, lambda _values, _step: DESIGN])
def test_a_descent_ends_at_the_least_squares(derivatives: Callable[[Values, FloatArray], FloatArray] | None) -> None:
    seen = DESIGN @ TRUTH + np.random.default_rng(1).normal(size=40)
    found = descend(residuals_to(seen), Values(np.zeros(3)), np.ones(3), "linear", derivatives)
    np.testing.assert_allclose(found.x, np.linalg.lstsq(DESIGN, seen)[0], atol=1e-6)


def test_a_robust_descent_is_not_moved_by_single_wrong_values() -> None:
    seen = DESIGN @ TRUTH
    seen[:4] += 1000.0
    plain, robust = (
        descend(residuals_to(seen), Values(np.zeros(3)), np.ones(3), loss) for loss in ("linear", "soft_l1")
    )
    assert np.abs(robust.x - TRUTH).max() < 1.0 < np.abs(plain.x - TRUTH).max()


def test_a_damped_descent_ends_at_the_least_squares_and_never_rises() -> None:
    seen, costs = DESIGN @ TRUTH + np.random.default_rng(1).normal(size=40), list[float]()

    def cost(x: FloatArray) -> float:
        return float(((DESIGN @ x - seen) ** 2).sum())

    def step(x: FloatArray) -> Callable[[float], FloatArray | None]:
        costs.append(cost(x))
        normal, right = DESIGN.T @ DESIGN, DESIGN.T @ (seen - DESIGN @ x)
        return lambda damping: x + np.linalg.solve(normal + damping * np.diag(np.diag(normal)), right)

    found = descend_damped(np.zeros(3), cost, step, 1e3, 60, 1e-14)
    np.testing.assert_allclose(found, np.linalg.lstsq(DESIGN, seen)[0], atol=1e-6)
    assert (np.diff(costs) < 0).all()


def test_a_damped_descent_stays_where_no_step_helps() -> None:
    assert descend_damped(1.0, lambda x: x**2, lambda _: lambda _: None, 1.0, 10, 0.0) == 1.0


def test_redundancies_add_up_to_the_observations_less_the_unknowns() -> None:
    covariance = inverse_normal(DESIGN)
    np.testing.assert_array_equal(covariance, covariance.T)
    left = redundancies(DESIGN, covariance)
    assert left.sum() == pytest.approx(40 - 3)
    assert ((left > 0) & (left < 1)).all()


def test_the_gate_passes_what_is_normal_whatever_its_scale() -> None:
    rng = np.random.default_rng(2)
    pairs = rng.normal(size=(20000, 2))
    assert np.median(np.linalg.norm(pairs, axis=1)) == pytest.approx(MEDIAN_LENGTH, rel=0.02)
    for scale in (1.0, 30.0):
        assert 1 - within_gate(scale * pairs).mean() == pytest.approx(np.exp(-8), abs=4e-4)
    assert within_gate(0.001 * pairs + np.array([3.0, 0.0])).all()


@pytest.mark.parametrize(("square", "factor"), [(20.0, 1.0), (35.0, 1.0), (80.0, 2.0)])
def test_stated_errors_are_believed_unless_the_residuals_contradict_them(square: float, factor: float) -> None:
    assert error_factor(square, 20.0) == factor
    assert error_factor(square, 0.5) == 1.0


def random_pose(rng: np.random.Generator) -> RigidTransform:
    return RigidTransform.from_components(rng.normal(0, 1, 3), Rotation.random(rng=rng))


def bearings_of(pose: RigidTransform, points: FloatArray, rng: np.random.Generator, noise: float) -> FloatArray:
    rays = pose.apply(points)
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    rays += rng.normal(0, noise, rays.shape)
    return np.asarray(rays / np.linalg.norm(rays, axis=1, keepdims=True))


def off(pose: RigidTransform, other: RigidTransform) -> tuple[float, float]:
    moved = float(np.linalg.norm(pose.inv().translation - other.inv().translation))
    return moved, float((pose * other.inv()).rotation.magnitude())


@pytest.mark.parametrize("seed", range(20))
def test_points_all_around_give_the_pose(seed: int) -> None:
    rng = np.random.default_rng(seed)
    pose, points = random_pose(rng), rng.uniform(-4, 4, (12, 3))
    found = present(pose_from_bearings(points, bearings_of(pose, points, rng, 0.0)))
    assert max(off(found, pose)) < 1e-9


@pytest.mark.parametrize("seed", range(20))
def test_points_in_a_plane_give_the_pose_in_any_direction(seed: int) -> None:
    rng = np.random.default_rng(seed)
    grid = np.array([[x, y, 0.0] for x in range(4) for y in range(3)]) * 0.1
    place = Rotation.random(rng=rng).apply([2.0, 0.0, 0.0])
    pose = RigidTransform.from_components(place, Rotation.random(rng=rng))
    found = present(pose_from_bearings(grid, bearings_of(pose, grid, rng, 0.0)))
    assert max(off(found, pose)) < 1e-6


def test_with_noise_the_start_is_near_and_the_refinement_nearer() -> None:
    rng = np.random.default_rng(3)
    starts, refined = [], []
    for _ in range(20):
        pose, points = random_pose(rng), rng.uniform(-3, 3, (30, 3))
        bearings = bearings_of(pose, points, rng, np.radians(0.1))
        found = present(pose_from_bearings(points, bearings))
        sigma = np.full(30, np.radians(0.1))
        better = refine_pose(found, points, bearings, np.zeros((30, 3)), sigma)
        starts.append(off(found, pose)[1])
        refined.append(off(better, pose)[1])
    assert np.median(starts) < np.radians(1.0)
    assert np.median(refined) < min(float(np.median(starts)), float(np.radians(0.1)))


@pytest.mark.parametrize(
    ("points", "mirror"),
    [
        (np.random.default_rng(3).normal(0, 1, (3, 3)), 1),
        (np.random.default_rng(5).normal(0, 1, (5, 3)), 1),
        (np.outer(np.arange(8.0), [1.0, 2.0, 3.0]), 1),
        (np.random.default_rng(1).uniform(-3, 3, (20, 3)), -1),
    ],
    ids=["three", "five", "on a line", "mirrored"],
)
def test_too_few_points_a_line_and_mirrored_points_give_nothing(points: FloatArray, mirror: int) -> None:
    rng = np.random.default_rng(len(points))
    bearings = bearings_of(random_pose(rng), points, rng, 0.0)
    assert pose_from_bearings(points * [1, mirror, 1], bearings) is None


def test_tangent_axes_are_across_the_bearing_and_each_other() -> None:
    bearings = Rotation.random(50, rng=np.random.default_rng(2)).apply([1.0, 0.0, 0.0])
    frames = np.concatenate([tangent_axes(bearings), bearings[:, None]], axis=1)
    np.testing.assert_allclose(frames @ np.swapaxes(frames, 1, 2), np.broadcast_to(np.eye(3), (50, 3, 3)), atol=1e-12)


def test_cross_matrices_are_the_cross_product() -> None:
    a, b = np.random.default_rng(4).normal(size=(2, 10, 3))
    np.testing.assert_allclose(np.einsum("nij,nj->ni", cross_matrices(a), b), np.cross(a, b))
