"""The example with a camera and odometry of one's own, fed with what stands for both."""

import importlib.util
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import cv2
import numpy as np
import pytest

from palletloc import PalletLocError, read_recording
from palletloc.geometry import Image
from palletloc.io.recording import Recording
from tests.palletloc.cli.sample_runs import SAMPLE, true_poses
from tracking import Odometry, PalletTracker
from tracking.streaming import CameraShot

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "live_camera.py"


@pytest.fixture(scope="module")
def live() -> ModuleType:
    spec = importlib.util.spec_from_file_location("live_camera", EXAMPLE)
    assert spec
    assert spec.loader
    module = importlib.util.module_from_spec(spec)
    sys.modules["live_camera"] = module
    spec.loader.exec_module(module)
    return module


class Playback:
    """The images of a recording as ``cv2.VideoCapture`` would give them."""

    def __init__(self, recording: Recording) -> None:
        self._recording = recording
        self._shots = iter(recording.shots)
        self._time = 0.0

    def read(self) -> tuple[bool, Image]:
        shot = next(self._shots, None)
        if shot is None:
            return False, np.zeros((0, 0), np.uint8)
        self._time = shot.time
        return True, self._recording.image(shot)

    def get(self, name: int) -> float:
        assert name == cv2.CAP_PROP_POS_MSEC
        return 1000 * self._time


def test_pallets_of_a_video_are_followed_to_where_they_stand(
    live: ModuleType, capsys: pytest.CaptureFixture[str]
) -> None:
    recording = read_recording(SAMPLE)
    tracker = PalletTracker(models=recording.models)
    with (SAMPLE / "odometry.csv").open() as lines:
        source = live.merged(
            live.video_shots(Playback(recording), 0.0, 0.0), live.odometry_samples(lines, "odometry.csv")
        )
        events = list(live.follow(recording, source, tracker))
    assert [event.kind for event in events].count("confirmed") >= 2
    last = recording.shots[-1].time
    true = true_poses(SAMPLE, last).values()
    for state in tracker.tracks(last):
        assert min(np.linalg.norm(state.pose.as_array()[:3] - pose.as_array()[:3]) for pose in true) < 0.03
    printed = capsys.readouterr()
    used = [event for event in events if event.kind == "accepted" and event.track is not None]
    assert printed.out.count(" track ") == len(used) >= 10
    assert printed.err == ""


def test_frames_have_the_times_of_the_file_and_not_all_are_taken(live: ModuleType, tmp_path: Path) -> None:
    path = tmp_path / "drive.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 10.0, (64, 32))
    for number in range(20):
        writer.write(np.full((32, 64, 3), 10 * number, np.uint8))
    writer.release()
    shots = list(live.video_shots(cv2.VideoCapture(str(path)), 0.5, 100.0))
    assert [shot.time for shot in shots] == pytest.approx([100.0, 100.5, 101.0, 101.5], abs=1e-3)
    assert [round(float(np.mean(shot.load())), -1) for shot in shots] == [0, 50, 100, 150]
    setup = tmp_path / "setup"
    setup.mkdir()
    (setup / "recording.yaml").write_text((SAMPLE / "recording.yaml").read_text())
    (setup / "shots.csv").write_text("time_s,file\n0,none.jpg\n")
    (setup / "odometry.csv").write_text((SAMPLE / "odometry.csv").read_text())
    options = [str(setup), "--video", str(path), "--odometry", str(setup / "odometry.csv")]
    assert live.main(options) == 0  # frames of another size than the camera's are rejected one by one


def test_what_is_live_comes_through_until_both_sources_end_and_late_shots_are_dropped(live: ModuleType) -> None:
    def shots() -> Iterator[CameraShot]:
        for number in range(50):
            yield CameraShot(float(number), np.zeros((2, 4), np.uint8))

    samples = live.odometry_samples([f"{number},0,0,0" for number in range(200)], "lines")
    given = list(live.arriving(shots(), samples))
    assert sum(isinstance(each, Odometry) for each in given) == 200
    times = [each.time for each in given if isinstance(each, CameraShot)]
    assert 1 <= len(times) <= 50
    assert times == sorted(times)


def test_faults_of_a_source_are_one_line(
    live: ModuleType, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(PalletLocError, match=r"^wheels, line 2: expected time_s,x_m,y_m,yaw_rad, got 'a,b'$"):
        list(live.arriving([], live.odometry_samples(["0,0,0,0", "a,b"], "wheels")))
    (only,) = live.odometry_samples(["time_s,x_m,y_m,yaw_rad", "", "1.5,2,3,0.1,9,9"], "wheels")
    assert (only.time, only.pose.x, only.pose.y, only.pose.yaw) == (1.5, 2.0, 3.0, 0.1)
    assert live.main([str(SAMPLE), "--video", str(tmp_path / "none.mp4"), "--odometry", "none.csv"]) == 1
    assert capsys.readouterr().err.splitlines()[-1].startswith("live_camera: --video ")
