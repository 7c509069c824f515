import numpy as np
import pytest

from palletloc.evaluation.iso9283 import stop_accuracy


def test_a_hand_made_square() -> None:
    # four corners of a square of 2 cm about (3, 4) cm: all are sqrt(2) cm from the middle
    corners = np.array([[2, 3], [4, 3], [4, 5], [2, 5]]) / 100
    offsets = np.column_stack([corners, np.zeros(4), [0.01, 0.03, 0.01, 0.03]])
    stop = stop_accuracy(offsets)
    assert stop.n == 4
    assert stop.mean == pytest.approx([0.03, 0.04, 0.0])
    assert stop.ap == pytest.approx(0.05)
    assert stop.rp == pytest.approx(np.sqrt(2) / 100)  # no scatter of the distances
    assert stop.ap_yaw == pytest.approx(0.02)
    assert stop.rp_yaw == pytest.approx(3 * np.sqrt(4 * 0.01**2 / 3))


def test_distances_that_scatter_count_threefold() -> None:
    # on a line at 0, 0, 0 and 4 cm: 1, 1, 1 and 3 cm from the middle, with a standard deviation of 1 cm
    offsets = np.zeros((4, 4))
    offsets[3, 0] = 0.04
    assert stop_accuracy(offsets).rp == pytest.approx(0.015 + 3 * 0.01)


def test_a_common_shift_moves_the_accuracy_alone() -> None:
    offsets = np.random.default_rng(1).normal(scale=0.01, size=(30, 4))
    here, there = stop_accuracy(offsets), stop_accuracy(offsets + np.array([0.1, 0, 0, -0.2]))
    assert (there.rp, there.rp_yaw) == pytest.approx((here.rp, here.rp_yaw))
    assert there.ap_yaw == pytest.approx(here.ap_yaw - 0.2)
    assert there.mean == pytest.approx(here.mean + np.array([0.1, 0, 0]))


def test_yaw_errors_about_half_a_turn_do_not_cancel() -> None:
    offsets = np.zeros((2, 4))
    offsets[:, 3] = np.pi - 0.01, -np.pi + 0.01
    stop = stop_accuracy(offsets)
    assert abs(stop.ap_yaw) == pytest.approx(np.pi)
    assert stop.rp_yaw == pytest.approx(3 * 0.01 * np.sqrt(2))


def test_a_single_pose_has_an_accuracy_and_no_repeatability() -> None:
    stop = stop_accuracy(np.array([[0.0, 0.03, 0.04, 0.1]]))
    assert (stop.ap, stop.ap_yaw) == pytest.approx((0.05, 0.1))
    assert np.isnan([stop.rp, stop.rp_yaw]).all()


@pytest.mark.parametrize("shape", [(0, 4), (4,), (3, 3)])
def test_other_shapes_are_refused(shape: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match=r"expected \(n, 4\)"):
        stop_accuracy(np.zeros(shape))
