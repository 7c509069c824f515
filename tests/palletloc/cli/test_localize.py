from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from palletloc.cli.app import run
from palletloc.cli.simulate import save_simulation
from palletloc.geometry import LevelPose, level_pose, wrap_angle
from palletloc.io.measurements import MEASUREMENT_COLUMNS, REFUSAL_COLUMNS, NoPose, read_measurements, read_refusals
from palletloc.io.recording import read_recording
from palletloc.io.truth import read_truth
from palletloc.measurement import PalletMeasurement, Reason, Stage
from palletloc.pallet_library import find_models
from palletloc.synthetic.aisle import AisleSpec
from palletloc.synthetic.simulation import SimulationSpec, simulate

Localize = Callable[..., int]
Contents = Callable[[], dict[str, str]]
Status = Callable[[], dict[str, Any]]

NAMES = ["measurements.csv", "refusals.csv", "run.json"]
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
    assert ["shots", "done", "4"] in rows
    assert ["skipped", "0"] in rows
    assert ["pallets", "none", "0"] in rows
    assert ["results:", "out"] in rows


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
    assert [line.rsplit(", ", 1)[0] for line in lines] == [
        f"palletloc: images/{number}.png: 0 pallets, 0 refused" for number in range(4)
    ]


def test_each_given_start_has_one_row_in_its_order(localize: Localize, capsys: pytest.CaptureFixture[str]) -> None:
    assert localize("--initial", "initial.csv") == 0
    rows = read_measurements("out/measurements.csv")
    assert [type(row) for row in rows] == [NoPose] * 3
    assert [(row.time, row.file, row.model) for row in rows] == [
        (1.0, "images/2.png", "t11"),
        (1.0, "images/2.png", "t11"),
        (0.0, "images/0.png", "t11"),
    ]
    refused = read_refusals("out/refusals.csv")
    assert [row.time for row in refused] == [1.0, 1.0, 0.0]
    printed = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert ["starts", "without", "a", "pose", "3"] in printed
    assert ["shots", "done", "2"] in printed


def test_no_starts_are_a_run_without_shots(localize: Localize, contents: Contents) -> None:
    Path("initial.csv").write_text("time_s,model,x_m,y_m,z_m,yaw_rad\n")
    assert localize("--initial", "initial.csv") == 0
    assert contents()["measurements.csv"] == HEADERS[0]


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
    run_of = status()["run"]
    assert isinstance(run_of, dict)
    assert run_of["method"] == method


@pytest.fixture(scope="module")
def simulated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a synthetic recording with its truth."""
    folder = tmp_path_factory.mktemp("simulated") / "approach"
    aisle = AisleSpec(find_models(["t11-plastic"], {}), levels=(0.0,), length=7.0, opposite=False, clutter=0)
    save_simulation(folder, simulate(SimulationSpec(aisle=aisle, width=1600, shots=2), seed=2))
    return folder


def true_poses(folder: Path, time: float) -> list[LevelPose]:
    """Return the pallets of a recording in the forklift frame."""
    truth = read_truth(folder)
    forklift_from_world = truth.forklift.pose_at(time).transform().inv()
    return [level_pose(forklift_from_world * pallet.world_from_pallet.transform()) for pallet in truth.pallets]


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
        nearby = [errors(row.forklift_from_pallet, true) for true in true_poses(simulated, row.time)]
        distance, turn = min(nearby)
        assert distance < 0.1
        assert turn < np.radians(2)


def test_from_a_given_start_its_own_pallet_is_measured(simulated: Path, tmp_path: Path) -> None:
    shot = read_recording(simulated).shots[1]
    near = [pose for pose in true_poses(simulated, shot.time) if 1.0 < pose.x < 3.5]
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
