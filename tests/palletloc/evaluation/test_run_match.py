import dataclasses
import importlib.util
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from palletloc.choices import TimeRule
from palletloc.evaluation.breakdown import spreads
from palletloc.evaluation.pose_error import (
    EvaluationError,
    PalletEstimate,
    TrueFace,
    Visibility,
    from_measurements,
    true_faces,
)
from palletloc.evaluation.run_match import ShotMatch, TrueScene, detection, match_run, match_shot
from palletloc.evaluation.time_pairing import brackets, nearest_pairs, require_overlap
from palletloc.geometry import FloatArray, LevelPose
from palletloc.io.measurements import read_measurements, write_measurements
from palletloc.io.recording import read_recording
from palletloc.io.truth import read_truth
from palletloc.measurement import PalletMeasurement, YawSource
from palletloc.trajectory import Trajectory
from tests.palletloc.evaluation.aisle import PALLETS, PATH, SCENE, TIMES, estimate, everything, false_one

SHARED = Path(__file__).resolve().parents[3].parent / "shared"


def at(pose: LevelPose) -> PalletEstimate:
    return PalletEstimate(0.0, "t11", pose, np.eye(4))


def face(pose: LevelPose, name: str = "A", visible: bool = True) -> TrueFace:
    return TrueFace(name, "t11", pose, 2.0, 1.8 - pose.z, visible)


def test_the_closest_pairs_go_first_nothing_is_taken_twice_and_half_a_metre_off_belongs_to_nothing() -> None:
    faces = [face(LevelPose(0.0, 2, 0, 0), "A"), face(LevelPose(0.4, 2, 0, 0), "B")]
    # the first estimate is nearer to B, which the second one has
    shot = match_shot(0.0, [at(LevelPose(0.3, 2, 0, 0)), at(LevelPose(0.41, 2, 0, 0))], faces)
    found = {error.face.id: error.estimate.forklift_from_pallet.x for error in shot.errors}
    assert found == {"A": 0.3, "B": 0.41}
    faces = [face(LevelPose(0, 2, 0, 0))]
    near, off = (match_shot(0.0, [at(LevelPose(0.3, 2, height, 0))], faces) for height in (0.39, 0.41))
    assert (len(near.errors), len(off.errors), len(off.missed), len(off.false)) == (1, 0, 1, 1)


def test_a_shot_has_found_missed_and_false_ones() -> None:
    faces = [face(LevelPose(x, 2, 0, 0), name) for x, name in ((0, "A"), (2, "B"))]
    shot = match_shot(1.5, [at(LevelPose(x, 2, 0, 0)) for x in (0.01, 0.1, 8)], faces)
    assert [(error.face.id, error.time) for error in shot.errors] == [("A", 1.5)]
    assert shot.errors[0].depth == pytest.approx(0.01)
    assert [face.id for face in shot.missed] == ["B"]
    assert [estimate.forklift_from_pallet.x for estimate in shot.false] == [0.1, 8]


def test_a_pallet_that_need_not_be_found_is_neither_missed_nor_false() -> None:
    hidden = face(LevelPose(0, 2, 0, 0), visible=False)
    for found in ([], [at(hidden.forklift_from_pallet)]):
        shot = match_shot(0.0, found, [hidden])
        assert (shot.errors, shot.missed, shot.false) == ((), (), ())


def test_the_truth_states_its_covariance_where_it_has_one() -> None:
    faces = [face(LevelPose(x, 2, 0, 0), name) for x, name in ((0, "A"), (2, "B"))]
    known: dict[str, FloatArray] = {"A": 1e-6 * np.eye(4)}
    of_a, of_b = match_shot(0.0, [at(LevelPose(x, 2, 0, 0)) for x in (0, 2)], faces, known).errors
    assert of_a.truth_covariance == pytest.approx(1e-6 * np.eye(4))
    assert of_b.truth_covariance is None


def test_nothing_to_count_gives_no_rate() -> None:
    assert np.isnan([detection([]).recall, detection([]).false_per_shot]).all()
    missed = detection([ShotMatch(0.0, (), (), (face(LevelPose(0, 2, 0, 0)),) * 2, ())])
    assert (missed.recall, missed.found.trials) == (0.0, 2)


def test_a_perfect_run_has_every_pallet_and_no_error_and_an_empty_one_misses_all() -> None:
    run = match_run(TIMES, everything(), SCENE)
    assert [(error.time, error.face.id) for error in run.errors] == [(time, name) for time in TIMES for name in "AB"]
    assert max(np.abs(error.offset).max() for error in run.errors) < 1e-12
    found = detection(run.shots)
    assert (found.recall, found.false_per_shot, found.shots) == (1.0, 0.0, 4)
    nothing = detection(match_run(TIMES, [], SCENE).shots)
    assert (nothing.recall, nothing.found.trials) == (0.0, 8)


def test_missed_and_false_ones_are_counted_and_a_second_estimate_of_a_pallet_is_false() -> None:
    rows = [row for row in everything() if (row.time, row.track) != (1.0, "A")] + [false_one(2.0), false_one(2.0)]
    run = match_run(TIMES, rows, SCENE)
    found = detection(run.shots)
    assert (found.found.successes, found.found.trials, found.false) == (7, 8, 2)
    assert [[face.id for face in shot.missed] for shot in run.shots] == [[], ["A"], [], []]
    run = match_run([0.0], [estimate(0.0, PALLETS[0], 0.02), estimate(0.0, PALLETS[0], 0.01)], SCENE)
    assert [error.depth for error in run.errors] == pytest.approx([0.01])
    assert len(run.shots[0].false) == 1


def test_a_pallet_beyond_sight_counts_neither_way() -> None:
    scene = replace(SCENE, visibility=Visibility(max_range=1e-3))
    run = match_run([0.0], [estimate(0.0, PALLETS[0])], scene)
    assert (run.errors, run.shots[0].missed, run.shots[0].false) == ((), (), ())
    assert [error.face.id for error in run.shots[0].beyond] == ["A"]


def test_the_nearest_truth_is_taken_as_it_is_and_shots_without_one_are_left_out_and_listed() -> None:
    scene = replace(SCENE, world_from_forklift=Trajectory(*np.array([[0.001, 2.0], [0, 1], [0, 0], [0, 0]])))
    run = match_run(TIMES, everything(), scene)
    assert [shot.time for shot in run.shots] == [0.0, 2.0]
    assert run.without_truth == (1.0, 3.0)
    assert run.largest == 0.001
    moved = Trajectory(*np.array([[0.004, 1.0], [0.0, 1.0], [0.0, 0.0], [0.0, 0.0]]))
    run = match_run([0.0], [estimate(0.0, PALLETS[0])], replace(SCENE, world_from_forklift=moved))
    assert run.errors[0].offset == pytest.approx(np.zeros(4), abs=1e-12)


def test_truth_is_interpolated_only_where_asked_and_never_outside() -> None:
    sparse = Trajectory(*np.array([[0.0, 2.0], [0.0, 1.0], [0.0, 0.0], [0.0, 0.0]]))
    scene = replace(SCENE, world_from_forklift=sparse)
    run = match_run(TIMES, everything(), scene, TimeRule.INTERPOLATED, limit=2.0)
    assert [shot.time for shot in run.shots] == [0.0, 1.0, 2.0]
    assert run.without_truth == (3.0,)
    assert run.largest == 1.0
    assert max(np.abs(error.offset).max() for error in run.errors) < 1e-12
    assert len(match_run(TIMES, everything(), scene, TimeRule.INTERPOLATED, limit=1.9).shots) == 2


def test_a_truth_of_another_time_and_an_estimate_of_no_shot_are_clear_errors() -> None:
    late = replace(SCENE, world_from_forklift=Trajectory(PATH.times + 100, PATH.x, PATH.y, PATH.yaw))
    with pytest.raises(EvaluationError, match="shots from 0 s to 3 s, truth from 100 s to 103 s: expected times"):
        match_run(TIMES, everything(), late)
    with pytest.raises(EvaluationError, match=r"0\.5 s is of no shot"):
        match_run(TIMES, [estimate(0.5, PALLETS[0])], SCENE)


def scorer() -> Any:
    spec = importlib.util.spec_from_file_location("score", SHARED / "tools/score.py")
    assert spec
    assert spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def disturbed(recording: Path, rng: np.random.Generator) -> list[PalletMeasurement]:
    """Return measurements of every true pallet with errors, some left out, and some of nothing."""
    truth, forklift_from_camera = read_truth(recording), read_recording(recording).forklift_from_camera
    found = []
    for shot in read_recording(recording).shots:
        place = truth.forklift.pose_at(shot.time)
        faces = true_faces(truth.pallets, {"t11-plastic": 1.1, "epal1-1200": 1.2}, place, forklift_from_camera)
        poses = [LevelPose(*(face.forklift_from_pallet.as_array() + 0.03 * rng.normal(size=4))) for face in faces]
        poses = [pose for pose in poses if rng.random() < 0.8]
        poses += [LevelPose(*rng.uniform(-3, 3, 4)) for _ in range(int(rng.integers(3)))]
        root = rng.normal(size=(4, 4)) * 0.03
        found += [
            PalletMeasurement(shot.time, faces[0].model, pose, root @ root.T, 0.9, YawSource.BOTTOM) for pose in poses
        ]
    return found


@pytest.mark.parametrize("name", ["dev_lab", "dev_warehouse"])
def test_another_implementation_counts_the_same(name: str, tmp_path: Path) -> None:
    recording = SHARED / "data" / name
    if not (recording.is_dir() and (SHARED / "tools/score.py").is_file()):
        pytest.skip("no recording or no scorer to compare with")
    found = disturbed(recording, np.random.default_rng(7))
    write_measurements(tmp_path / "measurements.csv", found)
    theirs, their_errors = scorer().score(recording, tmp_path)
    truth, read = read_truth(recording), read_recording(recording)
    widths = {model.name: model.width for model in read.models}
    scene = TrueScene(truth.forklift, truth.pallets, widths, read.forklift_from_camera)
    rows = from_measurements(
        row for row in read_measurements(tmp_path / "measurements.csv") if isinstance(row, PalletMeasurement)
    )
    run = match_run([shot.time for shot in read.shots], rows, scene, TimeRule.INTERPOLATED, np.inf)
    found_by_us, sizes = detection(run.shots), spreads(run.errors)
    assert found_by_us.found.trials == theirs["visible"]
    assert found_by_us.recall == pytest.approx(theirs["recall"])
    assert found_by_us.false_per_shot == pytest.approx(theirs["false_per_shot"])
    assert np.mean([error.nees for error in run.errors]) == pytest.approx(theirs["nees_mean"])
    for quantity, unit in (("yaw", np.degrees(1)), ("depth", 1e3), ("along", 1e3), ("height", 1e3)):
        spread = dataclasses.asdict(getattr(sizes, quantity))
        for mine, other in (("median", "median"), ("p95", "p95"), ("maximum", "max"), ("bias", "bias")):
            assert spread[mine] * unit == pytest.approx(theirs[quantity][other], rel=1e-6)
    assert [error.face.id for error in run.errors] == [row["id"] for row in their_errors]


series = st.lists(st.floats(0, 10), min_size=1, max_size=12).map(np.array)
ordered = st.lists(st.floats(0, 10), min_size=1, max_size=12, unique=True).map(sorted).map(np.array)
limits = st.floats(0, 3)


@given(series, series, limits)
def test_nearest_is_what_a_search_of_all_samples_finds(first: np.ndarray, second: np.ndarray, limit: float) -> None:
    pairs = nearest_pairs(first, second, limit)
    all_apart = np.abs(second[None] - first[:, None])
    assert pairs.first.tolist() == np.flatnonzero(all_apart.min(axis=1) <= limit).tolist()
    assert np.abs(pairs.differences).tolist() == all_apart.min(axis=1)[pairs.first].tolist()
    np.testing.assert_array_equal(second[pairs.second] - first[pairs.first], pairs.differences)


def test_the_limit_is_inclusive() -> None:
    pairs = nearest_pairs(np.array([0.0, 1.0]), np.array([0.25, 1.5]), 0.25)
    assert (pairs.first.tolist(), pairs.second.tolist()) == ([0], [0])


@given(ordered, series, limits)
def test_a_wanted_time_is_the_weighted_mean_of_its_neighbours(
    samples: np.ndarray, wanted: np.ndarray, limit: float
) -> None:
    found = brackets(wanted, samples, limit)
    before, after = samples[found.before], samples[found.after]
    np.testing.assert_allclose((1 - found.share) * before + found.share * after, wanted[found.wanted], atol=1e-12)
    assert ((found.share >= 0) & (found.share <= 1)).all()
    assert (after - before <= limit).all()
    assert ((found.after - found.before) <= 1).all()


@given(ordered, series)
def test_without_a_limit_everything_between_the_ends_is_found_and_nothing_else(
    samples: np.ndarray, wanted: np.ndarray
) -> None:
    inside = (wanted >= samples[0]) & (wanted <= samples[-1])
    assert brackets(wanted, samples, np.inf).wanted.tolist() == np.flatnonzero(inside).tolist()


def test_a_long_gap_is_not_bridged_but_its_ends_are_known() -> None:
    found = brackets(np.array([0.5, 1.0, 3.0, 5.0, 5.5]), np.array([0.0, 1.0, 5.0, 6.0]), 1.0)
    assert found.wanted.tolist() == [0, 1, 3, 4]


def test_series_of_other_times_are_refused_with_both_spans_beyond_the_slack() -> None:
    for times, others, slack, said in (
        ([0.0, 2.0], [100.0, 101.0], 0.0, "shots from 0 s to 2 s, truth from 100 s to 101 s: exp"),
        ([0.0], [], 0.0, "truth: no times; expected"),
        ([0.0, 1.0], [1.02], 0.01, "one clock"),
    ):
        with pytest.raises(EvaluationError, match=said):
            require_overlap(np.array(times), np.array(others), ("shots", "truth"), slack=slack)
    require_overlap(np.array([0.0, 1.0]), np.array([1.005]), ("a", "b"), slack=0.01)


def test_nothing_has_no_partner_and_a_negative_limit_is_refused() -> None:
    for first, second in ((np.zeros(0), np.ones(2)), (np.ones(2), np.zeros(0))):
        assert not len(nearest_pairs(first, second, 9).first)
    with pytest.raises(ValueError, match="expected 0 s or more"):
        nearest_pairs(np.zeros(1), np.zeros(1), -1.0)
