from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from palletloc.cameras import Equirectangular
from palletloc.drawing.canvas import SERIES, png
from palletloc.geometry import FloatArray, LevelPose, level_pose
from palletloc.io.recording import Recording, ShotFile
from palletloc.io.tracks import TrackRow
from palletloc.io.truth import TruePallet, Truth
from palletloc.measurement import PalletMeasurement, YawSource
from palletloc.pallet import Opening, PalletModel
from palletloc.shelf import ShelfPlane
from palletloc.track_status import Status
from palletloc.trajectory import Trajectory
from tracking.figure import MOST_BESIDE, track_deviations, track_figure
from tracking.recording import ShotTracks, TrackedRecording
from tracking.smoother import SmoothedState
from tracking.state import Gaussian, Key
from tracking.track import Track

T11 = PalletModel("t11", 1.1, 0.144, 1.1, (Opening(0.0, 0.024, 0.29, 0.092),))
TIMES = (0.0, 1.0, 2.0)
ODOMETRY = Trajectory(
    np.array(TIMES), np.array([0.0, 0.5, 1.0]), np.zeros(3), np.zeros(3), speed=np.ones(3), yaw_rate=np.zeros(3)
)
FORKLIFT = Trajectory(np.array(TIMES), np.array([3.0, 3.0, 3.0]), np.array([1.0, 1.5, 2.0]), np.full(3, np.pi / 2))
SHOTS = tuple(ShotFile(time, f"{time}.jpg") for time in TIMES)
RECORDING = Recording(
    Path("aisle"),
    Equirectangular(64, 32),
    RigidTransform.from_translation([0.3, 0.0, 1.8]),
    ShelfPlane(3.0, 2.0, -1.5),
    (T11,),
    SHOTS,
    ODOMETRY,
)
IN_ODOM = {1: LevelPose(3.0, 2.0, 0.0, 1.7), 2: LevelPose(5.0, 2.0, 1.5, 1.5)}
"""Odom is the true world, moved by (3, 1) and turned by a quarter."""


def in_world(pose: LevelPose) -> LevelPose:
    return level_pose(LevelPose(3.0, 1.0, 0.0, np.pi / 2).transform() * pose.transform())


TRUTH = Truth(FORKLIFT, tuple(TruePallet(name, "t11", in_world(IN_ODOM[i])) for i, name in ((1, "A"), (2, "B"))))


def seen(number: int, time: float, depth: float, along: float, yaw: float) -> LevelPose:
    """Return a pallet in the forklift frame, off by so much in its own axes."""
    there = ODOMETRY.pose_at(time).transform().inv() * IN_ODOM[number].transform()
    return level_pose(there * LevelPose(depth, along, 0.0, yaw).transform())


def turned(number: int, sigmas: FloatArray) -> FloatArray:
    """Return a covariance that has these standard deviations in the pallet's axes."""
    axes = np.eye(4)
    axes[:3, :3] = IN_ODOM[number].matrix()[:3, :3]
    return np.asarray(axes @ np.diag(sigmas**2) @ axes.T)


SIGMAS = np.array([0.01, 0.002, 0.003, 0.004])


def row(number: int, time: float, off: float, status: Status = Status.CONFIRMED) -> TrackRow:
    pose = seen(number, time, off, -2 * off, off / 10)
    return TrackRow(time, number, "t11", status, pose, turned(number, SIGMAS), 0.0, 3)


def measured(number: int, time: float, off: float) -> PalletMeasurement:
    pose = seen(number, time, off, -2 * off, off / 10)
    return PalletMeasurement(time, "t11", pose, turned(number, SIGMAS), 0.9, YawSource.FACE)


def run_of(rows: list[TrackRow], found: list[PalletMeasurement]) -> TrackedRecording:
    shots = tuple(
        ShotTracks(shot, tuple(row for row in rows if row.time == shot.time), ODOMETRY.pose_at(shot.time))
        for shot in SHOTS
    )
    return TrackedRecording(RECORDING, tuple(found), shots, ())


ROWS = [row(number, time, 0.01 * number + 0.001 * time) for time in TIMES for number in (1, 2)]
FOUND = [measured(number, time, 0.03 * number) for time in TIMES[:2] for number in (1, 2)]


def test_tracks_and_shots_are_held_against_their_own_pallets() -> None:
    first, second = track_deviations(run_of(ROWS, FOUND), TRUTH)
    assert [(each.track, each.model, each.against) for each in (first, second)] == [(1, "t11", "A"), (2, "t11", "B")]
    for number, one in ((1, first), (2, second)):
        off = 0.01 * number + 0.001 * np.array(TIMES)
        assert one.filtered.times.tolist() == list(TIMES)
        assert one.filtered.offsets == pytest.approx(np.column_stack([off, -2 * off, 0 * off, off / 10]), abs=1e-9)
        assert one.filtered.sigmas == pytest.approx(np.tile(SIGMAS, (3, 1)), abs=1e-9)
        assert one.shots.times.tolist() == list(TIMES[:2])
        assert one.shots.offsets[:, 0] == pytest.approx([0.03 * number] * 2, abs=1e-9)
        assert one.smoothed is None
    assert first.ranges == pytest.approx((np.hypot(3.0, 2.0), np.hypot(2.0, 2.0)), abs=0.05)


def test_without_truth_a_track_is_held_against_its_end() -> None:
    (first, _) = track_deviations(run_of(ROWS, FOUND))
    assert first.against == ""
    assert first.filtered.offsets[-1] == pytest.approx(np.zeros(4), abs=1e-9)
    # in the axes of the end, which differ by a thousandth
    assert first.filtered.offsets[0, :2] == pytest.approx([-0.002, 0.004], abs=1e-5)
    assert first.filtered.offsets[0, 3] == pytest.approx(-0.0002, abs=1e-9)


def test_a_track_where_no_pallet_stands_is_held_against_its_end_and_a_tentative_one_is_left_out() -> None:
    away = [replace(each, pose=replace(each.pose, y=each.pose.y + 3)) for each in ROWS if each.track == 1]
    tentative = [replace(each, track=7, status=Status.TENTATIVE) for each in ROWS if each.track == 2]
    (only,) = track_deviations(run_of([*away, *tentative], FOUND), TRUTH)
    assert (only.track, only.against) == (1, "")
    assert len(only.shots.times) == 0


def test_truth_that_does_not_reach_a_shot_leaves_it_out() -> None:
    short = Trajectory(FORKLIFT.times[:2], FORKLIFT.x[:2], FORKLIFT.y[:2], FORKLIFT.yaw[:2])
    short = replace(short, times=short.times - 0.2)
    first, _ = track_deviations(run_of(ROWS, FOUND), Truth(short, TRUTH.pallets))
    assert first.filtered.times.tolist() == list(TIMES[:2])


def lines(figure_tracks: int, rows: list[TrackRow]) -> list[list[FloatArray]]:
    figure = track_figure(track_deviations(run_of(rows, FOUND), TRUTH), "aisle")
    assert len(figure.axes) == 3 * figure_tracks
    return [
        [np.asarray(line.get_xydata()) for line in axes.lines if line.get_color() == SERIES[0]]
        for axes in figure.axes
    ]


def test_each_track_has_a_column_with_yaw_depth_and_along_in_its_units() -> None:
    drawn = lines(2, ROWS)
    off = 0.01 + 0.001 * np.array(TIMES)
    for chart, values in zip(drawn[:3], (np.degrees(off / 10), 1000 * off, -2000 * off), strict=True):
        (line,) = chart
        assert line[:, 0].tolist() == list(TIMES)
        assert line[:, 1] == pytest.approx(values, abs=1e-6)


def test_more_tracks_than_fit_stand_below() -> None:
    many = [replace(each, track=each.track + 2 * copy) for each in ROWS for copy in range(3)]
    few = track_figure(track_deviations(run_of(ROWS, FOUND), TRUTH), "aisle")
    figure = track_figure(track_deviations(run_of(many, FOUND), TRUTH), "aisle")
    assert len(figure.axes) == 3 * 6 > 3 * MOST_BESIDE
    assert figure.get_size_inches()[1] > 1.5 * few.get_size_inches()[1]


@pytest.mark.parametrize("rows", [[], [row(1, 0.0, 0.01)], [row(1, 0.0, 0.0), row(1, 1.0, 0.0)]])
def test_no_track_a_single_row_and_no_deviation_at_all_can_be_drawn(rows: list[TrackRow]) -> None:
    tracks = track_deviations(run_of(rows, []), TRUTH)
    picture = png(track_figure(tracks, "aisle $ of $ dollars"))
    assert picture.startswith(b"\x89PNG")
    labels = {axes.get_ylabel() for axes in track_figure(tracks, "aisle").axes}
    assert labels == ({"yaw (\N{DEGREE SIGN})", "depth (mm)", "along (mm)"} if rows else set())


def test_the_smoother_is_drawn_where_there_is_one() -> None:
    later = []
    for each in ROWS:
        mean, covariance = np.zeros(10), np.eye(10)
        mean[:4], covariance[:4, :4] = each.pose.as_array(), each.covariance
        state = Gaussian(mean, covariance)
        then = Track(Key(0.0, ""), "t11", state, each.time, 3, confirmed=True)
        later.append(SmoothedState(each.time, each.track, then, state))
    run = replace(run_of(ROWS, FOUND), later=tuple(later))
    tracks = track_deviations(run, TRUTH)
    for track in tracks:
        assert track.smoothed is not None
        assert track.smoothed.offsets == pytest.approx(track.filtered.offsets, abs=1e-9)
    labels = {text.get_text() for legend in track_figure(tracks, "aisle").legends for text in legend.get_texts()}
    assert {label.split(":")[0] for label in labels} == {"single shots", "filter", "smoother"}
