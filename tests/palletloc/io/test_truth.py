from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from palletloc.geometry import LevelPose, wrap_angle
from palletloc.io.csv_table import TableError
from palletloc.io.reading import InputError
from palletloc.io.truth import TruePallet, Truth, read_truth, read_tum, write_truth
from palletloc.trajectory import Trajectory


def turning() -> Truth:
    times = np.linspace(0, 4, 9)
    path = Trajectory(times, np.cos(times), np.sin(times), times + np.pi / 2, z=0.01 * times)
    return Truth(
        path, (TruePallet("A", "t11", LevelPose(4.15, 1.89, 0.0, 1.5)), TruePallet("B", "e,1", path.pose_at(1)))
    )


def test_truth_written_is_truth_read(tmp_path: Path) -> None:
    truth = turning()
    write_truth(tmp_path, truth)
    again = read_truth(tmp_path)
    np.testing.assert_array_equal(again.forklift.times, truth.forklift.times)
    for name in ("x", "y", "z"):
        assert_allclose(getattr(again.forklift, name), getattr(truth.forklift, name), atol=0.51e-6)
    assert np.abs(wrap_angle(again.forklift.yaw - truth.forklift.yaw)).max() < 0.51e-6
    assert np.abs(np.diff(again.forklift.yaw)).max() < 1
    assert [(pallet.id, pallet.model) for pallet in again.pallets] == [("A", "t11"), ("B", "e,1")]
    for before, after in zip(truth.pallets, again.pallets, strict=True):
        assert_allclose(after.world_from_pallet.as_array(), before.world_from_pallet.as_array(), atol=0.51e-6)


@pytest.mark.parametrize(
    ("file", "old", "new", "said"),
    [
        ("forklift.csv", "\n0.5,", "\n0.0,", r"line 3: time_s: 0.0 repeats 0.0 of line 2"),
        ("forklift.csv", "z_m", "z", r"line 1: unknown column 'z'"),
        ("pallets.csv", "\nB", "\nA", r"line 3: id: 'A' stands in line 2 already"),
        ("pallets.csv", "4.15", "NaN", r"line 2: x_m: expected a finite number"),
    ],
)
def test_bad_truth_is_an_error_with_file_and_line(tmp_path: Path, file: str, old: str, new: str, said: str) -> None:
    write_truth(tmp_path, turning())
    path = tmp_path / "truth" / file
    assert old in path.read_text()
    path.write_text(path.read_text().replace(old, new))
    with pytest.raises(TableError, match=rf"{file}, {said}"):
        read_truth(tmp_path)


def test_a_recording_without_truth_or_with_a_path_without_poses_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"truth: no such folder; expected forklift\.csv and pallets\.csv"):
        read_truth(tmp_path)
    write_truth(tmp_path, turning())
    (tmp_path / "truth" / "forklift.csv").write_text("time_s,x_m,y_m,z_m,yaw_rad\n")
    with pytest.raises(TableError, match=r"forklift\.csv: has no rows"):
        read_truth(tmp_path)
    (tmp_path / "a.tum").write_text("# nothing\n")
    with pytest.raises(InputError, match=r"a\.tum: has no poses"):
        read_tum(tmp_path / "a.tum")


@pytest.mark.parametrize(("name", "count"), [("dev_lab", 3), ("dev_warehouse", 4)])
def test_the_shared_truth_is_read(shared_data: Path, name: str, count: int) -> None:
    truth = read_truth(shared_data / name)
    assert len(truth.pallets) == count
    assert truth.forklift.span[1] > 6


def curve() -> Trajectory:
    times = np.linspace(1.0, 5.0, 9)
    return Trajectory(times, np.cos(times), np.sin(times), 1.5 * times, z=0.01 * times)


def written(path: Path, tilt: float = 0.01) -> Path:
    rows = ["# time x y z qx qy qz qw", ""]
    samples = curve()
    for time in samples.times:
        pose = samples.pose_at(float(time))
        x, y, z, w = Rotation.from_euler("ZYX", [pose.yaw, tilt, 0.0]).as_quat()
        rows.append(f"{time} {pose.x} {pose.y} {pose.z} {x} {y} {z} {w}")
    path.write_text("\n".join(rows))
    return path


def test_positions_and_headings_are_read_and_the_tilt_is_dropped(tmp_path: Path) -> None:
    found = read_tum(written(tmp_path / "a.tum"))
    for name in ("times", "x", "y", "z"):
        assert_allclose(getattr(found, name), getattr(curve(), name), atol=1e-12)
    assert_allclose(np.unwrap(found.yaw - curve().yaw) - (found.yaw - curve().yaw)[0], 0, atol=1e-9)
    assert_allclose(np.cos(found.yaw), np.cos(curve().yaw), atol=1e-9)


def test_a_truth_may_hold_a_tum_file_in_place_of_the_table(tmp_path: Path) -> None:
    truth = Truth(curve(), (TruePallet("A", "t11", curve().pose_at(2.0)),))
    write_truth(tmp_path, truth)
    (tmp_path / "truth" / "forklift.csv").unlink()
    written(tmp_path / "truth" / "forklift.tum")
    pose = read_truth(tmp_path).forklift.pose_at(2.25)
    assert_allclose(pose.as_array(), curve().pose_at(2.25).as_array(), atol=1e-9)


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("9 0 0 0 0 0 1", r"line 12: expected eight numbers 'time x y z qx qy qz qw', got '9 0 0 0 0 0 1'"),
        ("9,0,0,0,0,0,0,1", r"line 12: expected eight numbers"),
        ("9 0 0 0 0 0 nan 1", r"line 12: expected eight numbers"),
        ("9 0 0 0 0 0 0 0.5", r"line 12: expected a quaternion of length 1, got 0.5"),
        ("9 0 0 0 1 0 0 0", r"line 12: the pose is tilted by 180.0 degrees, expected at most 5"),
        ("5 0 0 0 0 0 0 1", r"line 12: the time 5 does not follow 5 of line 11"),
    ],
)
def test_a_bad_line_is_an_error_that_names_it(tmp_path: Path, line: str, said: str) -> None:
    path = written(tmp_path / "a.tum")
    path.write_text(path.read_text() + "\n" + line)
    with pytest.raises(InputError, match=said):
        read_tum(path)
