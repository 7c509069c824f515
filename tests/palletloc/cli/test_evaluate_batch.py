import json
import re
import sys
from collections.abc import Callable, Iterator
from html import unescape
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
import pytest

from palletloc.cli.app import run
from palletloc.evaluation.batch import BatchJob, evaluate_job, find_jobs, pooled
from palletloc.evaluation.pose_error import EvaluationError
from palletloc.evaluation.run import Settings
from palletloc.io.recording import read_recording
from tests.palletloc.cli.sample_runs import SAMPLE, without_images, write_run

Refused = Callable[..., str]
DEPTHS = {"a": 0.001, "b": 0.003, "c": 0.005}


@pytest.fixture
def recordings(tmp_path: Path) -> Path:
    """Return a folder of three recordings with runs of known errors, and one folder that is none."""
    folder = tmp_path / "recordings"
    for name, depth in DEPTHS.items():
        write_run(without_images(folder / name) / "run", depth)
    (folder / "notes").mkdir()
    return folder


@pytest.fixture
def scheduler(monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """Return the address of a scheduler whose worker is a thread of the test; it leaves reports empty, to be fast."""
    distributed = pytest.importorskip("distributed")
    monkeypatch.setattr("palletloc.report.evaluation_page.evaluation_page", lambda *_, **__: "")
    places = {"host": "127.0.0.1", "protocol": "tcp://", "dashboard_address": "127.0.0.1:0"}
    with distributed.LocalCluster(n_workers=1, threads_per_worker=1, processes=False, **places) as cluster:
        monkeypatch.setattr(distributed, "LocalCluster", None)  # no workers of our own
        yield cluster.scheduler_address
        assert cluster.scheduler.status.name == "running"


def batch_command(recordings: Path, out: Path, *options: str) -> list[str]:
    return ["evaluate", "--batch", str(recordings), "--estimate", "run", "--out", str(out), *options]


def read(path: Path) -> Any:
    return json.loads(path.read_text(encoding="utf-8"))


def test_jobs_are_the_recordings_and_their_totals_pool(recordings: Path, tmp_path: Path) -> None:
    jobs = find_jobs(recordings, ["run"], tmp_path / "out", Settings())
    assert [job.recording.name for job in jobs] == list(DEPTHS)
    results = [evaluate_job(job) for job in jobs]
    (totals,) = pooled(results)
    assert len(totals.offsets) == sum(len(result.totals[0].offsets) for result in results)
    assert np.unique(np.round(totals.offsets[:, 0], 5)).tolist() == list(DEPTHS.values())
    assert totals.shots == 3 * len(read_recording(SAMPLE).shots)


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
    recordings: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, refused: Refused
) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    assert "palletloc[batch]" in refused(*batch_command(recordings, tmp_path / "out"))
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


def test_one_failure_does_not_stop_the_rest(
    recordings: Path, tmp_path: Path, scheduler: str, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    for before in ("metrics.json", "errors.csv", "report.html"):
        (out / "b").mkdir(parents=True, exist_ok=True)
        (out / "b" / before).write_text("from before")
    (recordings / "b" / "truth" / "pallets.csv").unlink()
    (recordings / "c").rename(recordings / "c & d")
    assert run(batch_command(recordings, out, "--scheduler", scheduler, "--no-pictures")) == 1
    document = read(out / "batch.json")
    assert [part["name"] for part in document["recordings"]] == ["a", "b", "c & d"]
    assert [part["problem"] is None for part in document["recordings"]] == [True, False, True]
    (overall,) = document["overall"]
    each = [part["sources"][0] for part in document["recordings"] if part["sources"]]
    assert overall["found"] == sum(part["found"] for part in each) > 0
    assert [part["errors"]["depth_m"]["median"] for part in each] == pytest.approx([0.001, 0.005], abs=3e-6)
    assert overall["errors"]["depth_m"]["median"] == pytest.approx(0.003, abs=3e-6)
    alone = read(out / "a" / "metrics.json")["runs"][0]
    counted = alone["sources"]["measurements"]["detection"]["recall"]["count"]
    assert (alone["name"], counted) == ("run", each[0]["found"])
    printed = capsys.readouterr()
    skipped, last = printed.err.splitlines()
    assert skipped.startswith("palletloc: skipped: b: ")
    assert "pallets.csv" in skipped
    assert last == f"palletloc: {recordings}: 1 of 3 recordings could not be evaluated: b; the others are"
    assert "all" in printed.out
    # each recording has its own report, the failed one nothing of before, and the index links them
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


@pytest.mark.slow
def test_two_workers_evaluate_all(recordings: Path, tmp_path: Path) -> None:
    pytest.importorskip("distributed")
    assert run(batch_command(recordings, tmp_path / "out", "--workers", "2", "--no-pictures")) == 0
    document = read(tmp_path / "out" / "batch.json")
    assert [part["problem"] for part in document["recordings"]] == [None] * 3
    for name in DEPTHS:
        assert "Errors against" in (tmp_path / "out" / name / "report.html").read_text(encoding="utf-8")


def test_a_link_to_a_recording_keeps_its_own_name(recordings: Path, tmp_path: Path) -> None:
    (recordings / "z").symlink_to(recordings / "a")
    jobs = find_jobs(recordings, ["run"], tmp_path / "out", Settings())
    assert [job.out.name for job in jobs] == [*DEPTHS, "z"]


def test_if_nothing_can_be_evaluated_nothing_is_written(
    recordings: Path, tmp_path: Path, scheduler: str, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in DEPTHS:
        (recordings / name / "truth" / "pallets.csv").unlink()
    assert run(batch_command(recordings, tmp_path / "out", "--scheduler", scheduler)) == 1
    assert "none of 3 recordings can be evaluated" in capsys.readouterr().err.splitlines()[-1]
    assert not (tmp_path / "out").exists()


def test_a_scheduler_that_is_not_there_is_one_line(
    recordings: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, refused: Refused
) -> None:
    pytest.importorskip("distributed")
    monkeypatch.setattr("palletloc.evaluation.batch.CONNECT_TIMEOUT", 0.5)
    told = refused(*batch_command(recordings, tmp_path / "out", "--scheduler", "tcp://127.0.0.1:1"))
    assert told.startswith("--scheduler tcp://127.0.0.1:1: cannot be")
