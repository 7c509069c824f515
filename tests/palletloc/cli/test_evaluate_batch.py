"""Many recordings at once, and several shots while the forklift stands, in the terms of ISO 9283."""

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
from palletloc.geometry import FloatArray, LevelPose, level_pose
from palletloc.io.measurements import write_measurements
from palletloc.io.recording import read_recording
from palletloc.io.truth import read_truth
from palletloc.measurement import PalletMeasurement, YawSource
from tests.palletloc.cli.sample_runs import (
    SAMPLE,
    evaluate,
    read_metrics,
    true_poses,
    without_images,
    write_run,
    write_survey,
)

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


STOPS = {"S1": 2.694737, "S2": 5.389474}
REPEATS, BETWEEN = 6, 0.2
BIAS = np.array([0.004, -0.002, 0.001, 0.003])
SCATTER = np.array([0.002, 0.003, 0.0005, 0.002])


def times_at(stop: str) -> list[float]:
    return [round(STOPS[stop] + BETWEEN * (number - (REPEATS - 1) / 2), 6) for number in range(REPEATS)]


def errors_at(stop: str, pallet: str) -> FloatArray:
    """Return (n, 4) errors of depth, along, height and yaw: the same ones whenever they are asked for."""
    rng = np.random.default_rng([list(STOPS).index(stop), ord(pallet)])
    return BIAS + SCATTER * rng.standard_normal((REPEATS, 4))


@pytest.fixture(scope="module")
def stopped(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a recording whose forklift stands twice, surveyed there and nowhere else."""
    folder = without_images(tmp_path_factory.mktemp("stops") / "recording")
    (folder / "truth" / "forklift.csv").unlink()
    times = [time for stop in STOPS for time in times_at(stop)]
    shots = [f"{time},images/{number:06}.jpg" for number, time in enumerate(times)]
    (folder / "shots.csv").write_text("\n".join(["time_s,file", *shots]) + "\n")
    write_survey(folder, STOPS)
    return folder


@pytest.fixture(scope="module")
def estimate(tmp_path_factory: pytest.TempPathFactory) -> Path:
    models = {pallet.id: pallet.model for pallet in read_truth(SAMPLE).pallets}
    rows = [
        PalletMeasurement(time, models[name], pose, np.diag(SCATTER**2), 0.9, YawSource.FACE, "a.jpg")
        for stop, stood in STOPS.items()
        for name, true in true_poses(SAMPLE, stood).items()
        for time, error in zip(times_at(stop), errors_at(stop, name), strict=True)
        for pose in [level_pose(true.transform() * LevelPose(*error).transform())]
    ]
    folder = tmp_path_factory.mktemp("run")
    write_measurements(folder / "measurements.csv", rows)
    return folder


@pytest.fixture(scope="module")
def evaluated(tmp_path_factory: pytest.TempPathFactory, stopped: Path, estimate: Path) -> Path:
    """Return the results with every shot of a stop as a repetition."""
    out = tmp_path_factory.mktemp("results")
    assert evaluate(stopped, out, "--estimate", estimate, "--no-pictures", "--stop-limit", "0.6") == 0
    return out


def stops_of(out: Path) -> list[Any]:
    return list(read_metrics(out)["runs"][0]["sources"]["measurements"]["stops"])


def test_every_shot_of_a_stop_is_a_repetition(evaluated: Path) -> None:
    found = stops_of(evaluated)
    assert len(found) >= 4
    for stop in found:
        errors = errors_at(stop["stop"], stop["pallet"])
        middle = errors.mean(axis=0)
        away = np.sqrt(((errors[:, :3] - middle[:3]) ** 2).sum(axis=1))
        deviation = np.sqrt(((away - away.mean()) ** 2).sum() / (REPEATS - 1))
        turned = np.sqrt(((errors[:, 3] - middle[3]) ** 2).sum() / (REPEATS - 1))
        assert stop["n"] == REPEATS
        assert stop["ap_m"] == pytest.approx(np.sqrt((middle[:3] ** 2).sum()), abs=3e-5)
        assert stop["rp_m"] == pytest.approx(away.mean() + 3 * deviation, abs=1e-5)
        assert stop["ap_yaw_deg"] == pytest.approx(np.degrees(middle[3]), abs=3e-3)
        assert stop["rp_yaw_deg"] == pytest.approx(np.degrees(3 * turned), abs=1e-3)


def test_the_report_has_a_row_for_each_stop_with_its_repeatability(evaluated: Path) -> None:
    page = (evaluated / "report.html").read_text(encoding="utf-8")
    for stop in stops_of(evaluated):
        numbers = (1000 * stop[name] for name in ("ap_m", "rp_m"))
        cells = [stop["stop"], stop["pallet"], str(REPEATS), *(f"{number:.1f}" for number in numbers)]
        row = "".join(f'<td class="text">{cell}</td>' for cell in cells[:2])
        assert row + "".join(f"<td>{cell}</td>" for cell in cells[2:]) in page


@pytest.mark.usefixtures("undrawn")
def test_the_limit_says_which_shots_belong_to_a_stop(tmp_path: Path, stopped: Path, estimate: Path) -> None:
    assert evaluate(stopped, tmp_path / "out", "--estimate", estimate, "--stop-limit", "0.11") == 0
    assert {stop["n"] for stop in stops_of(tmp_path / "out")} == {2}
    assert evaluate(stopped, tmp_path / "none", "--estimate", estimate, "--stop-limit", "0.05") == 1
    assert not (tmp_path / "none").exists()
