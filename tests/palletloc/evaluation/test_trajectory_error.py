import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import logm
from scipy.spatial.transform import RigidTransform, Rotation

from palletloc.evaluation.errors import EvaluationError
from palletloc.evaluation.plane_projection import Plane, project
from palletloc.evaluation.step_pairs import StepPairs, pairs_by_count, pairs_by_distance
from palletloc.evaluation.trajectory_error import absolute_errors, distance_errors, relative_errors, statistics
from palletloc.geometry import FloatArray, LevelPose

PARTS = ("translation", "rotation", "rotation_part", "full")

motions = st.tuples(*[st.floats(-3, 3)] * 6).map(
    lambda v: RigidTransform.from_components(v[:3], Rotation.from_rotvec(v[3:]))
)
lengths = st.lists(st.floats(0.05, 1.0), min_size=1, max_size=15)


def wandering(seed: int, n: int = 12) -> RigidTransform:
    rng = np.random.default_rng(seed)
    steps = rng.normal(scale=0.3, size=(n, 3))
    return RigidTransform.from_components(steps.cumsum(axis=0), Rotation.from_rotvec(rng.normal(size=(n, 3))))


def by_hand(error: FloatArray) -> tuple[float, ...]:
    """Return all deviations of a (4, 4) matrix from the identity, by their definitions."""
    R, t = error[:3, :3], error[:3, 3]
    angle = float(np.linalg.norm(logm(R))) / np.sqrt(2)
    return (
        float(np.sqrt((t**2).sum())),
        angle,
        float(np.sqrt(((R - np.eye(3)) ** 2).sum())),
        float(np.sqrt(((error - np.eye(4)) ** 2).sum())),
    )


def along_x(gaps: list[float]) -> FloatArray:
    positions = np.zeros((len(gaps) + 1, 3))
    positions[1:, 0] = np.cumsum(gaps)
    return positions


def test_absolute_errors_are_those_of_plain_matrices() -> None:
    Q, P = wandering(1), wandering(2)
    found = absolute_errors(Q, P)
    for index in range(len(Q)):
        hand = by_hand(np.linalg.inv(Q[index].as_matrix()) @ P[index].as_matrix())
        assert [getattr(found, part)[index] for part in PARTS] == pytest.approx(hand, abs=1e-9)


def test_relative_errors_are_those_of_plain_matrices() -> None:
    Q, P = (path.as_matrix() for path in (wandering(1), wandering(2)))
    steps = pairs_by_count(len(Q), 3, all_pairs=True)
    found = relative_errors(wandering(1), wandering(2), steps)
    far = distance_errors(wandering(1), wandering(2), steps)
    for k, (i, j) in enumerate(zip(steps.first, steps.last, strict=True)):
        true, moved = np.linalg.inv(Q[i]) @ Q[j], np.linalg.inv(P[i]) @ P[j]
        hand = by_hand(np.linalg.inv(true) @ moved)
        assert [getattr(found, part)[k] for part in PARTS] == pytest.approx(hand, abs=1e-9)
        assert far[k] == pytest.approx(abs(np.linalg.norm(moved[:3, 3]) - np.linalg.norm(true[:3, 3])))


def test_perfect_estimates_have_no_error() -> None:
    path = wandering(3)
    for found in (absolute_errors(path, path), relative_errors(path, path, pairs_by_count(len(path), 2))):
        assert max(np.abs(getattr(found, part)).max() for part in PARTS) < 1e-9


@given(motions)
def test_a_common_rigid_motion_changes_no_error(motion: RigidTransform) -> None:
    Q, P = wandering(1), wandering(2)
    here, there = absolute_errors(Q, P), absolute_errors(motion * Q, motion * P)
    for part in PARTS:
        np.testing.assert_allclose(getattr(there, part), getattr(here, part), atol=1e-9)


@given(motions, motions)
def test_relative_errors_need_no_alignment(one: RigidTransform, other: RigidTransform) -> None:
    Q, P, steps = wandering(1), wandering(2), pairs_by_count(12, 1)
    here, there = relative_errors(Q, P, steps), relative_errors(one * Q, other * P, steps)
    for part in PARTS:
        np.testing.assert_allclose(getattr(there, part), getattr(here, part), atol=1e-9)


def test_a_known_drift_comes_back_per_step() -> None:
    # the estimate overstates each metre by 2 cm and turns by 0.01 rad too much
    true = RigidTransform.from_translation(along_x([1.0] * 6))
    found = [RigidTransform.identity()]
    for _ in range(6):
        found.append(found[-1] * RigidTransform.from_components([1.02, 0, 0], Rotation.from_euler("z", 0.01)))
    estimate = RigidTransform.concatenate(found)
    errors = relative_errors(true, estimate, pairs_by_count(7, 1))
    assert errors.translation == pytest.approx(np.full(6, 0.02))
    assert errors.rotation == pytest.approx(np.full(6, 0.01))


def consecutive(gaps: list[float], delta: float) -> list[tuple[int, int]]:
    """Return steps by walking along the path."""
    pairs: list[tuple[int, int]] = []
    begin = 0
    while True:
        for end in range(begin + 1, len(gaps) + 1):
            if sum(gaps[begin:end]) >= delta:
                break
        else:
            return pairs
        pairs.append((begin, end))
        begin = end


def listed(steps: StepPairs) -> list[tuple[int, int]]:
    return list(zip(steps.first.tolist(), steps.last.tolist(), strict=True))


def test_consecutive_steps_by_distance_reach_it_and_begin_where_the_last_ended() -> None:
    gaps = [0.5, 0.25, 0.5, 0.25, 0.25, 0.25, 0.5, 0.25]  # sums without rounding
    for delta in (0.25, 0.5, 0.75, 1.0, 2.0):
        assert listed(pairs_by_distance(along_x(gaps), delta)) == consecutive(gaps, delta)


def test_the_first_step_begins_at_the_first_pose() -> None:
    assert listed(pairs_by_distance(along_x([0.25] * 5), 0.5)) == [(0, 2), (2, 4)]


@given(lengths, st.floats(0.1, 2.0))
def test_all_steps_by_distance_are_the_nearest_ones_within_the_tolerance(gaps: list[float], delta: float) -> None:
    positions = along_x(gaps)
    expected = []
    for i in range(len(gaps)):
        off = [abs(positions[j, 0] - positions[i, 0] - delta) for j in range(i + 1, len(gaps) + 1)]
        if min(off) <= 0.1 * delta - 1e-9:
            expected.append((i, min(off)))
    try:
        steps = pairs_by_distance(positions, delta, all_pairs=True)
    except EvaluationError:
        assert expected == []
        return
    found = {i: abs(positions[j, 0] - positions[i, 0] - delta) for i, j in listed(steps)}
    assert all(size <= 0.1 * delta + 1e-9 for size in found.values())
    assert all(found[i] == pytest.approx(size, abs=1e-9) for i, size in expected)


def test_steps_by_count() -> None:
    assert listed(pairs_by_count(7, 3)) == [(0, 3), (3, 6)]
    assert listed(pairs_by_count(6, 3)) == [(0, 3)]
    assert listed(pairs_by_count(6, 3, all_pairs=True)) == [(0, 3), (1, 4), (2, 5)]


def test_steps_that_do_not_fit_are_refused() -> None:
    with pytest.raises(EvaluationError, match="no step of 3 poses in 3; expected a shorter step"):
        pairs_by_count(3, 3)
    for all_pairs in (False, True):
        with pytest.raises(EvaluationError, match="no step of 5 m in a path of 2 m"):
            pairs_by_distance(along_x([1.0, 1.0]), 5.0, all_pairs=all_pairs)
    with pytest.raises(EvaluationError, match="path of 0 m"):
        pairs_by_distance(np.zeros((1, 3)), 1.0, all_pairs=True)


def test_steps_that_are_not_positive_are_refused() -> None:
    with pytest.raises(ValueError, match="1 pose or more"):
        pairs_by_count(5, 0)
    with pytest.raises(ValueError, match="positive distance"):
        pairs_by_distance(along_x([1.0]), 0.0)


def test_statistics_are_their_definitions() -> None:
    found = statistics([1.0, 2.0, 6.0])
    assert (found.n, found.mean, found.median, found.minimum, found.maximum) == (3, 3, 2, 1, 6)
    assert (found.sse, found.rmse) == pytest.approx((41, np.sqrt(41 / 3)))
    assert found.std == pytest.approx(np.sqrt((4 + 1 + 9) / 3))
    with pytest.raises(ValueError, match="at least one"):
        statistics([])


@pytest.mark.parametrize("plane", Plane)
def test_a_projection_lies_in_its_plane_and_is_its_own(plane: Plane) -> None:
    flat = project(wandering(4), plane)
    axis = next(index for index, name in enumerate("xyz") if name not in str(plane))
    assert (flat.translation[:, axis] == 0).all()
    assert np.abs(np.delete(flat.rotation.as_rotvec(), axis, axis=1)).max() < 1e-12
    if plane is not Plane.XZ:  # the middle angle is at most a quarter turn
        np.testing.assert_allclose(project(flat, plane).as_matrix(), flat.as_matrix(), atol=1e-12)


def test_the_floor_keeps_a_level_pose() -> None:
    level = LevelPose(1.0, 2.0, 0.0, 2.5).transform()
    np.testing.assert_allclose(project(level, Plane.XY).as_matrix(), level.as_matrix(), atol=1e-12)
    tilted = level * RigidTransform.from_rotation(Rotation.from_euler("y", 0.3))
    np.testing.assert_allclose(project(tilted, Plane.XY).as_matrix(), level.as_matrix(), atol=1e-12)
