import numpy as np
import pytest

from palletloc.evaluation.breakdown import by_distance, by_pallet, by_stop, by_track, distance_edges, spreads
from palletloc.evaluation.run_match import match_run
from tests.palletloc.evaluation.aisle import PALLETS, SCENE, TIMES, estimate, everything, false_one


def test_groups_hold_each_error_once() -> None:
    run = match_run(TIMES, everything(0.01), SCENE)
    pallets = by_pallet(run.errors)
    assert {name: len(group) for name, group in pallets.items()} == {"A": 4, "B": 4}
    bins = by_distance(run.shots, [0.0, 2.5, 3.0, np.inf])
    assert sum(len(part.errors) for part in bins) == 8
    for part in bins:
        assert all(part.low <= error.face.range < part.high for error in part.errors)


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


def test_a_bin_has_its_lower_edge_and_not_its_upper_one() -> None:
    run = match_run([0.0], everything()[:2], SCENE)
    near, far = (error.face.range for error in run.errors)
    assert [len(part.errors) for part in by_distance(run.shots, [0.0, near, far])] == [0, 1]


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
