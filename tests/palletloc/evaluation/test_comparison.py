import numpy as np
import pytest

from palletloc.evaluation.comparison import compare_runs, paired_difference
from palletloc.evaluation.pose_error import PalletEstimate, PoseError, TrueFace, pose_error
from palletloc.geometry import LevelPose


def error(time: float, name: str = "A", depth: float = 0.0, yaw: float = 0.0) -> PoseError:
    face = TrueFace(name, "t11", LevelPose(0, 0, 0, 0), 2.0, 1.0, True)
    return pose_error(time, PalletEstimate(time, "t11", LevelPose(depth, 0, 0, yaw), np.eye(4)), face)


def test_differences_are_of_absolute_errors_second_minus_first() -> None:
    first = [error(time, depth=-0.03) for time in range(4)]
    second = [error(time, depth=0.01) for time in range(4)]
    found = compare_runs(first, second)
    depth = found.differences["depth"]
    assert (depth.mean, depth.low, depth.high) == pytest.approx((-0.02, -0.02, -0.02))
    assert (depth.smaller, depth.larger, found.views, found.shots) == (4, 0, 4, 4)
    yaw = found.differences["yaw"]
    assert (yaw.mean, yaw.smaller, yaw.larger) == (0, 0, 0)


def test_views_that_one_run_lacks_are_listed_and_take_no_part() -> None:
    first = [error(0.0), error(1.0, "B", depth=9.0), error(1.0)]
    second = [error(1.0), error(0.0), error(2.0, depth=9.0)]
    found = compare_runs(first, second)
    assert (found.only_first, found.only_second) == (((1.0, "B"),), ((2.0, "A"),))
    assert (found.views, found.shots, found.differences["depth"].mean) == (2, 2, 0.0)


def test_swapping_the_runs_turns_the_sign() -> None:
    rng = np.random.default_rng(1)
    first, second = ([error(time, yaw=yaw) for time, yaw in enumerate(rng.normal(size=20))] for _ in range(2))
    one, other = (compare_runs(*runs).differences["yaw"] for runs in ((first, second), (second, first)))
    assert one.mean == pytest.approx(-other.mean)
    assert (one.smaller, one.larger) == (other.larger, other.smaller)
    assert one.low < one.mean < one.high


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


def test_views_of_one_shot_are_drawn_together() -> None:
    rng = np.random.default_rng(4)
    of_shot = rng.normal(size=25)
    alone = paired_difference(np.zeros(25), of_shot, np.arange(25))
    repeated = paired_difference(np.zeros(100), np.repeat(of_shot, 4), np.repeat(np.arange(25), 4))
    # four views that say the same are no four pieces of evidence
    assert repeated.high - repeated.low == pytest.approx(alone.high - alone.low, rel=1e-6)


def test_pallets_of_one_shot_are_drawn_together() -> None:
    offs = np.random.default_rng(5).normal(size=12)
    first = [error(time, name) for time in range(12) for name in "AB"]
    second = [error(time, name, depth=off) for time, off in enumerate(offs) for name in "AB"]
    depth = compare_runs(first, second).differences["depth"]
    alone = paired_difference(np.zeros(12), np.abs(offs), np.arange(12))
    assert (depth.low, depth.high) == pytest.approx((alone.low, alone.high))


def test_a_single_shot_has_no_interval() -> None:
    found = paired_difference(np.zeros(3), np.ones(3), np.zeros(3))
    assert found.mean == 1.0
    assert np.isnan([found.low, found.high]).all()


def test_runs_without_a_common_view_have_no_difference() -> None:
    found = compare_runs([error(0.0)], [])
    assert (found.views, found.differences, found.only_first) == (0, {}, ((0.0, "A"),))


def test_a_pallet_twice_in_a_shot_is_refused() -> None:
    with pytest.raises(ValueError, match="'A' stands twice in the shot at 0 s"):
        compare_runs([error(0.0), error(0.0)], [])
