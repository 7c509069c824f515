import math
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from palletloc.geometry import FloatArray, LevelPose, wrap_angle
from palletloc.io.atomic import OutputError
from palletloc.io.csv_table import TableError
from palletloc.io.tracks import TRACK_COLUMNS, TrackRow, read_tracks, write_tracks
from palletloc.track_status import Status
from tracking.events import Event, EventKind
from tracking.files import EVENT_COLUMNS, PathPoint, read_events, remove_run, write_events, write_paths

numbers = st.floats(-100, 100)
poses = st.builds(LevelPose, numbers, numbers, numbers, st.floats(-math.pi, 3.141592))
times = st.floats(-1e6, 1e9)
optional = st.none() | st.floats(0, 1e4)


@st.composite
def covariances(draw: st.DrawFn) -> FloatArray:
    half = np.array(draw(st.lists(st.floats(-1, 1), min_size=16, max_size=16))).reshape(4, 4)
    return np.asarray(half @ half.T + 1e-6 * np.eye(4))


rows = st.builds(
    TrackRow,
    times,
    st.integers(1, 10**6),
    st.sampled_from(["t11", "epal1-1200"]),
    st.sampled_from(Status),
    poses,
    covariances(),
    st.floats(0, 1e4),
    st.integers(1, 10**6),
)
events = st.builds(
    Event,
    st.sampled_from(EventKind),
    times,
    st.none() | st.integers(1, 10**6),
    optional,
    optional,
    optional,
    optional,
    st.sampled_from(["", "no odometry, none at all", 'a "quoted" word']),
    st.booleans(),
)
ROW = TrackRow(1.5, 3, "t11", Status.COASTING, LevelPose(1.0, 2.0, 0.0, 1.5), np.eye(4) * 1e-4, 0.25, 7)


def test_the_table_is_the_contracts(tmp_path: Path) -> None:
    write_tracks(tmp_path / "tracks.csv", [ROW])
    header, line = (tmp_path / "tracks.csv").read_text().splitlines()
    covariance = "cov_xx,cov_xy,cov_xz,cov_xw,cov_yy,cov_yz,cov_yw,cov_zz,cov_zw,cov_ww"
    assert header == f"time_s,track,model,state,x_m,y_m,z_m,yaw_rad,{covariance},age_s,hits"
    variance, zero = "1.000000e-04", "0.000000e+00"
    triangle = ",".join([variance, zero, zero, zero, variance, zero, zero, variance, zero, variance])
    assert line == f"1.5,3,t11,coasting,1.000000,2.000000,0.000000,1.500000,{triangle},0.250000,7"


@settings(max_examples=30)
@given(st.lists(rows, max_size=3))
def test_tracks_are_read_back(written: list[TrackRow]) -> None:
    with TemporaryDirectory() as folder:
        write_tracks(Path(folder) / "tracks.csv", written)
        read = read_tracks(Path(folder) / "tracks.csv")
    for one, other in zip(written, read, strict=True):
        assert (one.time, one.track, one.model, one.status, one.hits) == (
            other.time,
            other.track,
            other.model,
            other.status,
            other.hits,
        )
        assert other.pose.as_array() == pytest.approx(one.pose.as_array(), abs=5.1e-7)
        assert other.covariance == pytest.approx(one.covariance, rel=1e-6)
        assert other.age == pytest.approx(one.age, abs=5.1e-7)


@settings(max_examples=30)
@given(st.lists(events, max_size=3))
def test_events_are_read_back(written: list[Event]) -> None:
    with TemporaryDirectory() as folder:
        write_events(Path(folder) / "events.csv", written)
        read = read_events(Path(folder) / "events.csv")
    for one, other in zip(written, read, strict=True):
        assert (one.kind, one.time, one.track, one.reason, one.revised) == (
            other.kind,
            other.time,
            other.track,
            other.reason,
            other.revised,
        )
        for value, back in zip(
            (one.distance, one.limit, one.age, one.window),
            (other.distance, other.limit, other.age, other.window),
            strict=True,
        ):
            assert back == (None if value is None else pytest.approx(value, abs=5.1e-7))


def test_an_event_without_a_finite_time_leaves_it_empty(tmp_path: Path) -> None:
    write_events(tmp_path / "events.csv", [Event(EventKind.REJECTED, math.nan, reason="time")])
    assert (tmp_path / "events.csv").read_text().splitlines()[1] == ",rejected,,,,,,no,time"
    assert math.isnan(read_events(tmp_path / "events.csv")[0].time)


@pytest.mark.parametrize(
    ("column", "cell", "said"),
    [
        ("track", "0", "track: expected a whole number from 1 on, got '0'"),
        ("track", "1.5", "track: expected a whole number from 1 on, got '1.5'"),
        ("hits", "-2", "hits: expected a whole number from 1 on, got '-2'"),
        ("state", "confirmd", "state: unknown word 'confirmd'; did you mean 'confirmed'?"),
        ("age_s", "-1", "age_s: expected a time since the last measurement, got -1"),
        ("x_m", "nan", "x_m: expected a finite number, got 'nan'"),
        ("cov_zz", "-1", "cov_xx, cov_yy, cov_zz, cov_ww: expected variances, which are not negative"),
        ("model", "", "model: expected a text, got nothing"),
    ],
)
def test_a_bad_row_is_named_with_its_line(tmp_path: Path, column: str, cell: str, said: str) -> None:
    path = tmp_path / "tracks.csv"
    write_tracks(path, [ROW, ROW])
    lines = [line.split(",") for line in path.read_text().splitlines()]
    lines[2][TRACK_COLUMNS.index(column)] = cell
    path.write_text("\n".join(",".join(line) for line in lines))
    with pytest.raises(TableError) as caught:
        read_tracks(path)
    assert str(caught.value) == f"{path}, line 3: {said}"


@pytest.mark.parametrize(
    ("column", "cell", "said"),
    [
        ("revised", "true", "revised: expected yes or no, got 'true'"),
        ("event", "gatd", "event: unknown word 'gatd'; did you mean 'gated'?"),
        ("limit", "x", "limit: expected a finite number, got 'x'"),
    ],
)
def test_a_bad_event_is_named_with_its_line(tmp_path: Path, column: str, cell: str, said: str) -> None:
    path = tmp_path / "events.csv"
    write_events(path, [Event(EventKind.GATED, 0.5, 1, 20.0, 18.5)])
    lines = [line.split(",") for line in path.read_text().splitlines()]
    lines[1][EVENT_COLUMNS.index(column)] = cell
    path.write_text("\n".join(",".join(line) for line in lines))
    with pytest.raises(TableError, match="line 2") as caught:
        read_events(path)
    assert str(caught.value).endswith(said)


@settings(max_examples=30)
@given(poses)
def test_a_path_has_time_place_and_the_quaternion_of_the_yaw(pose: LevelPose) -> None:
    with TemporaryDirectory() as folder:
        write_paths(Path(folder) / "tracks", [PathPoint(2, 0.25, pose)])
        line = (Path(folder) / "tracks" / "2.tum").read_text()
    time, x, y, z, *quaternion = (float(word) for word in line.split())
    assert (time, x, y, z) == pytest.approx((0.25, pose.x, pose.y, pose.z), abs=5.1e-7)
    yaw, pitch, roll = Rotation.from_quat(quaternion).as_euler("ZYX")
    assert (pitch, roll) == pytest.approx((0.0, 0.0), abs=1e-9)
    assert abs(wrap_angle(yaw - pose.yaw)) < 1e-8
    assert quaternion[3] >= 0


def test_each_track_has_a_file_with_its_own_points(tmp_path: Path) -> None:
    points = [PathPoint(number, time, LevelPose(time, number, 0, 0)) for time in (0.0, 1.0) for number in (1, 12)]
    write_paths(tmp_path / "tracks", points)
    assert sorted(path.name for path in (tmp_path / "tracks").iterdir()) == ["1.tum", "12.tum"]
    lines = (tmp_path / "tracks" / "12.tum").read_text().splitlines()
    assert [line.split()[:3] for line in lines] == [
        ["0.0", "0.000000", "12.000000"],
        ["1.0", "1.000000", "12.000000"],
    ]


def test_a_run_is_removed_and_nothing_else(tmp_path: Path) -> None:
    write_paths(tmp_path / "tracks", [PathPoint(1, 0.0, LevelPose(0, 0, 0, 0))])
    write_paths(tmp_path / "tracks_smoothed", [PathPoint(1, 0.0, LevelPose(0, 0, 0, 0))])
    for name in ("tracks.csv", "tracks_smoothed.csv", "events.csv", "tracks.png"):
        (tmp_path / name).write_text("")
    (tmp_path / "measurements.csv").write_text("")
    (tmp_path / "tracks" / "mine.tum").write_text("")
    remove_run(tmp_path)
    assert sorted(str(path.relative_to(tmp_path)) for path in tmp_path.rglob("*")) == [
        "measurements.csv",
        "tracks",
        "tracks/mine.tum",
    ]
    remove_run(tmp_path / "nowhere")


def test_a_folder_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    (tmp_path / "tracks").write_text("a file")
    with pytest.raises(OutputError, match="tracks"):
        write_paths(tmp_path / "tracks", [PathPoint(1, 0.0, LevelPose(0, 0, 0, 0))])
