import csv
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from palletloc.evaluation.recording import ERROR_COLUMNS
from palletloc.io.recording import read_recording
from palletloc.io.truth import read_truth
from tests.palletloc.cli.sample_runs import SAMPLE, SIGMA, estimates, evaluate, read_metrics, with_tracks, write_run

Refused = Callable[..., str]
pytestmark = pytest.mark.usefixtures("undrawn")


def test_known_errors_come_out(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    assert evaluate(SAMPLE, out, "--estimate", write_run(tmp_path / "run")) == 0
    (only,) = read_metrics(out)["runs"]
    source = only["sources"]["measurements"]
    assert (only["name"], source["detection"]["recall"]["share"], source["detection"]["false"]) == ("run", 1.0, 0)
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
    ("option", "depth", "yaw"),
    [("--requirement-mm=2", "not_met", "undecided"), ("--requirement-yaw-deg=0.1", "undecided", "not_met")],
)
def test_the_requirement_is_the_users(tmp_path: Path, option: str, depth: str, yaw: str) -> None:
    assert evaluate(SAMPLE, tmp_path / "out", "--estimate", write_run(tmp_path / "run"), option) == 0
    check = read_metrics(tmp_path / "out")["runs"][0]["sources"]["measurements"]["requirement"]
    assert [check[name]["verdict"] for name in ("depth", "yaw", "together")] == [depth, yaw, "not_met"]


def test_range_and_pairing_are_stated_and_used(tmp_path: Path) -> None:
    folder = write_run(tmp_path / "run")
    options = ("--max-range", "3", "--pair", "interpolated")
    assert evaluate(SAMPLE, tmp_path / "near", "--estimate", folder, *options) == 0
    assert evaluate(SAMPLE, tmp_path / "far", "--estimate", folder) == 0
    near, far = read_metrics(tmp_path / "near"), read_metrics(tmp_path / "far")
    assert near["sight"]["max_range_m"] == 3
    assert near["truth"]["pairing"]["rule"] == "interpolated"
    assert near["truth"]["pairing"]["limit_s"] == 0.5
    counts = [metrics["runs"][0]["sources"]["measurements"]["detection"]["recall"]["of"] for metrics in (near, far)]
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
    tmp_path: Path, recording: Path, fault: Callable[[Path, Path], None], told: list[str], refused: Refused
) -> None:
    folder = with_tracks(write_run(tmp_path / "run"))
    fault(recording, folder)
    line = refused("evaluate", recording, "--out", tmp_path / "out", "--estimate", folder)
    assert all(part in line for part in told), line
    assert not (tmp_path / "out").exists()


def test_a_run_without_measurements_or_given_twice_is_refused(tmp_path: Path, refused: Refused) -> None:
    (tmp_path / "empty").mkdir()
    folder, command = write_run(tmp_path / "run"), ("evaluate", SAMPLE, "--out", tmp_path / "out", "--estimate")
    assert "measurements.csv: no such file" in refused(*command, tmp_path / "empty")
    assert "given twice" in refused(*command, folder, "--estimate", folder)


def test_a_shot_without_truth_is_left_out_and_said(
    tmp_path: Path, recording: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = write_run(tmp_path / "run")
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
    options = [*estimates(*folders), "--max-range", "50"]
    assert evaluate(SAMPLE, tmp_path / "out", *options) == 0
    (compared,) = read_metrics(tmp_path / "out")["comparisons"]
    assert (compared["first"], compared["second"], compared["source"]) == ("one", "two", "measurements")
    first, second = (
        each["sources"]["measurements"]["errors"]["depth_m"]["n"] for each in read_metrics(tmp_path / "out")["runs"]
    )
    assert (compared["views"], compared["only_first"], compared["only_second"]) == (second, first - second, 0)
    depth = compared["differences"]["depth_m"]
    assert [depth[key] for key in ("mean", "low", "high")] == pytest.approx([-0.003] * 3, abs=3e-6)
    assert (depth["smaller"], depth["larger"]) == (second, 0)
    assert "against one" in capsys.readouterr().out
    again = (tmp_path / "out" / "metrics.json").read_bytes()
    assert evaluate(SAMPLE, tmp_path / "out", *options) == 0
    assert (tmp_path / "out" / "metrics.json").read_bytes() == again


def test_folders_of_one_name_are_told_apart(tmp_path: Path) -> None:
    folders = [write_run(tmp_path / name / "out") for name in ("a", "b")]
    assert evaluate(SAMPLE, tmp_path / "results", *estimates(*folders)) == 0
    names = [each["name"] for each in read_metrics(tmp_path / "results")["runs"]]
    assert names == [str(folder) for folder in folders]


def keys_of(document: Any) -> set[str]:
    """Return every key at any depth; those of the pallets are names, not keys."""
    if isinstance(document, list):
        return {key for part in document for key in keys_of(part)}
    if not isinstance(document, dict):
        return set()
    below = {key for name, part in document.items() if name != "pallets" for key in keys_of(part)}
    return {*document, *below}


def test_every_key_of_the_metrics_is_documented(tmp_path: Path) -> None:
    folders = [with_tracks(write_run(tmp_path / name)) for name in ("one", "two")]
    assert evaluate(SAMPLE, tmp_path / "out", *estimates(*folders)) == 0
    page = (Path(__file__).parents[3] / "docs" / "evaluation.md").read_text(encoding="utf-8")
    section = page.partition("## metrics.json")[2]
    told = {word for cell in re.findall(r"`([\w.]+)`", section) for word in cell.split(".")}
    assert keys_of(read_metrics(tmp_path / "out")) - told == set()
