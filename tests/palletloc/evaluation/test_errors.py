import dataclasses
import importlib.util
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import RigidTransform

from palletloc.evaluation.errors import (
    EvaluationError,
    Sight,
    TrueFace,
    pair,
    pose_error,
    recording_errors,
    shot_errors,
    true_faces,
)
from palletloc.evaluation.summary import summarize
from palletloc.geometry import FloatArray, LevelPose, level_pose
from palletloc.io.measurements import read_measurements, write_measurements
from palletloc.io.recording import read_recording
from palletloc.io.truth import TruePallet, read_truth
from palletloc.measurement import PalletMeasurement, YawSource
from palletloc.trajectory import Trajectory, TrajectoryError

SHARED = Path(__file__).resolve().parents[3].parent / "shared"
WIDTHS = {"t11": 1.1}
CAMERA = RigidTransform.from_translation([0.3, 0.0, 1.8])
AT_HOME = LevelPose(0.0, 0.0, 0.0, 0.0)

angles = st.floats(-3.1, 3.1)
places = st.floats(-5, 5)


def measured(
    pose: LevelPose, covariance: FloatArray | None = None, time: float = 0.0, model: str = "t11"
) -> PalletMeasurement:
    own = np.eye(4) if covariance is None else covariance
    return PalletMeasurement(time, model, pose, own, 0.9, YawSource.BOTTOM)


def face(pose: LevelPose, name: str = "A", visible: bool = True) -> TrueFace:
    return TrueFace(name, "t11", pose, 2.0, 1.8 - pose.z, visible)


def pallet(pose: LevelPose, name: str = "A") -> TruePallet:
    return TruePallet(name, "t11", pose)


def seen(pose: LevelPose, sight: Sight | None = None) -> TrueFace:
    return true_faces([pallet(pose)], WIDTHS, AT_HOME, CAMERA, sight)[0]


def test_errors_are_told_in_the_pallets_own_axes() -> None:
    # a pallet to the left: its x points along the forklift's y, its y along -x
    true = face(LevelPose(1.0, 2.0, 0.1, np.pi / 2))
    error = pose_error(measured(LevelPose(1.02, 2.03, 0.14, np.pi / 2 - 0.05)), true)
    assert (error.depth, error.along, error.height) == pytest.approx((0.03, -0.02, 0.04))
    assert error.yaw == pytest.approx(-0.05)


@given(places, places, angles, places, places, angles, st.floats(-0.3, 0.3))
def test_errors_do_not_depend_on_where_the_forklift_stands(
    x: float, y: float, yaw: float, to_x: float, to_y: float, turn: float, off: float
) -> None:
    elsewhere = LevelPose(to_x, to_y, 0.2, turn).transform()
    true, found = LevelPose(x, y, 0.0, yaw), LevelPose(x + off, y - 2 * off, 0.01, yaw + off)
    here = pose_error(measured(found), face(true))
    there = pose_error(
        measured(level_pose(elsewhere * found.transform())), face(level_pose(elsewhere * true.transform()))
    )
    for name in ("depth", "along", "height", "yaw"):
        assert getattr(there, name) == pytest.approx(getattr(here, name), abs=1e-9)


def test_yaw_errors_take_the_short_way() -> None:
    error = pose_error(measured(LevelPose(1, 1, 0, -3.1)), face(LevelPose(1, 1, 0, 3.1)))
    assert error.yaw == pytest.approx(2 * np.pi - 6.2)


def test_nees_counts_each_error_in_its_own_sigma() -> None:
    sigma = np.array([0.01, 0.02, 0.005, 0.003])
    off = LevelPose(1 + 0.01, 2 - 2 * 0.02, 0.0, 0.5 + 3 * 0.003)
    error = pose_error(measured(off, np.diag(sigma**2)), face(LevelPose(1, 2, 0, 0.5)))
    assert error.nees == pytest.approx(1 + 4 + 9)


def test_nees_is_four_on_average_where_the_covariance_is_true() -> None:
    rng = np.random.default_rng(3)
    root = rng.normal(size=(4, 4)) * 0.01
    true = LevelPose(1.0, 2.0, 0.1, 0.4)
    drawn = [LevelPose(*(true.as_array() + root @ rng.normal(size=4))) for _ in range(4000)]
    nees = [pose_error(measured(pose, root @ root.T), face(true)).nees for pose in drawn]
    assert np.mean(nees) == pytest.approx(4.0, abs=4 * np.sqrt(8 / 4000))


@pytest.mark.parametrize("worst", [0.0, -1e-6])
def test_a_covariance_that_is_none_has_no_finite_nees(worst: float) -> None:
    error = pose_error(measured(AT_HOME, np.diag([1e-4, 1e-4, 1e-4, worst])), face(AT_HOME))
    assert error.nees == np.inf


def test_the_right_model_is_told_from_another() -> None:
    assert pose_error(measured(AT_HOME), face(AT_HOME)).same_model
    assert not pose_error(measured(AT_HOME, model="epal1-800"), face(AT_HOME)).same_model


def test_the_closest_pairs_go_first_and_nothing_is_taken_twice() -> None:
    faces = [face(LevelPose(0.0, 2, 0, 0), "A"), face(LevelPose(0.4, 2, 0, 0), "B")]
    found = [measured(LevelPose(0.3, 2, 0, 0)), measured(LevelPose(0.41, 2, 0, 0))]
    # the first one is nearer to B, which the second one has
    assert sorted(pair(found, faces)) == [(0, 0), (1, 1)]


def test_what_lies_half_a_metre_off_belongs_to_nothing() -> None:
    faces = [face(LevelPose(0, 2, 0, 0))]
    assert pair([measured(LevelPose(0.3, 2, 0.39, 0))], faces) == [(0, 0)]
    assert pair([measured(LevelPose(0.3, 2, 0.41, 0))], faces) == []


def test_without_measurements_or_pallets_there_are_no_pairs() -> None:
    assert pair([], [face(AT_HOME)]) == pair([measured(AT_HOME)], []) == []


def test_a_shot_has_found_missed_and_false_ones() -> None:
    faces = [face(LevelPose(x, 2, 0, 0), name) for x, name in ((0, "A"), (2, "B"))]
    found = [
        measured(LevelPose(0.01, 2, 0, 0)),
        measured(LevelPose(0.1, 2, 0, 0)),
        measured(LevelPose(8, 2, 0, 0)),
    ]
    shot = shot_errors(1.5, found, faces, 1.8)
    assert [error.face.id for error in shot.errors] == ["A"]
    assert shot.errors[0].depth == pytest.approx(0.01)
    assert [one.id for one in shot.missed] == ["B"]
    assert [one.forklift_from_pallet.x for one in shot.false] == [0.1, 8]


def test_a_pallet_that_need_not_be_found_is_neither_missed_nor_false() -> None:
    hidden = face(LevelPose(0, 2, 0, 0), visible=False)
    for found in ([], [measured(hidden.forklift_from_pallet)]):
        shot = shot_errors(0.0, found, [hidden], 1.8)
        assert (shot.errors, shot.missed, shot.false) == ((), (), ())


def test_parts_by_height_hold_each_pallet_once() -> None:
    faces = [face(LevelPose(2.0 * i, 2, z, 0), str(i)) for i, z in enumerate((0.0, 1.2, 1.55, 2.4))]
    found = [measured(LevelPose(2.0 * i, 2 + 0.6 * (i == 1), z, 0)) for i, z in enumerate((0.0, 1.2, 1.55))]
    shot = shot_errors(0.0, found, faces, 1.8)
    low, high = shot.between(0.6, np.inf), shot.between(-np.inf, 0.6)
    assert [error.face.id for error in low.errors] == ["0"]
    assert [one.id for one in low.missed] == ["1"]
    assert [error.face.id for error in high.errors] == ["2"]
    assert [one.id for one in high.missed] == ["3"]
    assert (len(low.false), len(high.false)) == (1, 0)


def test_faces_stand_where_the_forklift_sees_them() -> None:
    # the forklift looks along world y; the pallet is 2 m ahead and 1 m to its left
    home = LevelPose(5.0, 1.0, 0.0, np.pi / 2)
    (one,) = true_faces([pallet(LevelPose(4.0, 3.0, 0.2, np.pi))], WIDTHS, home, CAMERA)
    assert one.forklift_from_pallet.as_array() == pytest.approx([2.0, 1.0, 0.2, np.pi / 2])
    assert one.below == pytest.approx(1.6)
    assert one.range == pytest.approx(np.sqrt(1.7**2 + 1.0 + 1.6**2))


@pytest.mark.parametrize("side", [1, -1])
def test_visible_is_what_lies_wholly_beside_the_camera(side: int) -> None:
    yaw = side * np.pi / 2
    assert seen(LevelPose(1.3, side * 2.0, 0.0, yaw)).visible
    assert not seen(LevelPose(4.9, side * 2.0, 0.0, yaw)).visible  # too far
    assert seen(LevelPose(4.9, side * 2.0, 0.0, yaw), Sight(max_range=9)).visible
    # ends at 0.55 m before and behind: 116 degrees lie at 0.976 m behind the camera's side
    assert seen(LevelPose(0.3 - 0.40, side * 2.0, 0.0, yaw)).visible
    assert not seen(LevelPose(0.3 - 0.45, side * 2.0, 0.0, yaw)).visible
    # right ahead, one end is on the other side
    assert not seen(LevelPose(3.0, side * 0.5, 0.0, 0.0)).visible


def test_range_counts_from_the_camera_to_the_middle_of_the_lower_edge() -> None:
    pose = LevelPose(0.3, 2.0, 1.8, np.pi / 2)
    assert seen(pose, Sight(max_range=2.001)).visible
    assert not seen(pose, Sight(max_range=1.999)).visible


def test_a_model_without_a_width_is_named() -> None:
    with pytest.raises(EvaluationError, match=r"'A': unknown model 't11'; did you mean 't11x'\?"):
        true_faces([pallet(AT_HOME)], {"t11x": 1.1}, AT_HOME, CAMERA)


def test_shots_without_measurements_count() -> None:
    path = Trajectory(*np.array([[0.0, 1.0], [0.0, 1.0], [0.0, 0.0], [0.0, 0.0]]))
    pallets = [pallet(LevelPose(1.5, 2.0, 0.0, np.pi / 2))]
    found = measured(LevelPose(0.5, 2.0, 0.0, np.pi / 2), time=1.0)
    shots = recording_errors([0.0, 1.0], [found], pallets, WIDTHS, path, CAMERA)
    assert [(len(shot.errors), len(shot.missed)) for shot in shots] == [(0, 1), (1, 0)]
    assert shots[1].errors[0].depth == pytest.approx(0.0, abs=1e-12)


def test_a_measurement_at_another_time_is_an_error() -> None:
    path = Trajectory(*np.array([[0.0, 1.0], [0.0, 1.0], [0.0, 0.0], [0.0, 0.0]]))
    with pytest.raises(EvaluationError, match=r"0\.5 s is of no shot; the nearest is 0"):
        recording_errors([0.0, 1.0], [measured(AT_HOME, time=0.5)], [], WIDTHS, path, CAMERA)


def test_a_shot_outside_the_true_path_is_an_error() -> None:
    path = Trajectory(*np.array([[0.0, 1.0], [0.0, 1.0], [0.0, 0.0], [0.0, 0.0]]))
    with pytest.raises(TrajectoryError):
        recording_errors([5.0], [], [], WIDTHS, path, CAMERA)


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
        faces = true_faces(
            truth.pallets,
            {"t11-plastic": 1.1, "epal1-1200": 1.2},
            truth.forklift.pose_at(shot.time),
            forklift_from_camera,
        )
        poses = [LevelPose(*(one.forklift_from_pallet.as_array() + 0.03 * rng.normal(size=4))) for one in faces]
        poses = [pose for pose in poses if rng.random() < 0.8]
        poses += [LevelPose(*rng.uniform(-3, 3, 4)) for _ in range(int(rng.integers(3)))]
        root = rng.normal(size=(4, 4)) * 0.03
        found += [measured(pose, root @ root.T, shot.time, faces[0].model) for pose in poses]
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
    shots = recording_errors(
        [shot.time for shot in read.shots],
        [one for one in read_measurements(tmp_path / "measurements.csv") if isinstance(one, PalletMeasurement)],
        truth.pallets,
        {model.name: model.width for model in read.models},
        truth.forklift,
        read.forklift_from_camera,
    )
    ours = summarize(shots)
    assert ours.visible == theirs["visible"]
    assert ours.recall == pytest.approx(theirs["recall"])
    assert ours.false_per_shot == pytest.approx(theirs["false_per_shot"])
    assert ours.nees == pytest.approx(theirs["nees_mean"])
    for quantity, unit in (("yaw", np.degrees(1)), ("depth", 1e3), ("along", 1e3), ("height", 1e3)):
        spread = dataclasses.asdict(getattr(ours, quantity))
        for mine, other in (("median", "median"), ("p95", "p95"), ("maximum", "max"), ("bias", "bias")):
            assert spread[mine] * unit == pytest.approx(theirs[quantity][other], rel=1e-6)
    assert [error.face.id for shot in shots for error in shot.errors] == [row["id"] for row in their_errors]
