import numpy as np
import pytest

from palletloc.evaluation.breakdown import (
    by_distance,
    by_pallet,
    by_stop,
    by_track,
    distance_edges,
    spreads,
    stop_accuracy,
)
from palletloc.evaluation.comparison import compare_runs, paired_difference
from palletloc.evaluation.pose_error import PalletEstimate, PoseError, TrueFace, pose_error
from palletloc.evaluation.run_match import match_run
from palletloc.geometry import LevelPose
from tests.palletloc.evaluation.aisle import PALLETS, SCENE, TIMES, estimate, everything, false_one


def test_groups_hold_each_error_once_and_a_bin_has_its_lower_edge_and_not_its_upper_one() -> None:
    run = match_run(TIMES, everything(0.01), SCENE)
    assert {name: len(group) for name, group in by_pallet(run.errors).items()} == {"A": 4, "B": 4}
    bins = by_distance(run.shots, [0.0, 2.5, 3.0, np.inf])
    assert sum(len(part.errors) for part in bins) == 8
    for part in bins:
        assert all(part.low <= error.face.range < part.high for error in part.errors)
    near, far = (error.face.range for error in run.errors[:2])
    first = match_run([0.0], everything()[:2], SCENE)
    assert [len(part.errors) for part in by_distance(first.shots, [0.0, near, far])] == [0, 1]


def test_shots_belong_to_the_nearest_stop_within_the_limit() -> None:
    run = match_run(TIMES, everything(), SCENE)
    stops = by_stop(run.errors, {"S1": 0.1, "S2": 2.6}, limit=0.5)
    assert {key: [error.time for error in group] for key, group in stops.items()} == {
        ("S1", "A"): [0.0],
        ("S1", "B"): [0.0],
        ("S2", "A"): [3.0],
        ("S2", "B"): [3.0],
    }
    assert by_stop(run.errors, {}, limit=0.5) == {}


def test_bins_count_what_was_missed_at_that_distance() -> None:
    run = match_run(TIMES, [], SCENE)
    ranges = [face.range for shot in run.shots for face in shot.missed]
    near, far = by_distance(run.shots, [0.0, 3.0, np.inf])
    assert near.found.trials == sum(distance < 3 for distance in ranges) > 0
    assert near.found.trials + far.found.trials == 8
    assert near.found.successes == 0


def test_statistics_are_of_their_own_component() -> None:
    found = spreads(match_run(TIMES, everything(-0.01), SCENE).errors)
    assert found.depth is not None
    assert found.along is not None
    assert found.position is not None
    assert (found.depth.bias, found.depth.rms, found.along.maximum) == pytest.approx((-0.01, 0.01, 0.0))
    assert found.position.median == pytest.approx(0.01)
    assert spreads([]).yaw is None


def test_tracks_show_their_pallets_their_changes_and_what_was_false() -> None:
    rows = [
        estimate(0.0, PALLETS[0], track="1"),
        estimate(1.0, PALLETS[1], track="1"),
        estimate(2.0, PALLETS[0], track="1"),
        false_one(3.0, "1"),
        false_one(3.0, "2"),
        false_one(3.0),
    ]
    first, second = by_track(match_run(TIMES, rows, SCENE).shots)
    assert (first.track, first.pallets, len(first.errors), first.false) == ("1", ("A", "B", "A"), 3, 1)
    assert (second.track, second.pallets, second.errors, second.false) == ("2", (), (), 1)


def test_edges_that_do_not_increase_steps_that_are_not_positive_and_other_shapes_are_refused() -> None:
    for edges in ([1.0], [0.0, 2.0, 2.0], [3.0, 1.0]):
        with pytest.raises(ValueError, match="increasing"):
            by_distance([], edges)
    with pytest.raises(ValueError, match="positive"):
        distance_edges(0.0, 3.0)
    for shape in ((0, 4), (4,), (3, 3)):
        with pytest.raises(ValueError, match=r"expected \(n, 4\)"):
            stop_accuracy(np.zeros(shape))


def test_a_hand_made_square_and_distances_that_scatter_and_count_threefold() -> None:
    # four corners of a square of 2 cm about (3, 4) cm: all are sqrt(2) cm from the middle
    corners = np.array([[2, 3], [4, 3], [4, 5], [2, 5]]) / 100
    stop = stop_accuracy(np.column_stack([corners, np.zeros(4), [0.01, 0.03, 0.01, 0.03]]))
    assert stop.n == 4
    assert stop.mean == pytest.approx([0.03, 0.04, 0.0])
    assert stop.ap == pytest.approx(0.05)
    assert stop.rp == pytest.approx(np.sqrt(2) / 100)  # no scatter of the distances
    assert stop.ap_yaw == pytest.approx(0.02)
    assert stop.rp_yaw == pytest.approx(3 * np.sqrt(4 * 0.01**2 / 3))
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


def test_yaw_errors_about_half_a_turn_do_not_cancel_and_a_single_pose_has_no_repeatability() -> None:
    offsets = np.zeros((2, 4))
    offsets[:, 3] = np.pi - 0.01, -np.pi + 0.01
    stop = stop_accuracy(offsets)
    assert abs(stop.ap_yaw) == pytest.approx(np.pi)
    assert stop.rp_yaw == pytest.approx(3 * 0.01 * np.sqrt(2))
    stop = stop_accuracy(np.array([[0.0, 0.03, 0.04, 0.1]]))
    assert (stop.ap, stop.ap_yaw) == pytest.approx((0.05, 0.1))
    assert np.isnan([stop.rp, stop.rp_yaw]).all()


def error(time: float, name: str = "A", depth: float = 0.0, yaw: float = 0.0) -> PoseError:
    face = TrueFace(name, "t11", LevelPose(0, 0, 0, 0), 2.0, 1.0, True)
    return pose_error(time, PalletEstimate(time, "t11", LevelPose(depth, 0, 0, yaw), np.eye(4)), face)


def test_differences_are_of_absolute_errors_second_minus_first() -> None:
    first = [error(time, depth=-0.03) for time in range(4)]
    found = compare_runs(first, [error(time, depth=0.01) for time in range(4)])
    depth = found.differences["depth"]
    assert (depth.mean, depth.low, depth.high) == pytest.approx((-0.02, -0.02, -0.02))
    assert (depth.smaller, depth.larger, found.views, found.shots) == (4, 0, 4, 4)
    yaw = found.differences["yaw"]
    assert (yaw.mean, yaw.smaller, yaw.larger) == (0, 0, 0)


def test_views_that_one_run_lacks_are_listed_and_take_no_part() -> None:
    first = [error(0.0), error(1.0, "B", depth=9.0), error(1.0)]
    found = compare_runs(first, [error(1.0), error(0.0), error(2.0, depth=9.0)])
    assert (found.only_first, found.only_second) == (((1.0, "B"),), ((2.0, "A"),))
    assert (found.views, found.shots, found.differences["depth"].mean) == (2, 2, 0.0)


def test_swapping_the_runs_turns_the_sign() -> None:
    rng = np.random.default_rng(1)
    first, second = ([error(time, yaw=yaw) for time, yaw in enumerate(rng.normal(size=20))] for _ in range(2))
    there, back = (compare_runs(*runs).differences["yaw"] for runs in ((first, second), (second, first)))
    assert there.mean == pytest.approx(-back.mean)
    assert (there.smaller, there.larger) == (back.larger, back.smaller)
    assert there.low < there.mean < there.high


def test_the_same_seed_gives_the_same_interval_and_a_generator_goes_on() -> None:
    rng = np.random.default_rng(2)
    first, second = rng.normal(size=(2, 30))
    drawn = [paired_difference(first, second, np.arange(30), seed=seed) for seed in (5, 5, 6)]
    assert drawn[0] == drawn[1] != drawn[2]
    generator = np.random.default_rng(5)
    assert paired_difference(first, second, np.arange(30), seed=generator) == drawn[0]
    assert paired_difference(first, second, np.arange(30), seed=generator) != drawn[0]


def test_the_interval_covers_the_true_difference_at_the_nominal_rate() -> None:
    rng = np.random.default_rng(3)
    runs, views = 400, 40
    hits = 0
    for _ in range(runs):
        first, second = rng.exponential(1.0, views), rng.exponential(1.3, views)
        found = paired_difference(first, second, np.arange(views), 0.9, 400, rng)
        hits += found.low <= 0.3 <= found.high
    # four standard deviations of the count
    assert hits / runs == pytest.approx(0.9, abs=4 * np.sqrt(0.09 / runs))


def test_views_and_pallets_of_one_shot_are_drawn_together() -> None:
    of_shot = np.abs(np.random.default_rng(4).normal(size=25))
    alone = paired_difference(np.zeros(25), of_shot, np.arange(25))
    repeated = paired_difference(np.zeros(100), np.repeat(of_shot, 4), np.repeat(np.arange(25), 4))
    # four views that say the same are no four pieces of evidence
    assert repeated.high - repeated.low == pytest.approx(alone.high - alone.low, rel=1e-6)
    first = [error(time, name) for time in range(25) for name in "AB"]
    second = [error(time, name, depth=off) for time, off in enumerate(of_shot) for name in "AB"]
    depth = compare_runs(first, second).differences["depth"]
    assert (depth.low, depth.high) == pytest.approx((alone.low, alone.high))


def test_a_single_shot_has_no_interval_and_runs_without_a_common_view_no_difference() -> None:
    alone = paired_difference(np.zeros(3), np.ones(3), np.zeros(3))
    assert alone.mean == 1.0
    assert np.isnan([alone.low, alone.high]).all()
    found = compare_runs([error(0.0)], [])
    assert (found.views, found.differences, found.only_first) == (0, {}, ((0.0, "A"),))


def test_a_pallet_twice_in_a_shot_is_refused() -> None:
    with pytest.raises(ValueError, match="'A' stands twice in the shot at 0 s"):
        compare_runs([error(0.0), error(0.0)], [])
