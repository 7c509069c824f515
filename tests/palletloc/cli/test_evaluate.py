from __future__ import annotations

import csv
import json
import re
import shutil
from collections.abc import Callable
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from palletloc.cli.app import run
from palletloc.evaluation.recording import ERROR_COLUMNS
from palletloc.geometry import LevelPose, level_pose
from palletloc.io.measurements import write_measurements
from palletloc.io.recording import read_recording
from palletloc.io.tracks import TrackRow, write_tracks
from palletloc.io.truth import read_truth
from palletloc.measurement import PalletMeasurement, YawSource
from palletloc.track_status import Status

SAMPLE = Path(str(files("palletloc") / "sample"))
SIGMA = 0.005


def write_run(folder: Path, depth: float = 0.003, yaw: float = 0.002, recording: Path = SAMPLE) -> Path:
    """Write a run that finds every pallet in every shot, each too deep and turned by the same amounts."""
    truth, read = read_truth(recording), read_recording(recording)
    rows = []
    for shot in read.shots:
        forklift_from_world = truth.forklift.pose_at(shot.time).transform().inv()
        for pallet in truth.pallets:
            off = LevelPose(depth, 0.0, 0.0, yaw)
            pose = level_pose(forklift_from_world * pallet.world_from_pallet.transform() * off.transform())
            covariance = SIGMA**2 * np.eye(4)
            rows.append(PalletMeasurement(shot.time, pallet.model, pose, covariance, 0.9, YawSource.FACE, shot.file))
    folder.mkdir(parents=True)
    write_measurements(folder / "measurements.csv", rows)
    return folder


def with_tracks(folder: Path) -> Path:
    """Add tracks of the same poses, the first one tentative."""
    with (folder / "measurements.csv").open() as file:
        cells = list(csv.DictReader(file))
    rows = []
    for number, one in enumerate(cells):
        x, y, z, yaw = (float(one[name]) for name in ("x_m", "y_m", "z_m", "yaw_rad"))
        status = Status.TENTATIVE if number == 0 else Status.CONFIRMED
        pose = LevelPose(x, y, z, yaw)
        rows.append(TrackRow(float(one["time_s"]), 1, one["model"], status, pose, SIGMA**2 * np.eye(4), 0.0, 3))
    write_tracks(folder / "tracks.csv", rows)
    return folder


def evaluate(recording: Path, out: Path, *options: str | Path) -> int:
    return run(["evaluate", str(recording), "--no-pictures", "--out", str(out), *map(str, options)])


def read_metrics(out: Path) -> Any:
    return json.loads((out / "metrics.json").read_text(encoding="utf-8"))


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    """Return a copy of the sample without its images."""
    folder = tmp_path / "recording"
    shutil.copytree(SAMPLE, folder, ignore=shutil.ignore_patterns("images"))
    return folder


def test_known_errors_come_out(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    assert evaluate(SAMPLE, out, "--estimate", write_run(tmp_path / "run")) == 0
    (one,) = read_metrics(out)["runs"]
    source = one["sources"]["measurements"]
    assert (one["name"], source["detection"]["recall"]["share"], source["detection"]["false"]) == ("run", 1.0, 0)
    errors = source["errors"]
    assert errors["depth_m"]["bias"] == pytest.approx(0.003, abs=3e-6)
    assert errors["along_m"]["maximum"] < 3e-6
    assert errors["yaw_deg"]["median"] == pytest.approx(np.degrees(0.002), abs=1e-4)
    nees = (0.003**2 + 0.002**2) / SIGMA**2
    assert source["consistency"]["nees"]["mean"] == pytest.approx(nees, rel=0.01)
    assert sum(part["errors"]["depth_m"]["n"] for part in source["pallets"].values()) == errors["depth_m"]["n"]
    shown = capsys.readouterr().out
    assert "depth mm" in shown
    assert "3.0" in shown


def test_the_table_of_errors_has_every_estimate(tmp_path: Path) -> None:
    folder = with_tracks(write_run(tmp_path / "run"))
    assert evaluate(SAMPLE, tmp_path / "out", "--estimate", folder) == 0
    with (tmp_path / "out" / "errors.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert tuple(rows[0]) == ERROR_COLUMNS
    shots, pallets = len(read_recording(SAMPLE).shots), len(read_truth(SAMPLE).pallets)
    assert [row["source"] for row in rows].count("measurements") == shots * pallets
    assert [row["source"] for row in rows].count("tracks") == shots * pallets - 1  # without the tentative one
    assert {round(float(row["depth_m"]), 5) for row in rows} == {0.003}


@pytest.mark.parametrize(
    ("option", "verdicts"),
    [
        (("--requirement-mm", "2"), {"depth": "not_met", "yaw": "undecided", "together": "not_met"}),
        (("--requirement-yaw-deg", "0.1"), {"depth": "undecided", "yaw": "not_met", "together": "not_met"}),
    ],
)
def test_the_requirement_is_the_users(tmp_path: Path, option: tuple[str, str], verdicts: dict[str, str]) -> None:
    assert evaluate(SAMPLE, tmp_path / "out", "--estimate", write_run(tmp_path / "run"), *option) == 0
    check = read_metrics(tmp_path / "out")["runs"][0]["sources"]["measurements"]["requirement"]
    assert {name: check[name]["verdict"] for name in verdicts} == verdicts


def test_range_and_pairing_are_stated_and_used(tmp_path: Path) -> None:
    folder = write_run(tmp_path / "run")
    options = ("--max-range", "3", "--pair", "interpolated")
    assert evaluate(SAMPLE, tmp_path / "near", "--estimate", folder, *options) == 0
    assert evaluate(SAMPLE, tmp_path / "far", "--estimate", folder) == 0
    near, far = read_metrics(tmp_path / "near"), read_metrics(tmp_path / "far")
    assert near["sight"]["max_range_m"] == 3
    assert near["truth"]["pairing"]["rule"] == "interpolated"
    assert near["truth"]["pairing"]["limit_s"] == 0.5
    counts = [one["runs"][0]["sources"]["measurements"]["detection"]["recall"]["of"] for one in (near, far)]
    assert 0 < counts[0] < counts[1]


@pytest.mark.parametrize("option", ["--max-range", "--pair-limit", "--stop-limit", "--requirement-mm"])
@pytest.mark.parametrize("value", ["0", "-1", "nan", "inf"])
def test_a_limit_that_is_none_is_wrong_usage(tmp_path: Path, option: str, value: str) -> None:
    assert evaluate(SAMPLE, tmp_path / "out", "--estimate", tmp_path, option, value) == 2
    assert not (tmp_path / "out").exists()


def spoil(name: str, change: Callable[[str], str]) -> Callable[[Path, Path], None]:
    """Return what changes a file; one of the run where there is such a file, else one of the recording."""

    def apply(recording: Path, folder: Path) -> None:
        path = folder / name if (folder / name).exists() else recording / name
        path.write_text(change(path.read_text()))

    return apply


def header(text: str) -> str:
    return text.splitlines()[0] + "\n"


def late(text: str) -> str:
    first, *rows = text.splitlines()
    moved = [",".join([str(float(row.split(",")[0]) + 1000), *row.split(",")[1:]]) for row in rows]
    return "\n".join([first, *moved]) + "\n"


@pytest.mark.parametrize(
    ("fault", "told"),
    [
        (spoil("measurements.csv", header), ["measurements.csv", "no pose"]),
        (spoil("tracks.csv", header), ["tracks.csv", "no rows"]),
        (spoil("measurements.csv", late), ["measurements.csv", "overlap"]),
        (spoil("truth/forklift.csv", late), ["overlap"]),
        (
            spoil("measurements.csv", lambda text: text.replace("yaw_from", "yaw", 1)),
            ["measurements.csv, line 1", "'yaw'"],
        ),
        (spoil("tracks.csv", lambda text: text.replace(",hits", "", 1)), ["tracks.csv, line 1", "hits"]),
        (spoil("truth/pallets.csv", header), ["pallets.csv", "no rows"]),
        (spoil("truth/pallets.csv", lambda text: text.replace("t11-plastic", "t12")), ["pallets.csv", "t12"]),
    ],
)
def test_bad_input_is_one_line_and_nothing_is_written(
    tmp_path: Path,
    recording: Path,
    fault: Callable[[Path, Path], None],
    told: list[str],
    capsys: pytest.CaptureFixture[str],
) -> None:
    folder = with_tracks(write_run(tmp_path / "run", recording=recording))
    fault(recording, folder)
    assert evaluate(recording, tmp_path / "out", "--estimate", folder) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert all(part in line for part in told), line
    assert not (tmp_path / "out").exists()


def test_a_run_without_measurements_or_given_twice_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "empty").mkdir()
    assert evaluate(SAMPLE, tmp_path / "out", "--estimate", tmp_path / "empty") == 1
    assert "measurements.csv: no such file" in capsys.readouterr().err
    folder = write_run(tmp_path / "run")
    assert evaluate(SAMPLE, tmp_path / "out", "--estimate", folder, "--estimate", folder) == 1
    assert "given twice" in capsys.readouterr().err


def test_a_shot_without_truth_is_left_out_and_said(
    tmp_path: Path, recording: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = write_run(tmp_path / "run", recording=recording)
    path = recording / "truth" / "forklift.csv"
    lines = path.read_text().splitlines()
    shot = read_recording(recording).shots[0].time
    kept = [line for line in lines[1:] if abs(float(line.split(",")[0]) - shot) > 0.02]
    path.write_text("\n".join([lines[0], *kept]) + "\n")
    assert evaluate(recording, tmp_path / "out", "--estimate", folder) == 0
    assert read_metrics(tmp_path / "out")["truth"]["pairing"]["shots_without_truth"] == [shot]
    assert "1 shot" in capsys.readouterr().out


def test_numbers_that_are_none_become_null(tmp_path: Path) -> None:
    folder = write_run(tmp_path / "run")
    assert evaluate(SAMPLE, tmp_path / "out", "--estimate", folder, "--max-range", "0.1") == 0
    source = read_metrics(tmp_path / "out")["runs"][0]["sources"]["measurements"]
    assert source["errors"]["yaw_deg"] is None
    assert source["detection"]["recall"]["share"] is None
    assert source["requirement"]["verdict"] == "undecided"


def test_runs_are_compared_with_the_first_shot_by_shot(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folders = [write_run(tmp_path / name, depth) for name, depth in (("one", 0.004), ("two", -0.001))]
    lines = (folders[1] / "measurements.csv").read_text().splitlines()
    (folders[1] / "measurements.csv").write_text("\n".join(lines[:-1]) + "\n")
    options = [part for folder in folders for part in ("--estimate", folder)]
    assert evaluate(SAMPLE, tmp_path / "out", *options, "--max-range", "50", "--no-pictures") == 0
    (compared,) = read_metrics(tmp_path / "out")["comparisons"]
    assert (compared["first"], compared["second"], compared["source"]) == ("one", "two", "measurements")
    first, second = (
        one["sources"]["measurements"]["errors"]["depth_m"]["n"] for one in read_metrics(tmp_path / "out")["runs"]
    )
    assert (compared["views"], compared["only_first"], compared["only_second"]) == (second, first - second, 0)
    depth = compared["differences"]["depth_m"]
    assert [depth[key] for key in ("mean", "low", "high")] == pytest.approx([-0.003] * 3, abs=3e-6)
    assert (depth["smaller"], depth["larger"]) == (second, 0)
    assert "Runs side by side" in (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert "against one" in capsys.readouterr().out
    again = (tmp_path / "out" / "metrics.json").read_bytes()
    assert evaluate(SAMPLE, tmp_path / "out", *options, "--max-range", "50", "--no-pictures") == 0
    assert (tmp_path / "out" / "metrics.json").read_bytes() == again


def test_folders_of_one_name_are_told_apart(tmp_path: Path) -> None:
    folders = [write_run(tmp_path / name / "out") for name in ("a", "b")]
    options = [part for folder in folders for part in ("--estimate", folder)]
    assert evaluate(SAMPLE, tmp_path / "results", *options, "--no-pictures") == 0
    names = [one["name"] for one in read_metrics(tmp_path / "results")["runs"]]
    assert names == [str(folder) for folder in folders]


def keys_of(document: Any) -> set[str]:
    """Return every key at any depth; those of the pallets are names, not keys."""
    if isinstance(document, list):
        return {key for one in document for key in keys_of(one)}
    if not isinstance(document, dict):
        return set()
    below = {key for name, one in document.items() if name != "pallets" for key in keys_of(one)}
    return {*document, *below}


def test_every_key_of_the_metrics_is_documented(tmp_path: Path) -> None:
    folders = [with_tracks(write_run(tmp_path / name)) for name in ("one", "two")]
    options = [part for folder in folders for part in ("--estimate", folder)]
    assert evaluate(SAMPLE, tmp_path / "out", *options, "--no-pictures") == 0
    page = (Path(__file__).parents[3] / "docs" / "evaluation.md").read_text(encoding="utf-8")
    section = page.partition("## metrics.json")[2]
    told = {word for cell in re.findall(r"`([\w.]+)`", section) for word in cell.split(".")}
    assert keys_of(read_metrics(tmp_path / "out")) - told == set()
