"""Poses over time as other programs write them: each file is made to the format's description, from one drive."""

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from palletloc.errors import PalletLocError, seconds
from palletloc.geometry import FloatArray, LevelPose
from palletloc.io.csv_table import TableError
from palletloc.io.measurements import read_measurements
from palletloc.io.path_file import read_path, with_rates
from palletloc.io.path_frame import PathForm, PoseFrame
from palletloc.io.reading import InputError
from palletloc.io.recording import read_recording
from palletloc.io.truth import read_truth
from palletloc.trajectory import Trajectory, TrajectoryError

OWN = ("time_s", "x_m", "y_m", "yaw_rad", "speed_mps", "yaw_rate_radps")
RATES = OWN[4:]
START = 1_700_000_000
TIMES: FloatArray = np.linspace(START, START + 2.0, 9)
SPEED, TURN = 0.8, 0.3
YAW: FloatArray = 0.2 + TURN * (TIMES - START)
X, Y = SPEED / TURN * (np.sin(YAW) - math.sin(0.2)), SPEED / TURN * (math.cos(0.2) - np.cos(YAW))
"""A drive on a circle, whose speed and yaw rate do not change."""
OPTICAL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""Columns: the axes of a camera (x right, y down, z forward) in a body with x forward, y left and z up: REP 103."""


def quaternions(turn: Rotation | None = None) -> FloatArray:
    return (Rotation.from_euler("z", YAW[:, None]) * (turn or Rotation.identity())).as_quat()


def nanoseconds(time: float) -> str:
    return str(START * 10**9 + round((time - START) * 1e9))


def own() -> str:
    rows = (
        f"{t!r},{x!r},{y!r},{yaw!r},{SPEED},{TURN}" for t, x, y, yaw in np.column_stack([TIMES, X, Y, YAW]).tolist()
    )
    return "\n".join([",".join(OWN), *rows])


def with_index() -> str:
    header, *rows = own().splitlines()
    return "\n".join([f",{header}", *(f"{number},{row}" for number, row in enumerate(rows))])


def without_rates() -> str:
    return "\n".join(line.rsplit(",", 2)[0] for line in own().splitlines())


def with_quaternions() -> str:
    rows = (",".join(map(repr, row)) for row in np.column_stack([TIMES, X, Y, quaternions()]).tolist())
    return "\n".join(["time_s,x_m,y_m,qx,qy,qz,qw", *rows])


def tum(mark: str = " ", header: str = "") -> str:
    rows = (
        mark.join(f"{value:.9f}" for value in (t, x, y, 0.0, *q))
        for t, x, y, q in zip(TIMES, X, Y, quaternions(), strict=True)
    )
    return "\n".join([*([header] if header else []), *rows])


def euroc() -> str:
    """``state_groundtruth_estimate0/data.csv``: nanoseconds, and the scalar of the quaternion first."""
    names = "#timestamp, p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], q_RS_y [], q_RS_z []"
    names += ", v_RS_R_x [m s^-1], v_RS_R_y [m s^-1], v_RS_R_z [m s^-1], b_w_RS_S_x [rad s^-1]"
    rows = (
        f"{nanoseconds(t)},{x:.9f},{y:.9f},0.0,{q[3]:.9f},{q[0]},{q[1]},{q[2]:.9f},9,9,9,0.1"
        for t, x, y, q in zip(TIMES, X, Y, quaternions(), strict=True)
    )
    return "\n".join([names, *rows])


def rostopic() -> str:
    """``rostopic echo -p /odom`` of nav_msgs/Odometry: wiki.ros.org/rostopic; the message's own stamp counts."""
    covariance = [f"field.pose.covariance{number}" for number in range(36)]
    names = [
        *("%time", "field.header.seq", "field.header.stamp", "field.header.frame_id", "field.child_frame_id"),
        *(f"field.pose.pose.position.{axis}" for axis in "xyz"),
        *(f"field.pose.pose.orientation.{axis}" for axis in "xyzw"),
        *covariance,
        *(f"field.twist.twist.linear.{axis}" for axis in "xyz"),
        *(f"field.twist.twist.angular.{axis}" for axis in "xyz"),
    ]
    rows = (
        [nanoseconds(t + 0.1), "7", nanoseconds(t), "odom", "base_link", f"{x:.9f}", f"{y:.9f}", "0.0"]
        + [f"{value:.9f}" for value in q] + ["0.0"] * 36 + [f"{SPEED}", "0.0", "0.0", "0.0", "0.0", f"{TURN}"]
        for t, x, y, q in zip(TIMES, X, Y, quaternions(), strict=True)
    )  # fmt: skip
    return "\n".join([",".join(names), *(",".join(row) for row in rows)])


def plotjuggler() -> str:
    """What PlotJuggler's CSV exporter writes: one row for each time of any series, the others empty."""
    names = ["__time", "/battery/voltage", "/odom/header/stamp/sec", "/odom/header/stamp/nanosec"]
    names += [f"/odom/pose/pose/position/{axis}" for axis in "xyz"]
    names += [f"/odom/pose/pose/orientation/{axis}" for axis in "xyzw"]
    names += ["/odom/twist/twist/linear/x", "/odom/twist/twist/angular/z"]
    lines = [",".join(names)]
    for t, x, y, q in zip(TIMES, X, Y, quaternions(), strict=True):
        lines.append(f"{t - 0.01:.6f},12.5" + "," * 11)
        stamp = f"{int(t)},{round((t - int(t)) * 1e9)}"
        place = f"{x:.9f},{y:.9f},0,{q[0]},{q[1]},{q[2]:.9f},{q[3]:.9f}"
        lines.append(f"{t + 0.02:.6f},,{stamp},{place},{SPEED},{TURN}")
    return "\n".join(lines)


def german() -> str:
    rows = (f"{t:.3f};{x:.6f};{y:.6f};{math.degrees(yaw):.6f}" for t, x, y, yaw in zip(TIMES, X, Y, YAW, strict=True))
    return "\n".join(["time [s];x [m];y [m];yaw [deg]", *(row.replace(".", ",") for row in rows)])


FILES: dict[str, Callable[[], str]] = {
    "own": own,
    "index": with_index,
    "no rates": without_rates,
    "quaternions": with_quaternions,
    "tum": tum,
    "tum with commas": lambda: tum(","),
    "tum with a comment": lambda: tum(header="# timestamp tx ty tz qx qy qz qw"),
    "tum with a header": lambda: tum(header="timestamp tx ty tz qx qy qz qw"),
    "tum with commas and a header": lambda: tum(",", "#timestamp,tx,ty,tz,qx,qy,qz,qw"),
    "euroc": euroc,
    "rostopic": rostopic,
    "plotjuggler": plotjuggler,
    "degrees and decimal commas": german,
}


def stored(folder: Path, text: str, name: str = "odometry.csv") -> Path:
    path = folder / name
    path.write_text(text + "\n")
    return path


def assert_drive(path: Trajectory, atol: float = 2e-6) -> None:
    assert_allclose(path.times, TIMES, atol=5e-7, rtol=0)
    for name, expected in (("x", X), ("y", Y), ("yaw", YAW)):
        assert_allclose(getattr(path, name), expected, atol=atol, err_msg=name)


@pytest.mark.parametrize("kind", FILES)
@pytest.mark.parametrize("name", ["odometry.csv", "forklift.tum", "poses.txt"])
def test_a_file_is_told_by_what_stands_in_it_whatever_its_name_is(tmp_path: Path, kind: str, name: str) -> None:
    found = read_path(stored(tmp_path, FILES[kind](), name), OWN, RATES)
    assert_drive(found.trajectory)
    if found.trajectory.speed is not None and found.trajectory.yaw_rate is not None:
        assert_allclose(found.trajectory.speed, SPEED)
        assert_allclose(found.trajectory.yaw_rate, TURN)
    assert (found.trajectory.speed is not None) == (kind in ("own", "index", "rostopic", "plotjuggler"))
    noted = ("taken for nanoseconds",) if kind == "euroc" else ()
    assert tuple(note.rsplit(": ", 1)[1] for note in found.notes) == noted


def test_rates_that_are_missing_come_from_the_poses(tmp_path: Path) -> None:
    path = with_rates(read_path(stored(tmp_path, without_rates()), OWN, RATES).trajectory)
    assert path.speed is not None
    assert path.yaw_rate is not None
    # Chords of a circle are shorter than its arcs: sin(a)/a at a quarter of a second of 0.3 rad/s.
    assert_allclose(path.speed[1:-1], SPEED, rtol=1e-3)
    assert_allclose(path.speed[[0, -1]], SPEED, rtol=1e-2)
    assert_allclose(path.yaw_rate, TURN, rtol=1e-9)
    backwards = with_rates(Trajectory(np.asarray(TIMES), -X[::-1], -Y[::-1], np.asarray(YAW)[::-1]))
    still = with_rates(Trajectory(*np.zeros((4, 1))))
    assert backwards.yaw_rate is not None
    assert_allclose(backwards.yaw_rate, -TURN)
    assert still.speed is not None
    assert still.speed.tolist() == [0.0]


def kitti(rotations: FloatArray, places: FloatArray) -> str:
    """Return lines of the upper three rows of each pose (KITTI's odometry benchmark, development kit)."""
    rows = np.concatenate([rotations, places[:, :, None]], axis=2).reshape(-1, 12)
    return "\n".join(" ".join(f"{value:.9e}" for value in row) for row in rows)


@pytest.mark.parametrize("frame", [None, PoseFrame.OPTICAL])
def test_kitti_has_its_times_in_another_file_and_a_cameras_frame(tmp_path: Path, frame: PoseFrame | None) -> None:
    bodies = Rotation.from_euler("z", YAW[:, None]).as_matrix()
    places = np.column_stack([X, Y, np.zeros(9)])
    text = kitti(OPTICAL.T @ bodies @ OPTICAL, places @ OPTICAL)
    times = stored(tmp_path, "\n".join(f"{time:.6e}" for time in TIMES - START), "times.txt")
    path = stored(tmp_path, text, "poses.txt")
    found = read_path(path, OWN, RATES, PathForm(frame, times=times)).trajectory
    assert_allclose(found.times, TIMES - START, atol=1e-6)
    assert_allclose([found.x, found.y, found.yaw], [X, Y, YAW], atol=1e-6)
    level = read_path(
        stored(tmp_path, kitti(bodies, places), "level.txt"), OWN, RATES, PathForm(times=times)
    ).trajectory
    assert_allclose([level.x, level.y, level.yaw], [X, Y, YAW], atol=1e-6)
    with pytest.raises(TableError, match=r"poses\.txt: holds matrices without times, in KITTI form; .*state 'times'"):
        read_path(path, OWN, RATES)
    stored(tmp_path, "0.0\n1.0", "times.txt")
    with pytest.raises(TableError, match=r"times\.txt: expected 9 lines with one time each"):
        read_path(path, OWN, RATES, PathForm(times=times))


def test_poses_of_a_camera_are_turned_where_that_is_stated(tmp_path: Path) -> None:
    """A tracker in a level world, of a camera whose z looks ahead."""
    turned = quaternions(Rotation.from_matrix(OPTICAL))
    rows = (
        " ".join(f"{value:.9f}" for value in (t, x, y, 0.0, *q))
        for t, x, y, q in zip(TIMES, X, Y, turned, strict=True)
    )
    path = stored(tmp_path, "\n".join(rows), "camera.tum")
    with pytest.raises(TableError, match=r"camera\.tum, line 1: the pose is tilted by .* state 'frame: optical'"):
        read_path(path, OWN)
    assert_drive(read_path(path, OWN, (), PathForm(PoseFrame.OPTICAL)).trajectory)
    # The same as any fixed rotation of a body on the forklift.
    assert_drive(read_path(path, OWN, (), PathForm(rotation=Rotation.from_matrix(OPTICAL))).trajectory)


def test_a_row_that_repeats_the_one_before_is_dropped_with_a_note(tmp_path: Path) -> None:
    for text, name in ((own(), "odometry.csv"), (tum(), "a.tum"), (rostopic(), "b.csv")):
        lines = text.splitlines()
        path = stored(tmp_path, "\n".join([*lines[:4], lines[3], *lines[4:]]), name)
        found = read_path(path, OWN, RATES)
        assert_drive(found.trajectory)
        assert found.notes == (f"{path}, line 5: is line 4 again; dropped",)
        path = stored(tmp_path, "\n".join([*lines[:4], *[lines[3]] * 3, *lines[4:]]), name)
        assert read_path(path, OWN, RATES).notes == (f"{path}, line 5: is line 4 again; dropped, and 2 more",)


def test_a_repeated_time_with_other_values_shows_the_digits_that_differ(tmp_path: Path) -> None:
    lines = tum().splitlines()
    lines[3] = lines[3].replace("1700000000.75", "1700000000.25")
    said = r"a\.tum, line 4: the time 1700000000\.25 does not follow 1700000000\.5 of line 3; expected strictly"
    with pytest.raises(TableError, match=said):
        read_path(stored(tmp_path, "\n".join(lines), "a.tum"), OWN)


@pytest.mark.parametrize(("factor", "unit"), [(1e9, "nanoseconds"), (1e6, "microseconds"), (1e3, "milliseconds")])
def test_times_in_another_unit_are_one_line_with_the_factor(tmp_path: Path, factor: float, unit: str) -> None:
    header, *rows = own().splitlines()
    scaled = (f"{round(float(row.split(',', 1)[0]) * factor)},{row.split(',', 1)[1]}" for row in rows)
    path = stored(tmp_path, "\n".join([header, *scaled]))
    with pytest.raises(InputError, match=rf"odometry\.csv: time_s: 1\.7e\d+: {unit}\?"):
        read_path(path, OWN, RATES)


@pytest.mark.parametrize("name", ["shots.csv", "odometry.csv"])
def test_a_recording_in_nanoseconds_is_refused(folder: Path, name: str) -> None:
    path = folder / name
    header, *rows = path.read_text().splitlines()
    turned = [
        f"{1_700_000_000_000_000_000 + round(float(row.split(',', 1)[0]) * 1e9)},{row.split(',', 1)[1]}"
        for row in rows
    ]
    path.write_text("\n".join([header, *turned]) + "\n")
    with pytest.raises(InputError, match=rf"{name}: time_s: 1\.7e18: nanoseconds\?"):
        read_recording(folder)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("0,0,0,0,0,0", r"line 1: expected eight numbers 'time x y z qx qy qz qw', got '0,0,0,0,0,0'"),
        ("time,lat,lon,x\n0,0,0,0", r"line 1: no column for the y \(such as y_m, position\.y"),
        ("time,x,y\n0,0,0", r"line 1: no column for the heading"),
        ("1700000000,5,odom,base_link,1,2,3", "line 1: is what 'ros2 topic echo --csv' prints"),
        ("header: \n  seq: 1", "line 1: is what 'rostopic echo' or 'ros2 topic echo' prints"),
        ("VERTEX_SE2 0 1 2 0.1", "line 1: is a graph of g2o"),
        ("$GPGGA,1,2,3", "line 1: is sentences of a GNSS receiver"),
        ('{"poses": []}', "line 1: is JSON"),
        ("/a/pose/position/x,/b/pose/position/x,time\n1,2,3", r"'/a/pose/position/x' and '/b/.* may both be x"),
        ("time,x,y,yaw\n0,0,0,0\n1,0,zero,0", r"line 3: y: expected a finite number, got 'zero'"),
        ("time,x,y,yaw\n0,0,0,0\n1,0,0", r"line 3: expected 4 cells, got 3"),
        ("time,x,y,yaw\n", r"has no rows"),
        ("time,x,y,yaw\n1e300,0,0,0", r"line 2: time: expected seconds from .* got 1e\+300"),
        ("time,x,y,yaw\n1700000000000,0,0,0", r"time_s: 1\.7e12: milliseconds\?"),
    ],
)
@pytest.mark.parametrize("name", ["odometry.csv", "a.tum"])
def test_what_is_no_path_is_named(tmp_path: Path, text: str, said: str, name: str) -> None:
    with pytest.raises(InputError, match=said) as caught:
        read_path(stored(tmp_path, text, name), OWN, RATES)
    assert "\n" not in str(caught.value)


def test_a_recording_takes_odometry_of_any_form_and_name(folder: Path) -> None:
    (folder / "odometry.csv").unlink()
    rows = ("0.0 0 0 0 0 0 0 1", "0.5 0.2 0 0 0 0 0 1", "1.0 0.4 0 0 0 0 0 1", "1.0 0.4 0 0 0 0 0 1")
    (folder / "poses.txt").write_text("\n".join(rows))
    path = folder / "recording.yaml"
    path.write_text(path.read_text() + "odometry: {file: poses.txt}\n")
    recording = read_recording(folder)
    assert recording.odometry.speed is not None
    assert recording.odometry.yaw_rate is not None
    assert_allclose(recording.odometry.speed, 0.4)
    assert_allclose(recording.odometry.yaw_rate, 0.0)
    assert_allclose(recording.odometry.pose_at(0.75).as_array(), LevelPose(0.3, 0.0, 0.0, 0.0).as_array(), atol=1e-12)
    assert recording.notes == (f"{folder / 'poses.txt'}, line 4: is line 3 again; dropped",)
    path.write_text(path.read_text().replace("poses.txt", "poses.txt, fram: optical"))
    with pytest.raises(PalletLocError, match=r"odometry: unknown key 'fram'; did you mean 'frame'\?"):
        read_recording(folder)


def test_the_faults_that_were_found_are_right_now(tmp_path: Path, folder: Path, shared_data: Path) -> None:
    faults = shared_data / "faults"
    found = read_path(faults / "repeated-stamp" / "odometry.csv", OWN, RATES)
    assert found.trajectory.x.tolist() == [0.0, 0.01, 0.02]
    assert "line 4: is line 3 again" in found.notes[0]
    (tmp_path / "truth").mkdir()
    (tmp_path / "truth" / "pallets.csv").write_text("id,model,x_m,y_m,z_m,yaw_rad\n")
    (tmp_path / "truth" / "forklift.tum").write_bytes((faults / "tum-time-message" / "forklift.tum").read_bytes())
    truth = read_truth(tmp_path)
    assert truth.forklift.x.tolist() == [0.0, 0.1, 0.2]
    assert "line 3: is line 2 again" in truth.notes[0]
    for name in ("odometry.csv", "shots.csv"):
        before = (folder / name).read_bytes()
        (folder / name).write_bytes((faults / "stamps-in-nanoseconds" / name).read_bytes())
        with pytest.raises(InputError, match=rf"{name}: time_s: 1\.7e18: nanoseconds\?"):
            read_recording(folder)
        (folder / name).write_bytes(before)
    with pytest.raises(InputError, match=r"measurements\.csv: time_s: 1\.7e18: nanoseconds\?"):
        read_measurements(faults / "stamps-in-nanoseconds" / "measurements.csv")


def test_clocks_that_differ_are_told_with_their_distance() -> None:
    path = Trajectory(TIMES, X, Y, YAW)
    said = r"no pose at 1699996400\.25 s: .* between 1700000000 s and 1700000002 s .*, and it is 3599\.75 s before"
    with pytest.raises(TrajectoryError, match=said):
        path.pose_at(START - 3600 + 0.25)
    with pytest.raises(TrajectoryError, match=r"no pose at 7 s: .* it is 1699999993 s before"):
        path.pose_at(7.0)
    assert seconds(START + 0.1, START + 0.2) == ("1700000000.1", "1700000000.2")
    assert seconds(0.123456789, 3.0) == ("0.123457", "3")
