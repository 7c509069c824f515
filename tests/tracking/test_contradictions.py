"""Recordings that contradict themselves, through the commands that read them."""

import json
import re
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from palletloc.__main__ import COMMANDS
from palletloc.cli.app import run
from palletloc.geometry import LevelPose
from palletloc.io.measurements import write_measurements
from palletloc.io.truth import TruePallet, Truth, write_truth
from palletloc.measurement import PalletMeasurement, YawSource
from palletloc.trajectory import Trajectory

RECORDING = """\
format: 1
camera: {model: equirectangular, width: 64, height: 32}
forklift_from_camera: {translation_m: [0.3, -0.1, 1.8], roll_pitch_yaw_deg: [0, 0, 0]}
shelf: {point_m: [3.0, 2.0], facing_deg: -90.0, levels_m: [0.0]}
pallets: [t11-plastic]
"""
ODOMETRY = "time_s,x_m,y_m,yaw_rad,speed_mps,yaw_rate_radps"


@pytest.fixture
def approach(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Work beside a recording of one gray image, without odometry."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("tracking.cli._picture", lambda *_: b"")  # drawing takes longer than all the rest
    folder = Path("approach")
    Path(folder, "images").mkdir(parents=True)
    Path(folder, "recording.yaml").write_text(RECORDING)
    Path(folder, "shots.csv").write_text("time_s,file\n0.0,images/0.png\n")
    gray = np.full((32, 64, 3), 100, np.uint8)
    Path(folder, "images/0.png").write_bytes(cv2.imencode(".png", gray)[1].tobytes())
    return folder


@pytest.fixture
def driven(approach: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[float], None]:
    """Return a function that makes an approach of three metres, with truth, seen by a camera that is turned."""
    monkeypatch.setattr("palletloc.report.evaluation_page.evaluation_page", lambda *_, **__: "")

    def make(turned_deg: float) -> None:
        times = [0.5 * number for number in range(13)]
        rows = [f"{0.02 * n:.2f},{0.01 * n:.2f},0,0,0.5,0" for n in range(301)]
        Path(approach, "odometry.csv").write_text("\n".join([ODOMETRY, *rows]) + "\n")
        Path(approach, "shots.csv").write_text("time_s,file\n" + "".join(f"{t},images/0.png\n" for t in times))
        pallets = [LevelPose(2.0 + 1.3 * n, 2.0, 0.0, 1.57) for n in range(3)]
        forklift = Trajectory(*(np.array(column) for column in ([0.0, 6.0], [0.0, 3.0], [0.0, 0.0], [0.0, 0.0])))
        true = tuple(TruePallet(str(n), "t11-plastic", pallet) for n, pallet in enumerate(pallets))
        write_truth(approach, Truth(forklift, true))
        turn, center = np.exp(1j * np.radians(turned_deg)), 0.3 - 0.1j
        measured = []
        for time in times:
            for pallet in pallets:
                place = turn * (pallet.x - 0.5 * time + 1j * pallet.y - center) + center
                pose = LevelPose(place.real, place.imag, 0.0, pallet.yaw + np.radians(turned_deg))
                covariance = np.diag([0.01, 0.006, 0.004, 0.005]) ** 2
                measured.append(PalletMeasurement(time, "t11-plastic", pose, covariance, 0.9, YawSource.FACE))
        Path("run").mkdir(exist_ok=True)
        write_measurements(Path("run/measurements.csv"), measured)

    return make


@pytest.mark.parametrize("command", ["track", "evaluate"])
@pytest.mark.parametrize("turned_deg", [0.0, 5.0, -2.0])
def test_a_camera_that_is_turned_is_told_in_one_line(
    driven: Callable[[float], None], command: str, turned_deg: float, capsys: pytest.CaptureFixture[str]
) -> None:
    driven(turned_deg)
    given = {"track": ["--measurements", "run/measurements.csv"], "evaluate": ["--estimate", "run"]}[command]
    assert run([command, "approach", "--out", "out", *given], COMMANDS) == 0
    printed = capsys.readouterr()
    if turned_deg == 0:
        assert printed.err == ""
        return
    found = re.fullmatch(
        r"palletloc: the camera is turned by (\S+) degrees of yaw against forklift_from_camera \(sigma (\S+)\): .*"
        r"; a yaw of (\S+) degrees fits; see palletloc calibrate check\n",
        printed.err,
    )
    assert found is not None
    turn, sigma, yaw = (float(number) for number in found.groups())
    assert turn == pytest.approx(-turned_deg, abs=0.1)
    assert yaw == pytest.approx(-turned_deg, abs=0.1)
    assert 0.1 < sigma < 0.4
    if command == "evaluate":
        (document,) = json.loads(Path("out/metrics.json").read_text())["runs"]
        assert document["mounting_yaw_off_deg"] == pytest.approx(-turned_deg, abs=0.1)
        assert document["mounting_yaw_sigma_deg"] == pytest.approx(sigma, abs=0.006)


@pytest.mark.usefixtures("approach")
def test_a_check_of_shots_that_odometry_does_not_reach_says_so(capsys: pytest.CaptureFixture[str]) -> None:
    Path("approach/odometry.csv").write_text(f"{ODOMETRY}\n500,0,0,0,0,0\n501,0,0,0,0,0\n")
    assert run(["calibrate", "check", "approach"], COMMANDS) == 3
    said = "palletloc: degenerate: nothing_seen: no source tells roll and pitch (odometry reaches no shot); "
    assert capsys.readouterr().err.startswith(said)


FAULTS = Path(__file__).resolve().parents[2].parent / "shared/data/faults"
COMMANDS_OF_A_RECORDING = [
    ["track", "approach", "--out", "out"],
    ["track", "approach", "--measurements", "m.csv", "--out", "out"],
    ["localize", "approach", "--initial", "m.csv", "--out", "out"],
    ["evaluate", "approach", "--estimate", "run", "--out", "out"],
    ["explain", "approach", "--shot", "0", "--out", "out"],
    ["calibrate", "shelf", "approach", "--out", "out.yaml"],
    ["calibrate", "check", "approach"],
]


@pytest.mark.usefixtures("approach")
@pytest.mark.parametrize("command", COMMANDS_OF_A_RECORDING, ids=lambda command: "-".join(command[:2]))
@pytest.mark.parametrize("case", ["odometry-yaw-in-degrees", "stamps-in-nanoseconds"])
def test_recordings_whose_odometry_cannot_be_used(
    case: str, command: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    if not FAULTS.is_dir():
        pytest.skip("the shared recordings are not there")
    for file in (FAULTS / case).glob("*.csv"):
        place = Path("m.csv") if file.name == "measurements.csv" else Path("approach", file.name)
        place.write_bytes(file.read_bytes())
    assert run(command, COMMANDS) == 1
    said = {
        "odometry-yaw-in-degrees": r"yaw_rad turns 57\.\d times as far as yaw_rate_radps says: degrees\?",
        "stamps-in-nanoseconds": r"time_s: 1\.7e18: nanoseconds\?",
    }
    printed = capsys.readouterr()
    assert printed.out == ""
    assert re.fullmatch(rf"palletloc: approach/odometry\.csv: {said[case]}\n", printed.err)
    assert not Path("out").exists()
