import json
import re
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml

from palletloc.__main__ import COMMANDS
from palletloc.cli.app import run
from palletloc.config import LocalizerConfig
from palletloc.geometry import Image, LevelPose, level_pose
from palletloc.io.config_file import read_config
from palletloc.io.measurements import read_measurements, write_measurements
from palletloc.io.recording import Recording, ShotFile, read_recording
from palletloc.io.tracks import read_tracks
from palletloc.io.truth import TruePallet, Truth, write_truth
from palletloc.measurement import PalletMeasurement, YawSource
from palletloc.recording_run import Job
from palletloc.track_status import Status
from tracking.cli import _picture
from tracking.config import TrackerConfig, read_tracker_config
from tracking.files import read_events

RECORDING = """\
format: 1
camera: {model: equirectangular, width: 64, height: 32}
forklift_from_camera: {translation_m: [0.3, -0.1, 1.8], roll_pitch_yaw_deg: [0, 0, 0]}
shelf: {point_m: [3.0, 2.0], facing_deg: -90.0, levels_m: [0.0]}
pallets: [t11-plastic]
"""
SHOTS = "time_s,file\n" + "".join(f"{0.5 * n},images/{n}.png\n" for n in range(4))
ODOMETRY = "time_s,x_m,y_m,yaw_rad,speed_mps,yaw_rate_radps\n" + "".join(
    f"{0.1 * n:.1f},{0.04 * n:.2f},0,0,0.4,0\n" for n in range(21)
)
PALLET = LevelPose(3.0, 2.0, 0.0, 1.5)
LOCALIZED = ["measurements.csv", "refusals.csv", "run.json"]
TRACKED = ["events.csv", "tracks.csv", "tracks.png", "tracks/1.tum"]
SMOOTHED = ["tracks_smoothed.csv", "tracks_smoothed/1.tum"]


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Work beside a recording with nothing to see, and measurements of it."""
    monkeypatch.chdir(tmp_path)
    Path("approach/images").mkdir(parents=True)
    for name, text in {"recording.yaml": RECORDING, "shots.csv": SHOTS, "odometry.csv": ODOMETRY}.items():
        Path("approach", name).write_text(text)
    for number in range(4):
        image = np.full((32, 64, 3), 100 + number, np.uint8)
        Path(f"approach/images/{number}.png").write_bytes(cv2.imencode(".png", image)[1].tobytes())
    write_measurements(Path("m.csv"), [seen(0.5 * number) for number in range(4)])
    # drawing takes longer than all the rest
    monkeypatch.setattr("tracking.cli._picture", lambda run, truth: f"{len(run.rows)} {truth}".encode())
    return tmp_path


@pytest.fixture
def drawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Draw the picture of a run after all."""
    monkeypatch.setattr("tracking.cli._picture", _picture)


def seen(time: float, model: str = "t11-plastic") -> PalletMeasurement:
    there = level_pose(LevelPose(0.4 * time, 0.0, 0.0, 0.0).transform().inv() * PALLET.transform())
    return PalletMeasurement(time, model, there, 1e-4 * np.eye(4), 0.9, YawSource.FACE)


def track(*options: str, out: str = "out") -> int:
    return run(["track", "approach", "--out", out, *options], COMMANDS)


def contents(folder: str = "out") -> dict[str, bytes]:
    """Return all files of a run but its overview, which names the folder."""
    top = Path(folder)
    files = {str(each.relative_to(top)): each.read_bytes() for each in sorted(top.rglob("*")) if each.is_file()}
    return {name: content for name, content in files.items() if not name.startswith("overview")}


@pytest.fixture
def finds(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let every shot that can be read show the pallet."""
    monkeypatch.setattr(Job, "rows", lambda _, explanation: [seen(explanation.shot.time)])


def stops_at(number: int, kind: type[BaseException]) -> Callable[[Recording, ShotFile], Image]:
    read = Recording.image

    def image(recording: Recording, shot: ShotFile) -> Image:
        if shot.file == f"images/{number}.png":
            raise kind
        return read(recording, shot)

    return image


@pytest.mark.usefixtures("here")
def test_measurements_become_tracks_without_any_image(capsys: pytest.CaptureFixture[str]) -> None:
    shutil.rmtree("approach/images")
    assert track("--measurements", "m.csv", "--smooth") == 0
    assert sorted(contents()) == sorted(TRACKED + SMOOTHED)
    rows = read_tracks("out/tracks.csv")
    assert [(row.time, row.status, row.hits) for row in rows] == [
        (0.0, Status.TENTATIVE, 1),
        (0.5, Status.TENTATIVE, 2),
        (1.0, Status.CONFIRMED, 3),
        (1.5, Status.CONFIRMED, 4),
    ]
    points = np.loadtxt("out/tracks/1.tum")
    assert points[:, 0].tolist() == [0.0, 0.5, 1.0, 1.5]
    assert points[:, 1:3] == pytest.approx(np.tile([3.0, 2.0], (4, 1)), abs=1e-3)
    printed = capsys.readouterr()
    assert printed.err == ""  # nothing to follow where nobody is looking
    (line,) = [line for line in printed.out.splitlines() if line.lstrip().startswith("1 ")]
    assert line.split()[1:5] == ["t11-plastic", "confirmed", "4", "2.400"]
    assert "4 shots, 4 measurements, 4 used; 1 tracks confirmed" in printed.out
    assert "results: out" in printed.out


@pytest.mark.usefixtures("here", "finds")
def test_images_become_tracks_with_all_files_of_localize(capsys: pytest.CaptureFixture[str]) -> None:
    assert track() == 0
    assert sorted(contents()) == sorted(LOCALIZED + TRACKED)
    assert len(read_measurements("out/measurements.csv")) == 4
    assert track("--measurements", "out/measurements.csv", out="again") == 0
    assert {name: contents()[name] for name in TRACKED} == contents("again")
    assert capsys.readouterr().err == ""


@pytest.mark.usefixtures("here", "drawn")
def test_nothing_found_gives_tables_without_rows_and_a_picture() -> None:
    assert track("--smooth") == 0
    assert sorted(contents()) == sorted([*LOCALIZED, "events.csv", "tracks.csv", "tracks.png", "tracks_smoothed.csv"])
    assert read_tracks("out/tracks.csv") == ()
    assert read_events("out/events.csv") == ()


@pytest.mark.usefixtures("here")
def test_progress_is_shown_where_somebody_is_looking(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("TERM", "xterm")
    assert track() == 0
    printed = capsys.readouterr()
    assert "Localizing" in printed.err
    assert "Tracking" in printed.err
    assert "Tracking" not in printed.out


@pytest.mark.usefixtures("here", "finds")
def test_a_shot_that_cannot_be_used_is_told_and_counts_for_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    Path("approach/images/3.png").write_bytes(b"")
    assert track() == 0
    printed = capsys.readouterr()
    assert "skipped: approach/images/3.png" in printed.err
    assert "4 shots, 1 of them not usable, 3 measurements, 3 used" in printed.out
    last = read_tracks("out/tracks.csv")[-1]
    assert (last.time, last.status, last.age) == (1.5, Status.CONFIRMED, 0.5)
    assert track("--strict", out="other") == 1
    assert [name for name in contents("other") if not name.startswith(".")] == []


@pytest.mark.usefixtures("here", "finds")
def test_an_interrupted_run_is_resumed_to_the_same_result(monkeypatch: pytest.MonkeyPatch) -> None:
    assert track("--smooth", out="whole") == 0
    assert track() == 0
    with monkeypatch.context() as patch:
        patch.setattr(Recording, "image", stops_at(2, KeyboardInterrupt))
        assert track() == 130
    assert [name for name in contents() if "track" in name] == []  # of other measurements than are there now
    assert json.loads(Path("out/run.json").read_text())["done"] == 2
    assert track("--resume", "--smooth") == 0
    assert contents() == contents("whole")
    monkeypatch.setattr(Job, "explain", lambda *_: pytest.fail("was done again"))
    assert track("--resume", "--smooth") == 0
    assert contents() == contents("whole")


@pytest.mark.usefixtures("here", "finds")
def test_what_localize_did_is_not_done_again_whatever_the_tracker_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    assert run(["localize", "approach", "--out", "out"], COMMANDS) == 0
    Path("mine.yaml").write_text("tracker: {life: {confirm_hits: 2}}\n")
    monkeypatch.setattr(Job, "explain", lambda *_: pytest.fail("was done again"))
    assert track("--resume", "--config", "mine.yaml") == 0
    assert [row.status for row in read_tracks("out/tracks.csv")][1] is Status.CONFIRMED


@pytest.mark.usefixtures("here")
def test_a_second_run_leaves_nothing_of_the_first() -> None:
    assert track("--measurements", "m.csv", "--smooth") == 0
    assert track("--measurements", "m.csv") == 0
    assert sorted(contents()) == sorted(TRACKED)


@pytest.mark.usefixtures("here", "drawn")
def test_truth_goes_into_the_picture_only() -> None:
    assert track("--measurements", "m.csv", "--smooth") == 0
    before = contents()
    recording = read_recording("approach")
    write_truth(Path("approach"), Truth(recording.odometry, (TruePallet("A", "t11-plastic", PALLET),)))
    assert track("--measurements", "m.csv", "--smooth") == 0
    after = contents()
    assert after.pop("tracks.png") != before.pop("tracks.png")
    assert after == before


@pytest.mark.usefixtures("here")
def test_a_survey_without_the_forklifts_path_does_not_matter() -> None:
    assert track("--measurements", "m.csv") == 0
    before = contents()
    Path("approach/truth").mkdir()
    Path("approach/truth/pallets.csv").write_text("id,model,x_m,y_m,z_m,yaw_rad\nA,t11-plastic,3,2,0,1.5\n")
    Path("approach/truth/survey.yaml").write_text("not read here")
    assert track("--measurements", "m.csv") == 0
    assert contents() == before


@pytest.mark.usefixtures("here")
@pytest.mark.parametrize(
    ("file", "text", "options", "said"),
    [
        ("m.csv", None, ["--measurements", "m.csv"], "m.csv: no such file"),
        ("m.csv", "time_s\n", ["--measurements", "m.csv"], "m.csv, line 1: column 'file' is missing"),
        ("approach/odometry.csv", None, [], "odometry.csv: no such file"),
        ("approach/truth/forklift.csv", "time_s\n", [], "approach/truth/forklift.csv, line 1: column"),
        ("mine.yaml", "tracker: {gaet: {}}", ["--config", "mine.yaml"], "mine.yaml: tracker: unknown key 'gaet'"),
        ("mine.yaml", "detektion: {}", ["--config", "mine.yaml"], "mine.yaml: unknown key 'detektion'"),
        ("out", "a file", ["--measurements", "m.csv"], "out"),
        ("approach/recording.yaml", None, [], "approach/recording.yaml: no such file"),
    ],
)
def test_a_file_at_fault_is_one_line_and_nothing_is_written(
    file: str, text: str | None, options: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    if text is None:
        Path(file).unlink()
    else:
        Path(file).parent.mkdir(exist_ok=True)
        Path(file).write_text(text)
    assert track(*options) == 1
    printed = capsys.readouterr()
    assert printed.out == ""
    assert re.fullmatch(r"palletloc: .*\n", printed.err)
    assert said in printed.err
    assert not Path("out").is_dir()


@pytest.mark.usefixtures("here")
def test_measurements_of_another_recording_are_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    write_measurements(Path("m.csv"), [seen(0.0), seen(0.7)])
    assert track("--measurements", "m.csv") == 1
    expected = "palletloc: m.csv: no shot at 0.7 s; the nearest is at 0.5 s; expected measurements of approach\n"
    assert capsys.readouterr() == ("", expected)


@pytest.mark.usefixtures("here")
def test_measurements_of_which_none_can_be_used_are_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    odometry = Path("approach/odometry.csv")
    odometry.write_text(re.sub(r"^(\d)", r"9\1", odometry.read_text(), flags=re.MULTILINE))  # from 90 s on
    assert track("--measurements", "m.csv") == 1
    printed = capsys.readouterr()
    assert printed.out == ""
    first = "palletloc: approach: none of 4 measurements can be used; the first: no odometry at its time"
    clocks = r"; shots are from 0 s to [\d.]+ s, odometry from 90 s to [\d.]+ s: [\d.]+ s apart\n"
    assert re.fullmatch(re.escape(first) + clocks, printed.err)
    assert not Path("out").exists()


@pytest.mark.usefixtures("here")
def test_measurements_that_are_all_too_vague_are_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    vague = [replace(seen(0.5 * number), covariance=np.eye(4)) for number in range(4)]
    write_measurements(Path("m.csv"), vague)
    assert track("--measurements", "m.csv") == 1
    reason = "no track there, and too uncertain to begin one"
    expected = f"palletloc: approach: none of 4 measurements can be used; the first: {reason}\n"
    assert capsys.readouterr() == ("", expected)


@pytest.mark.usefixtures("here", "finds")
def test_what_is_strange_about_odometry_is_said_once(capsys: pytest.CaptureFixture[str]) -> None:
    odometry = Path("approach/odometry.csv")
    odometry.write_text(odometry.read_text().replace("0.4,0\n", "1.44,0\n"))
    assert track() == 0
    said = "x_m, y_m go 0.278 times as far as speed_mps says: km/h?"
    assert capsys.readouterr().err == f"palletloc: {odometry}: {said}\n"


@pytest.mark.usefixtures("here")
@pytest.mark.parametrize("options", [["--strict"], ["--resume"], ["--method", "paper"], ["-v"]])
def test_options_of_localizing_are_wrong_usage_where_nothing_is_localized(options: list[str]) -> None:
    assert track("--measurements", "m.csv", *options) == 2
    assert not Path("out").exists()


def test_every_parameter_is_printed_and_read_by_every_command(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "all.yaml"
    assert run(["config"], COMMANDS) == 0
    printed = capsys.readouterr().out
    path.write_text(printed)
    assert read_config(path) == LocalizerConfig()
    assert read_tracker_config(path) == TrackerConfig()
    assert run(["config", "--file", str(path)], COMMANDS) == 0
    assert capsys.readouterr().out == printed
    path.write_text("tracker: {errors: {common_yaw_deg: 0.1}}\n")
    assert run(["config", "--file", str(path)], COMMANDS) == 0
    mine, default = yaml.safe_load(capsys.readouterr().out), yaml.safe_load(printed)
    assert mine["tracker"]["errors"].pop("common_yaw_deg") == 0.1
    default["tracker"]["errors"].pop("common_yaw_deg")
    assert mine == default


def test_a_command_of_another_package_takes_the_place_of_one_of_the_same_name() -> None:
    names = [command.name for command in COMMANDS]
    assert len(names) == len(set(names))
    assert names.index("track") == names.index("localize") + 1
    assert {command.name: command.target for command in COMMANDS}["config"].startswith("tracking.")
