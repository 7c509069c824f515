import weakref
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from palletloc import LevelPose, Mounting, PalletLocError, Recording, ShelfPlane, read_recording
from palletloc.cameras import Equirectangular
from palletloc.geometry import Image, wrap_angle
from palletloc.io.atomic import OutputError
from palletloc.io.images import ImageError
from palletloc.io.recording import ShotError, ShotFile, check_shelf, write_recording
from palletloc.io.truth import TruePallet, Truth, read_truth
from palletloc.prior import PriorConfig
from palletloc.trajectory import TrajectoryError

PRIOR = PriorConfig(drift_rate_deg_s=0.5, max_drift_deg=0.8)


def change(folder: Path, file: str, old: str, new: str) -> None:
    path = folder / file
    assert old in path.read_text()
    path.write_text(path.read_text().replace(old, new))


def images(recording: Recording) -> Iterator[Image]:
    return (recording.image(shot) for shot in recording.shots)


def test_everything_but_the_images_is_read(folder: Path) -> None:
    recording = read_recording(str(folder))
    assert recording.camera == Equirectangular(64, 32)
    assert_allclose(recording.forklift_from_camera.translation, [0.3, -0.1, 1.8])
    assert recording.shelf == ShelfPlane(3.0, 2.0, float(np.radians(-90.0)), (0.0, 1.55))
    assert [(model.name, model.width) for model in recording.models] == [("mine", 1.1), ("epal1-1200", 1.2)]
    assert recording.shots[1] == ShotFile(0.5, "images/1.png")
    pose = recording.odometry.pose_at(0.75)
    assert (pose.x, pose.y, pose.yaw) == pytest.approx((0.3, 0.0, 0.075))
    assert recording.odometry.speed == pytest.approx([0.4, 0.4, 0.4])
    assert recording.odometry.yaw_rate == pytest.approx([0.1, 0.1, 0.1])
    assert (recording.translation_sigma, recording.rotation_sigma) == (None, None)
    assert recording.mounting.translation_sigma == Mounting(recording.forklift_from_camera).translation_sigma


def test_the_mountings_sigmas_are_in_metres_and_radians(folder: Path) -> None:
    sigmas = "-1.2], translation_sigma_m: [0.001, 0.002, 0.003], rotation_sigma_deg: [90, 18, 0]"
    change(folder, "recording.yaml", "-1.2]", sigmas)
    recording = read_recording(folder)
    assert recording.translation_sigma == (0.001, 0.002, 0.003)
    assert recording.rotation_sigma == pytest.approx((np.pi / 2, np.pi / 10, 0))
    assert recording.mounting.sigma == pytest.approx([0.001, 0.002, 0.003, np.pi / 2, np.pi / 10, 0])
    assert_allclose(recording.mounting.center, [0.3, -0.1, 1.8])


def test_the_users_pallets_are_optional(folder: Path) -> None:
    (folder / "pallets.yaml").unlink()
    change(folder, "recording.yaml", "mine, ", "")
    assert [model.name for model in read_recording(folder).models] == ["epal1-1200"]


def test_images_are_read_when_asked_for_and_not_kept(folder: Path) -> None:
    recording = read_recording(folder)
    image = recording.image(recording.shots[0])
    assert image.shape == (32, 64, 3)
    assert recording.image(recording.shots[0], gray=True).shape == (32, 64)
    alive = weakref.ref(image)
    del image
    assert alive() is None
    (folder / "images" / "0.png").unlink()
    with pytest.raises(ImageError, match=r"images/0\.png: no such file"):
        recording.image(recording.shots[0])
    assert read_recording(folder).image(recording.shots[1]).shape == (32, 64, 3)


def test_an_image_of_another_size_is_an_error(folder: Path) -> None:
    change(folder, "recording.yaml", "width: 64", "width: 66")
    recording = read_recording(folder)
    with pytest.raises(ImageError, match=r"0\.png: is 64 x 32 px, the camera is 66 x 32 px"):
        recording.image(recording.shots[0])


LENS = "{model: kannala_brandt, width: 64, height: 32, focal_px: [20, 20], center_px: [32, 16]"
BAD = [
    ("recording.yaml", "shelf:", "shelv:", r"recording\.yaml: unknown key 'shelv'; did you mean 'shelf'\?"),
    ("recording.yaml", "mine", "mime", r"recording\.yaml: pallets: unknown pallet model 'mime'; .*'mine'"),
    ("recording.yaml", "-90.0", ".nan", r"recording\.yaml: shelf\.facing_deg: expected a finite number"),
    (
        "recording.yaml",
        "{model: equirectangular, width: 64, height: 32}",
        LENS + ", distortion: [-1, 0, 0, 0], max_angle_deg: 95}",
        r"recording\.yaml: camera: .*max_angle",
    ),
    ("pallets.yaml", "width_m: 1.1", "widht_m: 1.1", r"pallets\.yaml: mine: .*'widht_m'; did you mean 'width_m'"),
    ("shots.csv", "file\n", "name\n", r"shots\.csv, line 1: unknown column 'name'"),
    ("shots.csv", "0.5,", "half,", r"shots\.csv, line 3: time_s: expected a finite number, got 'half'"),
    ("shots.csv", "0.5,", "0.0,", r"shots\.csv, line 3: time_s: 0\.0 repeats 0\.0 of line 2"),
    ("shots.csv", "0.5,", "1.5,", r"shots\.csv, line 4: time_s: 1\.0 is earlier than 1\.5 of line 3"),
    ("shots.csv", "images/1.png", "", r"shots\.csv, line 3: file: expected a text"),
    ("odometry.csv", "speed_mps", "speed", r"odometry\.csv, line 1: unknown column 'speed'; .*'speed_mps'"),
    ("odometry.csv", "0.05", "NaN", r"odometry\.csv, line 3: yaw_rad: expected a finite number, got 'NaN'"),
    ("odometry.csv", "\n1.0,", "\n0.5,", r"odometry\.csv, line 4: time_s: 0\.5 repeats 0\.5 of line 3"),
    ("odometry.csv", "0.1,0.4,0.1\n", "0.1,0.4", r"odometry\.csv, line \d: expected 6 cells, got 5"),
]


@pytest.mark.parametrize(("file", "old", "new", "said"), BAD)
def test_bad_input_is_an_error_with_file_and_place(folder: Path, file: str, old: str, new: str, said: str) -> None:
    change(folder, file, old, new)
    with pytest.raises(PalletLocError, match=said) as caught:
        read_recording(folder)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("file", ["recording.yaml", "shots.csv", "odometry.csv"])
def test_a_missing_file_or_folder_and_a_table_without_rows_are_errors_that_name_it(folder: Path, file: str) -> None:
    header = (folder / file).read_text().splitlines()[0] + "\n"
    (folder / file).unlink()
    with pytest.raises(PalletLocError, match=rf"{file}: no such file"):
        read_recording(folder)
    if file.endswith(".csv"):
        (folder / file).write_text(header)
        with pytest.raises(PalletLocError, match=rf"{file}: has no rows; expected at least one"):
            read_recording(folder)
    with pytest.raises(PalletLocError, match=r"none: no such folder; expected a recording"):
        read_recording(folder / "none")


@pytest.mark.parametrize(
    ("x", "y", "facing_deg", "said"),
    [
        (3.0, 0.0, -90.0, r"on the plane, 0\.10 m in front"),
        (3.0, -0.2, -90.0, r"on the plane, -0\.10 m in front"),
        (0.45, 5.0, 180.0, r"on the plane, 0\.15 m in front"),
        (3.0, 2.0, 90.0, r"behind the plane, -2\.10 m in front"),
        (3.0, -2.0, -90.0, r"behind the plane, -1\.90 m in front"),
    ],
)
def test_a_shelf_through_or_behind_the_camera_is_an_error(
    folder: Path, x: float, y: float, facing_deg: float, said: str
) -> None:
    check_shelf(read_recording(folder))  # in front of the camera it passes
    recording = replace(read_recording(folder), shelf=ShelfPlane(x, y, np.radians(facing_deg)))
    with pytest.raises(PalletLocError, match=rf"recording\.yaml: shelf: at the first shot the camera is {said}"):
        check_shelf(recording)


def test_odometry_of_another_clock_is_found_with_the_shelf(folder: Path) -> None:
    change(folder, "shots.csv", "0.0,", "-1.7,")
    with pytest.raises(TrajectoryError, match=r"no pose at -1\.7 s"):
        check_shelf(read_recording(folder))


def test_a_recording_written_is_the_recording_read(folder: Path, tmp_path: Path) -> None:
    sigmas = "-1.2], translation_sigma_m: [0.001, 0.002, 0.003], rotation_sigma_deg: [0.1, 0.2, 0.3]"
    change(folder, "recording.yaml", "-1.2]", sigmas)
    recording = read_recording(folder)
    truth = Truth(recording.odometry, (TruePallet("A", "mine", LevelPose(1.0, 2.0, 0.0, 1.5)),))
    write_recording(tmp_path / "copy", recording, images(recording), truth)
    copy = read_recording(tmp_path / "copy")
    for name in ("camera", "models", "shots", "translation_sigma", "rotation_sigma"):
        assert getattr(copy, name) == getattr(recording, name), name
    assert copy.shelf.facing == pytest.approx(recording.shelf.facing, abs=1e-12)
    assert replace(copy.shelf, facing=0.0) == replace(recording.shelf, facing=0.0)
    assert_allclose(copy.forklift_from_camera.as_matrix(), recording.forklift_from_camera.as_matrix(), atol=1e-12)
    for name in ("times", "x", "y", "speed", "yaw_rate"):
        assert_array_equal(getattr(copy.odometry, name), getattr(recording.odometry, name))
    assert np.abs(wrap_angle(copy.odometry.yaw - recording.odometry.yaw)).max() < 1e-6
    for shot in recording.shots:
        assert_array_equal(copy.image(shot), recording.image(shot))
    assert read_truth(tmp_path / "copy").pallets == truth.pallets


@pytest.mark.parametrize("kind", [KeyboardInterrupt, RuntimeError])
def test_an_interrupted_write_leaves_nothing(folder: Path, tmp_path: Path, kind: type[BaseException]) -> None:
    recording = read_recording(folder)

    def broken() -> Iterator[Image]:
        yield recording.image(recording.shots[0])
        raise kind

    with pytest.raises(kind):
        write_recording(tmp_path / "copy", recording, broken())
    assert [path.name for path in tmp_path.iterdir()] == [folder.name]


def test_images_that_do_not_fit_the_shots_and_a_folder_in_use_are_refused(folder: Path, tmp_path: Path) -> None:
    recording = read_recording(folder)
    with pytest.raises(ValueError, match="shorter"):
        write_recording(tmp_path / "copy", recording, [recording.image(recording.shots[0])])
    with pytest.raises(ValueError, match="not the camera's size"):
        write_recording(tmp_path / "copy", recording, [np.zeros((4, 8), np.uint8)] * 3)
    outside = replace(recording, shots=(ShotFile(0.0, "../0.png"),))
    with pytest.raises(ValueError, match="inside the recording"):
        write_recording(tmp_path / "copy", outside, [recording.image(recording.shots[0])])
    assert [path.name for path in tmp_path.iterdir()] == [folder.name]
    with pytest.raises(OutputError, match="is there already"):
        write_recording(folder, recording, images(recording))


def test_the_digest_follows_the_files_and_not_their_place(folder: Path, tmp_path: Path) -> None:
    before = read_recording(folder).digest()
    moved = folder.rename(tmp_path / "moved")
    assert read_recording(moved).digest() == before
    for file, old, new in (
        ("odometry.csv", "0.05", "0.06"),
        ("shots.csv", "0.5,", "0.6,"),
        ("pallets.yaml", "0.144", "0.145"),
        ("recording.yaml", "1.55", "1.56"),
    ):
        change(moved, file, old, new)
        after = read_recording(moved).digest()
        assert after != before, file
        before = after


@pytest.mark.parametrize(
    ("name", "shots", "model"), [("dev_lab", 20, "t11-plastic"), ("dev_warehouse", 12, "epal1-1200")]
)
def test_the_shared_recordings_are_read(shared_data: Path, name: str, shots: int, model: str) -> None:
    recording = read_recording(shared_data / name)
    check_shelf(recording)
    assert len(recording.shots) == shots
    assert [model.name for model in recording.models] == [model]
    assert recording.image(recording.shots[-1]).shape == (1920, 3840, 3)
    for shot in recording.shots:
        recording.odometry.pose_at(shot.time)


@pytest.mark.parametrize("time", [0.0, 0.25, 1.0, 1.7, 2.0])
def test_the_shelf_stays_where_it_is_in_odom(blank_recording: Path, time: float) -> None:
    recording = read_recording(blank_recording)
    shelf = recording.shelf_at(time, PRIOR)
    odom_from_forklift = recording.odometry.pose_at(time).transform()
    there = odom_from_forklift * LevelPose(shelf.x, shelf.y, 0.0, shelf.facing).transform()
    given = LevelPose(recording.shelf.x, recording.shelf.y, 0.0, recording.shelf.facing).transform()
    np.testing.assert_allclose(there.as_matrix(), given.as_matrix(), atol=1e-9)
    assert shelf.levels == recording.shelf.levels


def test_the_heading_may_drift_as_long_as_the_odometry_runs_and_a_time_without_it_is_an_error(
    blank_recording: Path,
) -> None:
    recording = read_recording(blank_recording)
    drifts = [np.degrees(recording.shelf_at(time, PRIOR).drift) for time in (-1.0, 0.0, 1.0, 2.0)]
    np.testing.assert_allclose(drifts, [0.5, 0.0, 0.5, 0.8], atol=1e-12)
    later = replace(recording, odometry=replace(recording.odometry, times=np.array([5.0, 6.0, 7.0])))
    assert np.degrees(later.shelf_at(6.0, PRIOR).drift) == pytest.approx(0.5)
    with pytest.raises(ShotError, match=r"odometry\.csv: no pose at 9 s: expected a time between 0 s and 2 s"):
        recording.shelf_at(9.0, PRIOR)


def test_a_recording_is_its_shots_in_order(blank_recording: Path) -> None:
    recording = read_recording(blank_recording)
    shots = list(recording)
    assert [(shot.time, shot.file) for shot in shots] == [(0.5 * n, f"images/{n}.png") for n in range(4)]
    assert [int(shot.image[0, 0, 0]) for shot in shots] == [100, 101, 102, 103]
    for shot in shots:
        assert shot.camera is recording.camera
        np.testing.assert_array_equal(shot.mounting.center, recording.mounting.center)
