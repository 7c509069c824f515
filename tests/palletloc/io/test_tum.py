from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from palletloc.io.reading import InputError
from palletloc.io.truth import TruePallet, Truth, read_truth, write_truth
from palletloc.io.tum import read_tum
from palletloc.trajectory import Trajectory


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


def test_a_file_without_poses_is_an_error(tmp_path: Path) -> None:
    (tmp_path / "a.tum").write_text("# nothing\n")
    with pytest.raises(InputError, match=r"a\.tum: has no poses"):
        read_tum(tmp_path / "a.tum")
