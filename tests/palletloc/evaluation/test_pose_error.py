import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import RigidTransform

from palletloc.evaluation.pose_error import (
    COMPONENTS,
    EvaluationError,
    PalletEstimate,
    PoseError,
    TrueFace,
    Visibility,
    from_measurements,
    offsets,
    pose_error,
    true_faces,
)
from palletloc.geometry import FloatArray, LevelPose, level_pose
from palletloc.io.truth import TruePallet
from palletloc.measurement import PalletMeasurement, YawSource

WIDTHS = {"t11": 1.1}
CAMERA = RigidTransform.from_translation([0.3, 0.0, 1.8])
AT_HOME = LevelPose(0.0, 0.0, 0.0, 0.0)
TRUE = LevelPose(1.0, 2.0, 0.1, 0.7)
SMALL = 1e-4 * np.eye(4)

angles = st.floats(-3.1, 3.1)
places = st.floats(-5, 5)


def compared(
    found: LevelPose, true: LevelPose = TRUE, covariance: FloatArray = SMALL, of_truth: FloatArray | None = None
) -> PoseError:
    face = TrueFace("A", "t11", true, 2.0, 1.0, True)
    return pose_error(1.5, PalletEstimate(1.5, "t11", found, covariance), face, of_truth)


def turned(covariance: FloatArray, yaw: float) -> FloatArray:
    turn = LevelPose(0, 0, 0, yaw).matrix()
    turn[:3, 3] = 0
    return np.asarray(turn @ covariance @ turn.T)


@given(places, places, angles)
def test_a_perfect_estimate_has_no_error(x: float, y: float, yaw: float) -> None:
    perfect = compared(LevelPose(x, y, 0.1, yaw), LevelPose(x, y, 0.1, yaw))
    assert perfect.offset.tolist() == perfect.normalised.tolist() == [0, 0, 0, 0]
    assert perfect.nees == perfect.nees_with_truth == 0


@given(angles, st.sampled_from(range(4)), st.sampled_from([-0.03, 0.02]))
def test_a_known_offset_comes_back_in_its_component_with_its_sign(yaw: float, component: int, off: float) -> None:
    true = LevelPose(1.0, 2.0, 0.1, yaw)
    pallet_from_found = LevelPose(*(off if index == component else 0.0 for index in range(4)))
    found = level_pose(true.transform() * pallet_from_found.transform())
    expected = np.zeros(4)
    expected[component] = off
    assert compared(found, true).offset == pytest.approx(expected, abs=1e-12)


@given(places, places, angles)
def test_a_common_rigid_motion_changes_nothing(x: float, y: float, turn: float) -> None:
    rng = np.random.default_rng(6)
    root, of_truth = rng.normal(size=(2, 4, 4)) * 0.01
    found = LevelPose(1.02, 1.97, 0.11, 0.73)
    elsewhere = LevelPose(x, y, 0.3, turn).transform()
    here = compared(found, TRUE, root @ root.T, of_truth @ of_truth.T)
    there = compared(
        level_pose(elsewhere * found.transform()),
        level_pose(elsewhere * TRUE.transform()),
        turned(root @ root.T, turn),
        turned(of_truth @ of_truth.T, turn),
    )
    for name in ("offset", "normalised", "nees", "nees_with_truth"):
        assert getattr(there, name) == pytest.approx(getattr(here, name), rel=1e-5, abs=1e-7)


def test_the_sigmas_are_of_the_pallets_own_axes() -> None:
    # the pallet looks along the forklift's y: its depth is y, its width is x
    sigmas = np.array([0.01, 0.02, 0.03, 0.04])
    error = compared(LevelPose(1, 2, 0, np.pi / 2), LevelPose(1, 2, 0, np.pi / 2), np.diag(sigmas**2))
    assert np.sqrt(np.diag(error.covariance)) == pytest.approx([0.02, 0.01, 0.03, 0.04])


def test_the_uncertainty_of_the_truth_adds_to_that_of_the_estimate() -> None:
    found = LevelPose(1 + 0.05, 2, 0.1, 0.0)
    error = compared(found, LevelPose(1, 2, 0.1, 0.0), np.eye(4) * 0.03**2, np.eye(4) * 0.04**2)
    assert error.normalised == pytest.approx([1, 0, 0, 0])
    assert (error.nees, error.nees_with_truth) == pytest.approx(((5 / 3) ** 2, 1))
    alone = compared(LevelPose(1.03, 2, 0.1, 0.7))
    assert alone.nees == alone.nees_with_truth > 0


def test_errors_are_in_the_pallets_own_axes() -> None:
    # a pallet to the left: its x points along the forklift's y, its y along -x
    error = compared(LevelPose(1.02, 2.03, 0.14, np.pi / 2 - 0.05), LevelPose(1.0, 2.0, 0.1, np.pi / 2))
    assert (error.depth, error.along, error.height, error.yaw) == pytest.approx((0.03, -0.02, 0.04, -0.05))
    # and yaw errors take the short way
    assert compared(LevelPose(1, 1, 0, -3.1), LevelPose(1, 1, 0, 3.1)).yaw == pytest.approx(2 * np.pi - 6.2)


def test_nees_counts_each_error_in_its_own_sigma() -> None:
    sigma = np.array([0.01, 0.02, 0.005, 0.003])
    off = LevelPose(1 + 0.01, 2 - 2 * 0.02, 0.0, 0.5 + 3 * 0.003)
    assert compared(off, LevelPose(1, 2, 0, 0.5), np.diag(sigma**2)).nees == pytest.approx(1 + 4 + 9)


def test_nees_is_four_on_average_only_with_the_uncertainty_of_the_truth() -> None:
    rng = np.random.default_rng(7)
    root, of_truth = rng.normal(size=(2, 4, 4)) * 0.01
    errors = []
    for _ in range(1500):
        surveyed = LevelPose(*(TRUE.as_array() + of_truth @ rng.normal(size=4)))
        found = LevelPose(*(TRUE.as_array() + root @ rng.normal(size=4)))
        errors.append(compared(found, surveyed, root @ root.T, of_truth @ of_truth.T))
    assert np.mean([error.nees_with_truth for error in errors]) == pytest.approx(4, abs=4 * np.sqrt(8 / 1500))
    assert np.mean([error.nees for error in errors]) > 6


def test_a_covariance_that_is_none_has_no_finite_nees() -> None:
    for worst in (0.0, -1e-6):
        assert compared(AT_HOME, AT_HOME, np.diag([1e-4, 1e-4, 1e-4, worst])).nees == np.inf


def test_the_right_model_is_told_from_another() -> None:
    face = TrueFace("A", "t11", TRUE, 2.0, 1.0, True)
    for model, same in (("t11", True), ("epal1-800", False)):
        assert pose_error(0.0, PalletEstimate(0.0, model, TRUE, SMALL), face).same_model is same


def test_offsets_are_rows_in_the_order_of_the_components() -> None:
    errors = [compared(LevelPose(1, 2, 0.1 + off, 0.7)) for off in (0.01, 0.02)]
    assert offsets(errors)[:, COMPONENTS.index("height")] == pytest.approx([0.01, 0.02])
    assert offsets([]).shape == (0, 4)


def test_measurements_become_estimates_without_a_track() -> None:
    measured = PalletMeasurement(0.5, "t11", TRUE, SMALL, 0.9, YawSource.BOTTOM, "a.jpg")
    (found,) = from_measurements([measured])
    assert (found.time, found.model, found.forklift_from_pallet, found.file) == (0.5, "t11", TRUE, "a.jpg")
    assert (found.track, found.state) == ("", "")


def seen(pose: LevelPose, visibility: Visibility | None = None) -> TrueFace:
    return true_faces([TruePallet("A", "t11", pose)], WIDTHS, AT_HOME, CAMERA, visibility)[0]


def test_faces_stand_where_the_forklift_sees_them() -> None:
    # the forklift looks along world y; the pallet is 2 m ahead and 1 m to its left
    home = LevelPose(5.0, 1.0, 0.0, np.pi / 2)
    pallet = TruePallet("A", "t11", LevelPose(4.0, 3.0, 0.2, np.pi))
    (face,) = true_faces([pallet], WIDTHS, home, CAMERA)
    assert face.forklift_from_pallet.as_array() == pytest.approx([2.0, 1.0, 0.2, np.pi / 2])
    assert face.below == pytest.approx(1.6)
    assert face.range == pytest.approx(np.sqrt(1.7**2 + 1.0 + 1.6**2))


@pytest.mark.parametrize("side", [1, -1])
def test_visible_is_what_lies_wholly_beside_the_camera(side: int) -> None:
    yaw = side * np.pi / 2
    assert seen(LevelPose(1.3, side * 2.0, 0.0, yaw)).visible
    assert not seen(LevelPose(4.9, side * 2.0, 0.0, yaw)).visible  # too far
    assert seen(LevelPose(4.9, side * 2.0, 0.0, yaw), Visibility(max_range=9)).visible
    # ends at 0.55 m before and behind: 116 degrees lie at 0.976 m behind the camera's side
    assert seen(LevelPose(0.3 - 0.40, side * 2.0, 0.0, yaw)).visible
    assert not seen(LevelPose(0.3 - 0.45, side * 2.0, 0.0, yaw)).visible
    # right ahead, one end is on the other side
    assert not seen(LevelPose(3.0, side * 0.5, 0.0, 0.0)).visible
    # the range counts from the camera to the middle of the lower edge
    pose = LevelPose(0.3, side * 2.0, 1.8, yaw)
    assert [seen(pose, Visibility(max_range=reach)).visible for reach in (2.001, 1.999)] == [True, False]


def test_a_model_without_a_width_is_named() -> None:
    with pytest.raises(EvaluationError, match=r"'A': unknown model 't11'; did you mean 't11x'\?"):
        true_faces([TruePallet("A", "t11", AT_HOME)], {"t11x": 1.1}, AT_HOME, CAMERA)
