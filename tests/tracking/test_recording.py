from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from palletloc.cameras import Equirectangular
from palletloc.errors import PalletLocError
from palletloc.evaluation.pose_error import from_measurements
from palletloc.evaluation.run_match import TrueScene, match_run
from palletloc.geometry import FloatArray, LevelPose, level_pose, wrap_angle
from palletloc.io.measurements import NoPose, write_measurements
from palletloc.io.recording import Recording, ShotFile
from palletloc.io.tracks import TrackRow, read_tracks
from palletloc.io.truth import read_truth
from palletloc.measurement import PalletMeasurement, YawSource
from palletloc.pallet import Opening, PalletModel
from palletloc.recording_run import read_job
from palletloc.shelf import ShelfPlane
from palletloc.track_status import Status
from palletloc.trajectory import Trajectory
from tests.tracking.unchecked import unchecked
from tracking.config import LifeConfig, MeasurementErrors, TrackerConfig
from tracking.events import EventKind
from tracking.files import read_events, track_row
from tracking.observation import ShotTaken
from tracking.odometry import Odometry, samples_of
from tracking.recording import TrackedRecording, read_measured, track_recording, write_run
from tracking.tracker import PalletTracker

T11 = PalletModel("t11", 1.1, 0.144, 1.1, (Opening(-0.265, 0.024, 0.29, 0.092), Opening(0.265, 0.024, 0.29, 0.092)))
PALLETS = (LevelPose(4.0, 2.0, 0.0, 1.5), LevelPose(5.6, 2.1, 1.2, 1.55))
TIMES = np.arange(0.0, 6.0, 0.05)
SIGMA = np.array([0.006, 0.006, 0.004, 0.006])
SHARED = Path(__file__).resolve().parents[2].parent / "shared/data"


def path() -> Trajectory:
    yaw = 0.1 * np.sin(0.8 * TIMES)
    x = np.cumsum(0.5 * 0.05 * np.cos(yaw))
    y = np.cumsum(0.5 * 0.05 * np.sin(yaw))
    return Trajectory(TIMES, x, y, yaw, speed=np.full_like(TIMES, 0.5), yaw_rate=0.08 * np.cos(0.8 * TIMES))


def recording(count: int = 12) -> Recording:
    shots = tuple(ShotFile(0.02 + 0.45 * number, f"{number}.jpg") for number in range(count))
    mounting = RigidTransform.from_translation([0.3, 0.0, 1.8])
    return Recording(
        Path("aisle"), Equirectangular(64, 32), mounting, ShelfPlane(3.0, 2.0, -1.5), (T11,), shots, path()
    )


def forklift_from(pallet: LevelPose, time: float) -> LevelPose:
    return level_pose(path().pose_at(time).transform().inv() * pallet.transform())


def measured(one: Recording, hidden: tuple[float, ...] = (), seed: int = 1) -> list[PalletMeasurement]:
    """Measure every pallet in every shot, the second one not at some times."""
    random = np.random.default_rng(seed)
    found = []
    for shot in one.shots:
        for number, pallet in enumerate(PALLETS):
            values = forklift_from(pallet, shot.time).as_array() + random.normal(size=4) * SIGMA
            pose = LevelPose(*(float(value) for value in values))
            if number == 0 or shot.time not in hidden:
                found.append(
                    PalletMeasurement(shot.time, "t11", pose, np.diag(SIGMA**2), 0.9, YawSource.FACE, shot.file)
                )
    return found


def same(one: TrackRow, other: TrackRow) -> bool:
    return (one.time, one.track, one.status, one.age, one.hits, one.pose) == (
        other.time,
        other.track,
        other.status,
        other.age,
        other.hits,
        other.pose,
    ) and bool((one.covariance == other.covariance).all())


def test_there_is_a_row_per_live_track_and_shot_after_its_own_measurements() -> None:
    whole = recording()
    run = track_recording(whole, measured(whole))
    assert [(row.time, row.track) for row in run.rows] == [
        (shot.time, number) for shot in whole.shots for number in (1, 2)
    ]
    assert [row.hits for row in run.rows] == [n for n in range(1, 13) for _ in (1, 2)]
    assert [row.status for row in run.rows] == [Status.TENTATIVE] * 4 + [Status.CONFIRMED] * 20
    assert all(row.age == 0.0 for row in run.rows)


def test_rows_know_nothing_of_the_future() -> None:
    whole = recording()
    found = measured(whole)
    rows = track_recording(whole, found).rows
    end = whole.shots[6].time
    until = whole.odometry.times <= end
    odometry = Trajectory(*(values[until] for values in (TIMES, path().x, path().y, path().yaw)))
    cut = replace(whole, shots=whole.shots[:7], odometry=replace(odometry, speed=None))
    odometry = replace(odometry, speed=np.full(until.sum(), 0.5), yaw_rate=0.08 * np.cos(0.8 * TIMES[until]))
    cut = replace(cut, odometry=odometry)
    early = track_recording(cut, [each for each in found if each.time <= end]).rows
    assert len(early) == 14
    assert all(same(one, other) for one, other in zip(early, rows, strict=False))


def test_it_is_what_the_tracker_says_when_asked_right_then() -> None:
    whole = recording()
    found = measured(whole)
    tracker = PalletTracker(None, whole.models)
    given: list[Odometry | ShotTaken] = [*samples_of(whole.odometry), *(ShotTaken(shot.time) for shot in whole.shots)]
    answers = []
    for item in sorted(given, key=lambda given: given.time):
        tracker.push(item)
        if isinstance(item, ShotTaken):
            tracker.push([each for each in found if each.time == item.time])
            answers += [track_row(state) for state in tracker.tracks(item.time)]
    assert all(same(one, other) for one, other in zip(answers, track_recording(whole, found).rows, strict=True))


def test_shots_that_could_not_be_used_count_for_nothing_but_have_rows() -> None:
    whole = recording()
    lost = tuple(shot.time for shot in whole.shots[5:9])
    found = [measurement for measurement in measured(whole) if measurement.time not in lost]
    counted, unread = track_recording(whole, found), track_recording(whole, found, None, lost)
    for run, expected in ((counted, Status.COASTING), (unread, Status.CONFIRMED)):
        rows = [row for row in run.rows if row.time in lost]
        assert len(rows) == 8
        assert {row.status for row in rows} == {expected}
        assert [round(row.age, 2) for row in rows[::2]] == [0.45, 0.9, 1.35, 1.8]


def test_a_hidden_pallet_coasts_along_its_path() -> None:
    whole = recording()
    hidden = tuple(shot.time for shot in whole.shots[4:9])
    rows = track_recording(whole, measured(whole, hidden)).rows
    second = [row for row in rows if row.track == 2]
    assert [row.status for row in second if row.time in hidden] == [Status.COASTING] * 5
    for row in second:
        away = row.pose.as_array() - forklift_from(PALLETS[1], row.time).as_array()
        away[3] = wrap_angle(float(away[3]))
        assert away @ np.linalg.solve(row.covariance, away) < 25
    sigmas = [float(np.sqrt(np.trace(row.covariance[:2, :2]))) for row in second]
    assert sigmas[3] < sigmas[6] < sigmas[8] > sigmas[9]


def test_a_path_is_the_row_in_odom() -> None:
    whole = recording()
    run = track_recording(whole, measured(whole), smooth=True)
    for points, rows in ((run.paths, run.rows), (run.smoothed_paths, run.smoothed_rows)):
        for point, row in zip(points, rows, strict=True):
            assert (point.track, point.time) == (row.track, row.time)
            expected = level_pose(path().pose_at(row.time).transform() * row.pose.transform())
            assert point.odom_from_pallet.as_array() == pytest.approx(expected.as_array(), abs=2e-4)
            assert np.hypot(point.odom_from_pallet.x - PALLETS[row.track - 1].x, 0.0) < 0.05


def test_the_smoother_has_a_row_for_the_same_shots_and_believes_tracks_from_their_begin() -> None:
    whole = recording()
    hidden = tuple(shot.time for shot in whole.shots[4:6])
    stray = replace(measured(whole)[0], forklift_from_pallet=LevelPose(2.0, 9.0, 0.0, 1.5))
    run = track_recording(whole, [stray, *measured(whole, hidden)], smooth=True)
    assert [(row.time, row.track, row.hits, row.age) for row in run.smoothed_rows] == [
        (row.time, row.track, row.hits, row.age) for row in run.rows
    ]
    by_track: dict[int, set[Status]] = {}
    for row in run.smoothed_rows:
        by_track.setdefault(row.track, set()).add(row.status)
    stray_number = next(row.track for row in run.rows if row.pose.y > 5)
    assert by_track.pop(stray_number) == {Status.TENTATIVE}
    assert sorted(by_track.values(), key=len) == [{Status.CONFIRMED}, {Status.CONFIRMED, Status.COASTING}]
    assert track_recording(whole, measured(whole)).smoothed_rows == ()


@pytest.mark.parametrize("latency", [0.08, -0.03])
def test_shots_stamped_late_are_smoothed_at_their_stamps(latency: float) -> None:
    """What was exposed earlier than stamped shows the pallet where it was then; rows say where it is at the stamp."""
    whole = recording()
    exposed = [
        replace(one, forklift_from_pallet=forklift_from(PALLETS[number % 2], one.time - latency))
        for number, one in enumerate(measured(whole))
        if one.time - latency >= 0
    ]
    config = TrackerConfig(errors=MeasurementErrors(latency_s=latency))
    run = track_recording(whole, exposed, config, smooth=True)
    assert len(run.smoothed_rows) == len(run.rows) > 15
    for row in run.smoothed_rows:
        true = forklift_from(PALLETS[0 if row.pose.z < 0.6 else 1], row.time)
        assert row.pose.as_array() == pytest.approx(true.as_array(), abs=2e-3)


def test_events_tell_of_measurements_and_tracks_to_the_end_but_not_of_samples() -> None:
    whole = recording(4)
    wrong = unchecked(measured(whole)[4], covariance=-np.eye(4))
    config = TrackerConfig(life=LifeConfig(max_coast_s=1.0))
    run = track_recording(whole, [*measured(whole), wrong], config)
    kinds = [event.kind for event in run.events]
    assert kinds.count(EventKind.ACCEPTED) == 8
    assert kinds.count(EventKind.BORN) == kinds.count(EventKind.CONFIRMED) == 2
    assert kinds.count(EventKind.REJECTED) == 1
    assert kinds.count(EventKind.LOST) == 2  # after the last shot
    assert all(event.track for event in run.events if event.kind is EventKind.ACCEPTED)


def test_a_recording_without_measurements_gives_no_tracks() -> None:
    run = track_recording(recording(), [], smooth=True)
    assert (run.rows, run.smoothed_rows, run.events, run.paths) == ((), (), (), ())
    assert len(run.shots) == 12


def contents(folder: Path) -> dict[str, bytes]:
    return {str(each.relative_to(folder)): each.read_bytes() for each in folder.rglob("*") if each.is_file()}


def written(folder: Path, run: TrackedRecording) -> set[str]:
    write_run(folder, run, b"picture")
    return set(contents(folder))


def test_a_run_replaces_all_of_the_one_before(tmp_path: Path) -> None:
    whole = recording()
    names = {"tracks.csv", "events.csv", "tracks.png", "tracks/1.tum", "tracks/2.tum"}
    more = {"tracks_smoothed.csv", "tracks_smoothed/1.tum", "tracks_smoothed/2.tum"}
    assert written(tmp_path / "out", track_recording(whole, measured(whole), smooth=True)) == names | more
    assert written(tmp_path / "out", track_recording(whole, measured(whole))) == names
    lone = [measurement for measurement in measured(whole) if measurement.forklift_from_pallet.z < 0.6]
    run = track_recording(whole, lone)
    assert written(tmp_path / "out", run) == names - {"tracks/2.tum"}
    assert len(read_tracks(tmp_path / "out" / "tracks.csv")) == 12
    assert [event.kind for event in read_events(tmp_path / "out" / "events.csv")] == [
        event.kind for event in run.events
    ]


def test_measurements_are_read_for_their_shots(tmp_path: Path) -> None:
    whole = recording()
    found = measured(whole)
    moved: list[PalletMeasurement | NoPose] = [
        replace(found[0], time=found[0].time + 1e-4),
        NoPose(found[2].time, "t11"),
        *found[1:],
    ]
    write_measurements(tmp_path / "m.csv", moved)
    read = read_measured(tmp_path / "m.csv", whole)
    assert [each.time for each in read] == [each.time for each in found]


@pytest.mark.parametrize(
    ("time", "model", "said"),
    [
        (0.3, "t11", "no shot at 0.3 s; the nearest is at 0.47 s; expected measurements of aisle"),
        (99.0, "t11", "no shot at 99 s; the nearest is at 4.97 s"),
        (0.47, "t12", "unknown model 't12'; did you mean 't11'?"),
    ],
)
def test_measurements_of_another_recording_are_refused(tmp_path: Path, time: float, model: str, said: str) -> None:
    found = measured(recording())
    write_measurements(tmp_path / "m.csv", [found[0], replace(found[3], time=time, model=model)])
    with pytest.raises(PalletLocError) as caught:
        read_measured(tmp_path / "m.csv", recording())
    assert str(caught.value).startswith(f"{tmp_path / 'm.csv'}: ")
    assert said in str(caught.value)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["dev_lab", "dev_warehouse"])
@pytest.mark.parametrize("hits", [3, 5])
def test_tracks_beat_the_shots_that_they_are_made_of(name: str, hits: int) -> None:
    """In depth, along and yaw wherever a track is confirmed and its pallet counts as visible, shot by shot."""
    if not (SHARED / name).is_dir():
        pytest.skip("the shared recordings are not there")
    job, truth = read_job(SHARED / name), read_truth(SHARED / name)
    found = [measurement for number in range(len(job.shots)) for measurement in job.explain(number).measurements]
    run = track_recording(job.recording, found, smooth=True)

    def offsets(measured: Sequence[PalletMeasurement]) -> dict[tuple[str, float], FloatArray]:
        widths = {model.name: model.width for model in job.recording.models}
        scene = TrueScene(truth.forklift, truth.pallets, widths, job.recording.forklift_from_camera)
        match = match_run([shot.time for shot in job.shots], from_measurements(measured), scene)
        assert not any(shot.false for shot in match.shots)
        return {(each.face.id, each.time): each.offset[[0, 1, 3]] for each in match.errors}

    def as_measured(rows: Sequence[TrackRow], hits: int) -> list[PalletMeasurement]:
        kept = [row for row in rows if row.hits >= hits and row.age == 0 and row.status is Status.CONFIRMED]
        return [PalletMeasurement(row.time, row.model, row.pose, row.covariance, 1.0, YawSource.FACE) for row in kept]

    single = offsets(found)
    filtered = offsets(as_measured(run.rows, hits))
    smooth = offsets(as_measured(run.smoothed_rows, hits))
    assert len(filtered) > 25
    rms = [np.sqrt(np.mean([values[key] ** 2 for key in filtered], axis=0)) for values in (single, filtered, smooth)]
    assert (rms[1] < rms[0]).all()
    assert (rms[2] < rms[0]).all()
