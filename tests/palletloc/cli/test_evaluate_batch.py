from __future__ import annotations

import json
import re
import shutil
import sys
from html import unescape
from importlib.resources import files
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
import pytest

from palletloc.cli.app import run
from palletloc.evaluation.batch import BatchJob, evaluate_job, find_jobs, pooled
from palletloc.evaluation.pose_error import EvaluationError
from palletloc.evaluation.run import Settings
from palletloc.geometry import LevelPose, level_pose
from palletloc.io.measurements import write_measurements
from palletloc.io.recording import read_recording
from palletloc.io.truth import read_truth
from palletloc.measurement import PalletMeasurement, YawSource

SAMPLE = Path(str(files("palletloc") / "sample"))
DEPTHS = {"a": 0.001, "b": 0.003, "c": 0.005}


def write_run(folder: Path, depth: float) -> None:
    """Write a run over the sample that finds every pallet so much too deep."""
    truth, rows = read_truth(SAMPLE), []
    for shot in read_recording(SAMPLE).shots:
        forklift_from_world = truth.forklift.pose_at(shot.time).transform().inv()
        for pallet in truth.pallets:
            off = LevelPose(depth, 0.0, 0.0, 0.0).transform()
            pose = level_pose(forklift_from_world * pallet.world_from_pallet.transform() * off)
            covariance = 1e-5 * np.eye(4)
            rows.append(PalletMeasurement(shot.time, pallet.model, pose, covariance, 0.9, YawSource.FACE, shot.file))
    folder.mkdir()
    write_measurements(folder / "measurements.csv", rows)


@pytest.fixture
def recordings(tmp_path: Path) -> Path:
    """Return a folder of three recordings with runs of known errors, and one folder that is none."""
    folder = tmp_path / "recordings"
    for name, depth in DEPTHS.items():
        shutil.copytree(SAMPLE, folder / name, ignore=shutil.ignore_patterns("images"))
        write_run(folder / name / "run", depth)
    (folder / "notes").mkdir()
    return folder


def batch(recordings: Path, out: Path, *options: str) -> int:
    return run(["evaluate", "--batch", str(recordings), "--estimate", "run", "--out", str(out), *options])


def read(path: Path) -> Any:
    return json.loads(path.read_text(encoding="utf-8"))


def test_jobs_are_the_recordings_and_their_totals_pool(recordings: Path, tmp_path: Path) -> None:
    jobs = find_jobs(recordings, ["run"], tmp_path / "out", Settings())
    assert [job.recording.name for job in jobs] == list(DEPTHS)
    results = [evaluate_job(job) for job in jobs]
    (one,) = pooled(results)
    assert len(one.offsets) == sum(len(result.totals[0].offsets) for result in results)
    assert np.unique(np.round(one.offsets[:, 0], 5)).tolist() == list(DEPTHS.values())
    assert one.shots == 3 * len(read_recording(SAMPLE).shots)


def test_a_failure_is_told_and_leaves_no_results_of_before(recordings: Path, tmp_path: Path) -> None:
    job = BatchJob(recordings / "a", ("run",), tmp_path / "out", Settings())
    assert evaluate_job(job).problem == ""
    assert sorted(path.name for path in job.out.iterdir()) == ["errors.csv", "metrics.json"]
    (recordings / "a" / "run" / "measurements.csv").unlink()
    result = evaluate_job(job)
    assert "measurements.csv: no such file" in result.problem
    assert result.totals == ()
    assert list(job.out.iterdir()) == []


def test_a_folder_without_recordings_is_refused(tmp_path: Path) -> None:
    with pytest.raises(EvaluationError, match=r"no recordings in it; expected folders with recording\.yaml"):
        find_jobs(tmp_path, ["run"], tmp_path, Settings())
    with pytest.raises(EvaluationError, match="no such folder"):
        find_jobs(tmp_path / "absent", ["run"], tmp_path, Settings())


def test_without_dask_one_line_says_what_to_install(
    recordings: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    assert batch(recordings, tmp_path / "out") == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert "palletloc[batch]" in line
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    "arguments",
    [
        ["--estimate", "run"],
        [str(SAMPLE), "--batch", ".", "--estimate", "run"],
        [str(SAMPLE), "--estimate", "run", "--workers", "2"],
        ["--batch", ".", "--estimate", "/run"],
        ["--batch", ".", "--estimate", "run", "--workers", "2", "--scheduler", "tcp://127.0.0.1:1"],
    ],
)
def test_options_that_contradict_each_other_are_wrong_usage(tmp_path: Path, arguments: list[str]) -> None:
    assert run(["evaluate", "--out", str(tmp_path / "out"), *arguments]) == 2


def test_two_workers_evaluate_all_and_one_failure_does_not_stop_the_rest(
    recordings: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("distributed")
    (recordings / "b" / "truth" / "pallets.csv").unlink()
    assert batch(recordings, tmp_path / "out", "--workers", "2") == 1
    document = read(tmp_path / "out" / "batch.json")
    assert [one["name"] for one in document["recordings"]] == list(DEPTHS)
    assert [one["problem"] is None for one in document["recordings"]] == [True, False, True]
    (overall,) = document["overall"]
    each = [one["sources"][0] for one in document["recordings"] if one["sources"]]
    assert overall["found"] == sum(one["found"] for one in each) > 0
    assert [one["errors"]["depth_m"]["median"] for one in each] == pytest.approx([0.001, 0.005], abs=3e-6)
    assert overall["errors"]["depth_m"]["median"] == pytest.approx(0.003, abs=3e-6)
    alone = read(tmp_path / "out" / "a" / "metrics.json")["runs"][0]
    assert (alone["name"], alone["sources"]["measurements"]["detection"]["recall"]["count"]) == (
        "run",
        each[0]["found"],
    )
    told = capsys.readouterr()
    skipped, last = told.err.splitlines()
    assert skipped.startswith("palletloc: skipped: b: ")
    assert "pallets.csv" in skipped
    assert last == f"palletloc: {recordings}: 1 of 3 recordings could not be evaluated: b; the others are"
    assert "all" in told.out


def test_every_recording_has_its_report_and_the_index_links_them(recordings: Path, tmp_path: Path) -> None:
    pytest.importorskip("distributed")
    out = tmp_path / "out"
    for before in ("metrics.json", "errors.csv", "report.html"):
        (out / "b").mkdir(parents=True, exist_ok=True)
        (out / "b" / before).write_text("from before")
    (recordings / "b" / "truth" / "pallets.csv").write_text("")
    (recordings / "c").rename(recordings / "c & d")
    assert batch(recordings, out, "--workers", "1", "--no-pictures") == 1
    for name in ("a", "c & d"):
        assert sorted(path.name for path in (out / name).iterdir()) == ["errors.csv", "metrics.json", "report.html"]
    assert list((out / "b").iterdir()) == []
    page = (out / "index.html").read_text(encoding="utf-8")
    links = [unquote(unescape(link)) for link in re.findall('href="([^"]*)"', page)]
    assert links == ["a/report.html", "c & d/report.html"]
    assert all((out / link).is_file() for link in links)
    assert "not evaluated" in page
    assert re.search(r"<p>b: [^<]*pallets\.csv[^<]*</p>", page)
    assert page.count("data:image/png;base64,") == 1


def test_the_workers_of_a_scheduler_are_used(
    recordings: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    distributed = pytest.importorskip("distributed")
    places = {"host": "127.0.0.1", "protocol": "tcp://", "dashboard_address": "127.0.0.1:0"}
    with distributed.LocalCluster(n_workers=1, threads_per_worker=1, processes=False, **places) as cluster:
        address = cluster.scheduler_address
        assert address.startswith("tcp://127.0.0.1:")
        monkeypatch.setattr(distributed, "LocalCluster", None)  # no workers of our own
        assert batch(recordings, tmp_path / "out", "--scheduler", address, "--no-pictures") == 0
        assert cluster.scheduler.status.name == "running"
    document = read(tmp_path / "out" / "batch.json")
    assert [one["problem"] for one in document["recordings"]] == [None] * 3
    assert all((tmp_path / "out" / name / "report.html").is_file() for name in DEPTHS)


def test_a_link_to_a_recording_keeps_its_own_name(recordings: Path, tmp_path: Path) -> None:
    (recordings / "z").symlink_to(recordings / "a")
    jobs = find_jobs(recordings, ["run"], tmp_path / "out", Settings())
    assert [job.out.name for job in jobs] == [*DEPTHS, "z"]


def test_if_nothing_can_be_evaluated_nothing_is_written(
    recordings: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("distributed")
    for name in DEPTHS:
        (recordings / name / "truth" / "pallets.csv").unlink()
    assert batch(recordings, tmp_path / "out", "--workers", "1") == 1
    assert "none of 3 recordings can be evaluated" in capsys.readouterr().err.splitlines()[-1]
    assert not (tmp_path / "out").exists()


def test_a_scheduler_that_is_not_there_is_one_line(
    recordings: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("distributed")
    monkeypatch.setattr("palletloc.evaluation.batch.CONNECT_TIMEOUT", 0.5)
    assert batch(recordings, tmp_path / "out", "--scheduler", "tcp://127.0.0.1:1") == 1
    assert capsys.readouterr().err.splitlines()[-1].startswith("palletloc: --scheduler tcp://127.0.0.1:1: cannot be")
