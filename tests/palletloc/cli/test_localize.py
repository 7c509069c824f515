from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from palletloc.cli.app import run
from palletloc.cli.simulate import save_simulation
from palletloc.geometry import Image, LevelPose, wrap_angle
from palletloc.io.measurements import MEASUREMENT_COLUMNS, REFUSAL_COLUMNS, NoPose, read_measurements, read_refusals
from palletloc.io.recording import Recording, ShotFile, read_recording
from palletloc.measurement import PalletMeasurement, Reason, Stage
from palletloc.pallet_library import find_models
from palletloc.recording_run import Job
from palletloc.synthetic.aisle import AisleSpec
from palletloc.synthetic.simulation import SimulationSpec, simulate
from tests.palletloc.cli.sample_runs import true_poses

Localize = Callable[..., int]
Contents = Callable[[], dict[str, str]]
Status = Callable[[], dict[str, Any]]

NAMES = ["measurements.csv", "overview.html", "refusals.csv", "run.json"]
HEADERS = [",".join(columns) + "\n" for columns in (MEASUREMENT_COLUMNS, REFUSAL_COLUMNS)]


def test_shots_without_pallets_give_tables_without_rows(
    localize: Localize, contents: Contents, status: Status, capsys: pytest.CaptureFixture[str]
) -> None:
    assert localize() == 0
    files = contents()
    assert sorted(files) == NAMES
    assert [files["measurements.csv"], files["refusals.csv"]] == HEADERS
    assert (status()["complete"], status()["done"], status()["skipped"]) == (True, 4, [])
    printed = capsys.readouterr()
    assert printed.err == ""  # nothing to follow where nobody is looking
    rows = [line.split() for line in printed.out.splitlines()]
    for row in ("shots done 4", "skipped 0", "pallets none 0", "results: out"):
        assert row.split() in rows


def test_progress_is_shown_where_somebody_is_looking(
    localize: Localize, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("TERM", "xterm")
    assert localize() == 0
    printed = capsys.readouterr()
    assert "Localizing" in printed.err
    assert "Localizing" not in printed.out


def test_verbose_says_what_each_shot_gives(localize: Localize, capsys: pytest.CaptureFixture[str]) -> None:
    assert localize("--verbose") == 0
    lines = capsys.readouterr().err.splitlines()
    told = [f"palletloc: images/{number}.png: 0 pallets, 0 refused" for number in range(4)]
    assert [line.rsplit(", ", 1)[0] for line in lines] == told


def test_each_given_start_has_one_row_in_its_order_and_no_starts_are_a_run_without_shots(
    localize: Localize, capsys: pytest.CaptureFixture[str]
) -> None:
    assert localize("--initial", "initial.csv") == 0
    rows = read_measurements("out/measurements.csv")
    assert [type(row) for row in rows] == [NoPose] * 3
    shots = [(row.time, row.file, row.model) for row in rows]
    assert shots == [(1.0, "images/2.png", "t11")] * 2 + [(0.0, "images/0.png", "t11")]
    assert [row.time for row in read_refusals("out/refusals.csv")] == [1.0, 1.0, 0.0]
    printed = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert ["starts", "without", "a", "pose", "3"] in printed
    assert ["shots", "done", "2"] in printed
    Path("initial.csv").write_text("time_s,model,x_m,y_m,z_m,yaw_rad\n")
    assert localize("--initial", "initial.csv") == 0
    assert Path("out/measurements.csv").read_text() == HEADERS[0]


def test_the_parameters_of_the_file_are_used(localize: Localize) -> None:
    Path("near.yaml").write_text("detection: {max_range: 0.5}\n")
    assert localize("--initial", "initial.csv", "--config", "near.yaml") == 0
    refused = read_refusals("out/refusals.csv")
    assert {(row.stage, row.reason) for row in refused} == {(Stage.START, Reason.OUT_OF_RANGE)}
    assert localize("--initial", "initial.csv") == 0
    assert Reason.OUT_OF_RANGE not in {row.reason for row in read_refusals("out/refusals.csv")}


@pytest.mark.parametrize("method", ["horizontal_plane", "paper", "joint_search"])
def test_every_method_does_without_pallets(localize: Localize, status: Status, method: str) -> None:
    Path("few.yaml").write_text("joint_search: {turns: 2, depths: 2}\n")
    assert localize("--method", method, "--initial", "initial.csv", "--config", "few.yaml") == 0
    assert len(read_measurements("out/measurements.csv")) == 3
    assert status()["run"]["method"] == method


@pytest.fixture(scope="module")
def simulated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a synthetic recording with its truth."""
    folder = tmp_path_factory.mktemp("simulated") / "approach"
    aisle = AisleSpec(find_models(["t11-plastic"], {}), levels=(0.0,), length=7.0, opposite=False, clutter=0)
    save_simulation(folder, simulate(SimulationSpec(aisle=aisle, width=1600, shots=2), seed=2))
    return folder


def errors(pose: LevelPose, true: LevelPose) -> tuple[float, float]:
    """Return how far a pose is off, in metres and radians."""
    offset = pose.as_array() - true.as_array()
    return float(np.linalg.norm(offset[:3])), abs(wrap_angle(float(offset[3])))


def test_every_measured_pallet_is_a_true_one(simulated: Path, tmp_path: Path) -> None:
    assert run(["localize", str(simulated), "--out", str(tmp_path / "out")]) == 0
    rows = read_measurements(tmp_path / "out" / "measurements.csv")
    assert len(rows) >= 4
    for row in rows:
        assert isinstance(row, PalletMeasurement)
        true = true_poses(simulated, row.time).values()
        distance, turn = min(errors(row.forklift_from_pallet, pose) for pose in true)
        assert distance < 0.1
        assert turn < np.radians(2)


def test_from_a_given_start_its_own_pallet_is_measured(simulated: Path, tmp_path: Path) -> None:
    shot = read_recording(simulated).shots[1]
    near = [pose for pose in true_poses(simulated, shot.time).values() if 1.0 < pose.x < 3.5]
    assert near
    lines = [f"{shot.time},t11-plastic,{pose.x + 0.03},{pose.y - 0.02},{pose.z},{pose.yaw + 0.02}" for pose in near]
    path = tmp_path / "initial.csv"
    path.write_text("\n".join(["time_s,model,x_m,y_m,z_m,yaw_rad", *lines]) + "\n")
    out = tmp_path / "out"
    assert run(["localize", str(simulated), "--out", str(out), "--initial", str(path)]) == 0
    rows = read_measurements(out / "measurements.csv")
    assert len(rows) == len(near)
    found = [(row, true) for row, true in zip(rows, near, strict=True) if isinstance(row, PalletMeasurement)]
    assert found
    for row, true in found:
        distance, turn = errors(row.forklift_from_pallet, true)
        assert distance < 0.03
        assert turn < 0.015


def stops_at(number: int, kind: type[BaseException]) -> Callable[[Recording, ShotFile], Image]:
    """Return a reader of images that raises an exception at one shot."""
    read = Recording.image

    def image(recording: Recording, shot: ShotFile) -> Image:
        if shot.file == f"images/{number}.png":
            raise kind
        return read(recording, shot)

    return image


def test_after_a_strict_stop_a_mended_recording_can_be_resumed(
    localize: Localize, status: Status, capsys: pytest.CaptureFixture[str]
) -> None:
    good = Path("approach/images/2.png").read_bytes()
    Path("approach/images/2.png").write_bytes(b"")
    assert localize("--strict") == 1
    assert not Path("out/measurements.csv").exists()
    Path("approach/images/2.png").write_bytes(good)
    capsys.readouterr()
    assert localize("--strict", "--resume", "--verbose") == 0
    assert [line.split(":")[1] for line in capsys.readouterr().err.splitlines()] == [" images/2.png", " images/3.png"]
    assert status()["done"] == 4


@pytest.mark.parametrize("initial", [[], ["--initial", "initial.csv"]])
def test_an_interrupt_keeps_what_is_finished_and_resume_goes_on(
    localize: Localize,
    contents: Contents,
    status: Status,
    initial: list[str],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    shots = 2 if initial else 4
    assert localize(*initial) == 0
    whole = contents()
    with monkeypatch.context() as patch:
        patch.setattr(Recording, "image", stops_at(0 if initial else 3, KeyboardInterrupt))
        assert localize(*initial) == 130
    printed = capsys.readouterr().err.splitlines()
    kept = f"palletloc: {shots - 1} of {shots} shots are kept in out; --resume goes on"
    assert [line for line in printed if line] == [kept, "palletloc: interrupted"]
    assert status()["complete"] is False
    assert contents()["measurements.csv"].count("\n") == (3 if initial else 1)
    assert localize(*initial, "--resume") == 0
    assert contents() == whole
    printed_rows = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert ["shots", "done", str(shots)] in printed_rows
    assert ["of", "them", "before;", "not", "counted", "below", str(shots - 1)] in printed_rows


def test_an_interrupt_before_anything_is_finished_leaves_nothing(
    localize: Localize, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(Recording, "image", stops_at(0, KeyboardInterrupt))
    assert localize() == 130
    assert capsys.readouterr().err.strip() == "palletloc: interrupted"
    assert not Path("out").exists()


def test_a_fault_of_the_program_leaves_earlier_results_alone(
    localize: Localize, contents: Contents, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert localize() == 0
    whole = contents()
    with monkeypatch.context() as patch:
        patch.setattr(Recording, "image", stops_at(2, ZeroDivisionError))
        with pytest.raises(ZeroDivisionError):
            localize("--method", "paper")
    assert {name: text for name, text in contents().items() if name in NAMES} == whole


def test_a_finished_run_is_not_done_again_nor_for_parameters_that_change_nothing(
    localize: Localize, contents: Contents, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert localize() == 0
    whole = contents()
    monkeypatch.setattr(Job, "explain", lambda *_: pytest.fail("was done again"))
    Path("all.yaml").write_text("detection: {}\n")
    for options in ([], ["--config", "all.yaml"]):
        assert localize("--resume", *options) == 0
        assert contents() == whole
    assert "pallets" not in capsys.readouterr().out.rpartition("of them before")[2]


def test_another_run_is_not_resumed(localize: Localize, contents: Contents, refused: Callable[..., str]) -> None:
    Path("mine.yaml").write_text("detection: {max_range: 2}\n")
    assert localize() == 0
    whole = contents()
    options = {"method": "--method=paper", "configuration": "--config=mine.yaml", "starts": "--initial=initial.csv"}
    for what, option in options.items():
        told = refused("localize", "approach", "--out", "out", "--resume", option)
        assert told.startswith(f"out: cannot resume: the run there had the {what} ")
        assert contents() == whole
