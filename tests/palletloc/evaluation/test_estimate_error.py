import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from palletloc.evaluation.errors import TrueFace
from palletloc.evaluation.estimate import PalletEstimate, from_measurements, without_state
from palletloc.evaluation.estimate_error import COMPONENTS, EstimateError, estimate_error, offsets
from palletloc.geometry import FloatArray, LevelPose, level_pose
from palletloc.measurement import PalletMeasurement, YawSource

TRUE = LevelPose(1.0, 2.0, 0.1, 0.7)
SMALL = 1e-4 * np.eye(4)

angles = st.floats(-3.1, 3.1)
places = st.floats(-5, 5)


def compared(
    found: LevelPose, true: LevelPose = TRUE, covariance: FloatArray = SMALL, of_truth: FloatArray | None = None
) -> EstimateError:
    face = TrueFace("A", "t11", true, 2.0, 1.0, True)
    return estimate_error(1.5, PalletEstimate(1.5, "t11", found, covariance), face, of_truth)


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


def test_without_a_covariance_of_the_truth_both_nees_are_equal() -> None:
    error = compared(LevelPose(1.03, 2, 0.1, 0.7))
    assert error.nees == error.nees_with_truth > 0


def test_nees_is_four_on_average_only_with_the_uncertainty_of_the_truth() -> None:
    rng = np.random.default_rng(7)
    root, of_truth = rng.normal(size=(2, 4, 4)) * 0.01
    errors = []
    for _ in range(1500):
        surveyed = LevelPose(*(TRUE.as_array() + of_truth @ rng.normal(size=4)))
        found = LevelPose(*(TRUE.as_array() + root @ rng.normal(size=4)))
        errors.append(compared(found, surveyed, root @ root.T, of_truth @ of_truth.T))
    assert np.mean([one.nees_with_truth for one in errors]) == pytest.approx(4, abs=4 * np.sqrt(8 / 1500))
    assert np.mean([one.nees for one in errors]) > 6


def test_offsets_are_rows_in_the_order_of_the_components() -> None:
    errors = [compared(LevelPose(1, 2, 0.1 + off, 0.7)) for off in (0.01, 0.02)]
    assert offsets(errors)[:, COMPONENTS.index("height")] == pytest.approx([0.01, 0.02])
    assert offsets([]).shape == (0, 4)


def test_measurements_become_estimates_without_a_track() -> None:
    measured = PalletMeasurement(0.5, "t11", TRUE, SMALL, 0.9, YawSource.BOTTOM, "a.jpg")
    (one,) = from_measurements([measured])
    assert (one.time, one.model, one.forklift_from_pallet, one.file) == (0.5, "t11", TRUE, "a.jpg")
    assert (one.track, one.state) == ("", "")


def test_tentative_tracks_can_be_left_out() -> None:
    rows = [PalletEstimate(0.0, "t11", TRUE, SMALL, "1", state) for state in ("tentative", "confirmed", "coasting")]
    assert [one.state for one in without_state(rows)] == ["confirmed", "coasting"]
