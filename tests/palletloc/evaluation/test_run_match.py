from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from palletloc.evaluation.breakdown import by_distance, by_pallet, by_stop, by_track, distance_edges, spreads
from palletloc.evaluation.errors import EvaluationError, Sight
from palletloc.evaluation.estimate import PalletEstimate
from palletloc.evaluation.run_match import RunMatch, TrueScene, match_run
from palletloc.evaluation.shot_match import detection
from palletloc.evaluation.time_pairing import TimeRule
from palletloc.geometry import FloatArray, LevelPose, level_pose
from palletloc.trajectory import Trajectory

TIMES = [0.0, 1.0, 2.0, 3.0]
PATH = Trajectory(*np.array([TIMES, [0.0, 0.5, 1.0, 1.5], [0.0] * 4, [0.0] * 4]))


@dataclass(frozen=True)
class Standing:
    """A true pallet, to the left of the path."""

    id: str
    model: str
    world_from_pallet: LevelPose


PALLETS = (
    Standing("A", "t11", LevelPose(2.0, 1.8, 0.1, np.pi / 2)),
    Standing("B", "t11", LevelPose(3.5, 1.8, 0.1, np.pi / 2)),
)
SCENE = TrueScene(PATH, PALLETS, {"t11": 1.1}, RigidTransform.from_translation([0.3, 0, 1.8]), Sight(max_range=9.0))


def estimate(time: float, place: Standing, off: float = 0.0, track: str = "", yaw: float = 0.0) -> PalletEstimate:
    """Return what a run says of a pallet, ``off`` metres too deep."""
    forklift_from_world = PATH.pose_at(time).transform().inv()
    pose = level_pose(
        forklift_from_world * place.world_from_pallet.transform() * LevelPose(off, 0, 0, yaw).transform()
    )
    return PalletEstimate(time, "t11", pose, 1e-4 * np.eye(4), track)


def false_one(time: float, track: str = "") -> PalletEstimate:
    return PalletEstimate(time, "t11", LevelPose(-5.0, -5.0, 0.0, 0.0), np.eye(4), track)


def everything(off: float = 0.0) -> list[PalletEstimate]:
    return [estimate(time, place, off, place.id) for time in TIMES for place in PALLETS]


def ids(run: RunMatch) -> list[tuple[float, str]]:
    return [(one.time, one.error.face.id) for one in run.errors]


def test_a_perfect_run_has_every_pallet_and_no_error() -> None:
    run = match_run(TIMES, everything(), SCENE)
    assert ids(run) == [(time, name) for time in TIMES for name in "AB"]
    assert max(np.abs(one.offset).max() for one in run.errors) < 1e-12
    found = detection(run.shots)
    assert (found.recall, found.false_per_shot, found.shots) == (1.0, 0.0, 4)


def test_missed_and_false_ones_are_counted() -> None:
    rows = [one for one in everything() if (one.time, one.track) != (1.0, "A")] + [false_one(2.0), false_one(2.0)]
    run = match_run(TIMES, rows, SCENE)
    found = detection(run.shots)
    assert (found.found.successes, found.found.trials, found.false) == (7, 8, 2)
    assert [[face.id for face in shot.missed] for shot in run.shots] == [[], ["A"], [], []]


def test_a_pallet_takes_one_estimate_and_the_second_is_false() -> None:
    run = match_run([0.0], [estimate(0.0, PALLETS[0], 0.02), estimate(0.0, PALLETS[0], 0.01)], SCENE)
    assert [one.error.depth for one in run.errors] == pytest.approx([0.01])
    assert len(run.shots[0].false) == 1


def test_a_pallet_beyond_sight_counts_neither_way() -> None:
    scene = replace(SCENE, sight=Sight(max_range=1e-3))
    run = match_run([0.0], [estimate(0.0, PALLETS[0])], scene)
    assert (run.errors, run.shots[0].missed, run.shots[0].false) == ((), (), ())
    assert [one.error.face.id for one in run.shots[0].beyond] == ["A"]


def test_shots_without_a_near_truth_are_left_out_and_listed() -> None:
    scene = replace(SCENE, world_from_forklift=Trajectory(*np.array([[0.001, 2.0], [0, 1], [0, 0], [0, 0]])))
    run = match_run(TIMES, everything(), scene)
    assert [shot.time for shot in run.shots] == [0.0, 2.0]
    assert run.without_truth == (1.0, 3.0)
    assert (run.rule, run.limit, run.largest) == (TimeRule.NEAREST, 0.01, 0.001)


def test_truth_is_interpolated_only_where_asked_and_never_outside() -> None:
    sparse = Trajectory(*np.array([[0.0, 2.0], [0.0, 1.0], [0.0, 0.0], [0.0, 0.0]]))
    scene = replace(SCENE, world_from_forklift=sparse)
    run = match_run(TIMES, everything(), scene, TimeRule.INTERPOLATED, limit=2.0)
    assert [shot.time for shot in run.shots] == [0.0, 1.0, 2.0]
    assert run.without_truth == (3.0,)
    assert (run.rule, run.limit, run.largest) == (TimeRule.INTERPOLATED, 2.0, 1.0)
    assert max(np.abs(one.offset).max() for one in run.errors) < 1e-12
    assert len(match_run(TIMES, everything(), scene, TimeRule.INTERPOLATED, limit=1.9).shots) == 2


def test_the_nearest_sample_is_taken_as_it_is() -> None:
    moved = Trajectory(*np.array([[0.004, 1.0], [0.0, 1.0], [0.0, 0.0], [0.0, 0.0]]))
    run = match_run([0.0], [estimate(0.0, PALLETS[0])], replace(SCENE, world_from_forklift=moved))
    assert run.errors[0].offset == pytest.approx(np.zeros(4), abs=1e-12)


def test_a_truth_of_another_time_is_one_clear_error() -> None:
    late = Trajectory(PATH.times + 100, PATH.x, PATH.y, PATH.yaw)
    with pytest.raises(EvaluationError, match="shots from 0 s to 3 s, truth from 100 s to 103 s: expected times"):
        match_run(TIMES, everything(), replace(SCENE, world_from_forklift=late))


def test_an_estimate_of_no_shot_is_refused() -> None:
    with pytest.raises(EvaluationError, match=r"0\.5 s is of no shot"):
        match_run(TIMES, [estimate(0.5, PALLETS[0])], SCENE)


def test_an_empty_run_misses_everything() -> None:
    found = detection(match_run(TIMES, [], SCENE).shots)
    assert (found.recall, found.found.trials) == (0.0, 8)


def test_the_truth_states_its_covariance_where_it_has_one() -> None:
    def stated(time: float, name: str) -> FloatArray | None:
        return 1e-6 * (1 + time) * np.eye(4) if name == "A" else None

    run = match_run(TIMES, everything(), replace(SCENE, covariance=stated))
    for one in run.errors:
        if one.error.face.id == "B":
            assert one.truth_covariance is None
        else:
            assert one.truth_covariance == pytest.approx(1e-6 * (1 + one.time) * np.eye(4))


def test_groups_hold_each_error_once() -> None:
    run = match_run(TIMES, everything(0.01), SCENE)
    pallets = by_pallet(run.errors)
    assert {name: len(group) for name, group in pallets.items()} == {"A": 4, "B": 4}
    bins = by_distance(run.shots, [0.0, 2.5, 3.0, np.inf])
    assert sum(len(one.errors) for one in bins) == 8
    for one in bins:
        assert all(one.low <= error.error.face.range < one.high for error in one.errors)


def test_shots_belong_to_the_nearest_stop_within_the_limit() -> None:
    run = match_run(TIMES, everything(), SCENE)
    stops = by_stop(run.errors, {"S1": 0.1, "S2": 2.6}, limit=0.5)
    assert {key: [one.time for one in group] for key, group in stops.items()} == {
        ("S1", "A"): [0.0],
        ("S1", "B"): [0.0],
        ("S2", "A"): [3.0],
        ("S2", "B"): [3.0],
    }
    assert by_stop(run.errors, {}, limit=0.5) == {}


def test_a_bin_has_its_lower_edge_and_not_its_upper_one() -> None:
    run = match_run([0.0], everything()[:2], SCENE)
    near, far = (one.error.face.range for one in run.errors)
    assert [len(one.errors) for one in by_distance(run.shots, [0.0, near, far])] == [0, 1]


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


def test_nothing_has_no_statistics() -> None:
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


@pytest.mark.parametrize("edges", [[1.0], [0.0, 2.0, 2.0], [3.0, 1.0]])
def test_edges_that_do_not_increase_are_refused(edges: list[float]) -> None:
    with pytest.raises(ValueError, match="increasing"):
        by_distance([], edges)


def test_a_step_that_is_not_positive_is_refused() -> None:
    with pytest.raises(ValueError, match="positive"):
        distance_edges(0.0, 3.0)
