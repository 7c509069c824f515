import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import minimize
from scipy.spatial.transform import RigidTransform, Rotation

from palletloc.evaluation.alignment import Alignment, align, posyaw, umeyama
from palletloc.evaluation.errors import EvaluationError
from palletloc.geometry import FloatArray

motions = st.tuples(*[st.floats(-3, 3)] * 6).map(
    lambda v: RigidTransform.from_components(v[:3], Rotation.from_rotvec(v[3:]))
)


def curved(n: int = 30, seed: int = 1, noise: float = 0.0) -> RigidTransform:
    rng = np.random.default_rng(seed)
    s = np.linspace(0, 1, n)
    positions = np.column_stack([4 * s, np.sin(4 * s), 0.3 * s**2]) + rng.normal(scale=noise, size=(n, 3))
    return RigidTransform.from_components(positions, Rotation.from_rotvec(np.outer(s, [0.1, -0.2, 1.5])))


def straight(n: int = 30, noise: float = 0.0) -> RigidTransform:
    rng = np.random.default_rng(2)
    positions = np.outer(np.linspace(0, 5, n), [1.0, 0.2, 0.0]) + rng.normal(scale=noise, size=(n, 3))
    return RigidTransform.from_components(positions, Rotation.identity(n))


def same(one: RigidTransform, other: RigidTransform) -> None:
    np.testing.assert_allclose(one.as_matrix(), other.as_matrix(), atol=1e-8)


@given(motions, st.sampled_from([Alignment.ORIGIN, Alignment.RIGID, Alignment.SIMILARITY]))
def test_a_rigid_motion_is_undone(motion: RigidTransform, method: Alignment) -> None:
    found = align(curved(), motion * curved(), method)
    same(found.estimate, curved())
    same(found.reference_from_estimate, motion.inv())
    assert found.scale == pytest.approx(1.0)
    assert found.method is method


@given(st.floats(-3, 3), st.floats(-3, 3), st.floats(-3, 3))
def test_a_turn_about_the_vertical_is_undone_on_a_straight_approach(x: float, z: float, yaw: float) -> None:
    motion = RigidTransform.from_components([x, 1.0, z], Rotation.from_euler("z", yaw))
    same(align(straight(), motion * straight(), Alignment.POSYAW).estimate, straight())


def test_no_alignment_leaves_all_as_it_is() -> None:
    same(align(straight(), curved(), Alignment.NONE).estimate, curved())


def test_the_origin_makes_the_first_poses_equal_and_no_other() -> None:
    found = align(curved(), curved(noise=0.1, seed=3), Alignment.ORIGIN)
    same(found.estimate[0], curved()[0])
    assert np.abs(found.estimate.translation[1:] - curved().translation[1:]).max() > 0.01


def test_a_scale_is_found_and_applied_to_positions_only() -> None:
    longer = RigidTransform.from_components(1.25 * curved().translation, curved().rotation)
    found = align(curved(), longer, Alignment.SIMILARITY)
    assert found.scale == pytest.approx(0.8)
    same(found.estimate, curved())
    assert align(curved(), longer, Alignment.RIGID).scale == 1.0


def cost(reference: FloatArray, estimate: FloatArray, motion: RigidTransform, scale: float = 1.0) -> float:
    return float(((motion.apply(scale * estimate) - reference) ** 2).sum())


@pytest.mark.parametrize("with_scale", [False, True])
def test_no_other_motion_fits_the_positions_better(with_scale: bool) -> None:
    a = np.asarray(curved(noise=0.1).translation)
    b = 1.2 * RigidTransform.from_rotation(Rotation.from_rotvec([0.4, 1.0, -0.3])).apply(curved(seed=5).translation)
    best, scale = umeyama(a, b, with_scale=with_scale)

    def off(v: FloatArray) -> float:
        change = RigidTransform.from_components(v[:3], Rotation.from_rotvec(v[3:6]))
        return cost(a, b, best * change, scale * (1 + v[6] * with_scale))

    searched = minimize(off, np.full(7, 0.01), method="Powell", options={"ftol": 1e-14, "xtol": 1e-10})
    assert cost(a, b, best, scale) <= searched.fun + 1e-12
    assert cost(a, b, best, scale) == pytest.approx(searched.fun, rel=1e-4)


def test_no_other_yaw_fits_the_positions_better() -> None:
    a, b = (np.asarray(curved(noise=0.2, seed=seed).translation) for seed in (1, 2))
    best = posyaw(a, b)
    yaws = np.linspace(-np.pi, np.pi, 20001)
    costs = []
    for yaw in yaws[::10]:
        turned = Rotation.from_euler("z", yaw).apply(b)
        costs.append(((turned - turned.mean(axis=0) - a + a.mean(axis=0)) ** 2).sum())
    assert cost(a, b, best) <= min(costs) + 1e-12
    assert best.rotation.as_rotvec()[2] == pytest.approx(yaws[::10][int(np.argmin(costs))], abs=4e-3)


def test_a_mirrored_estimate_gives_a_proper_rotation() -> None:
    a = np.asarray(curved(noise=0.3).translation)
    motion, _ = umeyama(a, a * [1, 1, -1])
    assert np.linalg.det(motion.rotation.as_matrix()) == pytest.approx(1)


@pytest.mark.parametrize("noise", [0.0, 0.01])
@pytest.mark.parametrize("method", [Alignment.RIGID, Alignment.SIMILARITY])
def test_a_straight_approach_is_refused_with_what_to_use_instead(method: Alignment, noise: float) -> None:
    other = RigidTransform.from_rotation(Rotation.from_rotvec([0.5, 0, 0])) * straight(noise=noise)
    with pytest.raises(EvaluationError, match=r"on a straight line.*use the alignment 'posyaw' or 'none'"):
        align(straight(), other, method)


def test_a_forklift_that_stands_still_is_refused() -> None:
    still = RigidTransform.from_translation(np.ones((5, 3)))
    with pytest.raises(EvaluationError, match="in one place"):
        align(still, still, Alignment.RIGID)
    with pytest.raises(EvaluationError, match="give no yaw; use the alignment 'origin' or 'none'"):
        align(still, still, Alignment.POSYAW)


def test_a_flat_curve_is_enough() -> None:
    flat = RigidTransform.from_components(curved().translation * [1, 1, 0], curved().rotation)
    motion = RigidTransform.from_components([1, 2, 3], Rotation.from_rotvec([0.2, 0.7, -0.4]))
    same(align(flat, motion * flat, Alignment.RIGID).estimate, flat)


def test_other_numbers_of_poses_are_refused() -> None:
    with pytest.raises(ValueError, match="as many poses of both, got 30 and 5"):
        align(curved(), curved(5), Alignment.NONE)
