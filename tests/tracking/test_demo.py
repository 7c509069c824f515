import csv
import json
import re
from html.parser import HTMLParser
from importlib.resources import files
from pathlib import Path

import cv2
import numpy as np
import pytest

from palletloc.__main__ import COMMANDS
from palletloc.cli.app import run
from palletloc.evaluation.recording import ERROR_COLUMNS
from palletloc.io.measurements import NoPose, read_measurements
from palletloc.io.recording import check_shelf, read_recording
from palletloc.io.truth import read_truth

SAMPLE = Path(str(files("palletloc") / "sample"))
pytestmark = pytest.mark.slow  # it localizes, tracks and evaluates the whole sample


class Links(HTMLParser):
    """Collects what a page refers to, and which elements it has."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: set[str] = set()
        self.links: list[str] = []
        self.without_text: list[str] = []
        self.open: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.add(tag)
        if tag not in ("img", "meta", "br", "link"):
            self.open.append(tag)
        values = dict(attrs)
        self.links += [value for name in ("src", "href") if (value := values.get(name)) is not None]
        if tag == "img" and not values.get("alt"):
            self.without_text.append(str(values))

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return what the demo wrote into a folder that had a page before."""
    out = tmp_path_factory.mktemp("demo") / "out"
    out.mkdir()
    (out / "index.html").write_text("from before")
    assert run(["demo", "--out", str(out)], COMMANDS) == 0
    return out


@pytest.fixture(scope="module")
def page(folder: Path) -> str:
    return (folder / "index.html").read_text(encoding="utf-8")


def errors_of(folder: Path, source: str = "measurements") -> list[dict[str, str]]:
    with (folder / "errors.csv").open(newline="") as file:
        return [row for row in csv.DictReader(file) if row["source"] == source]


def test_the_files_of_every_step_are_there(folder: Path) -> None:
    names = {path.name for path in folder.iterdir()}
    localized = {"measurements.csv", "refusals.csv", "run.json"}
    tracked = {"tracks.csv", "tracks", "events.csv", "tracks.png", "tracks_smoothed.csv", "tracks_smoothed"}
    evaluated = {"metrics.json", "errors.csv", "report.html"}
    assert names == {*localized, *tracked, *evaluated, "index.html", "pictures"}
    assert {"1-shelf.png", "5-overlay.jpg", "explain.json"} <= {path.name for path in (folder / "pictures").iterdir()}
    assert len(list((folder / "tracks").iterdir())) == 3


def test_the_steps_belong_together(folder: Path, tmp_path: Path) -> None:
    again = tmp_path / "again"
    given = str(folder / "measurements.csv")
    assert run(["track", str(SAMPLE), "--measurements", given, "--smooth", "--out", str(again)], COMMANDS) == 0
    for name in ("tracks.csv", "tracks_smoothed.csv", "events.csv"):
        assert (folder / name).read_text() == (again / name).read_text()
    assert run(["evaluate", str(SAMPLE), "--no-pictures", "--estimate", str(folder), "--out", str(again)]) == 0
    ours, theirs = (json.loads((each / "metrics.json").read_text())["runs"][0] for each in (folder, again))
    assert ours["sources"] == theirs["sources"]


def test_tracks_are_right_to_what_is_promised(folder: Path, page: str) -> None:
    rows = errors_of(folder, "tracks")
    assert {row["pallet"] for row in rows} >= {"A", "C"}
    assert max(abs(float(row["yaw_rad"])) for row in rows) < np.radians(1.0)
    assert max(abs(float(row["depth_m"])) for row in rows) < 0.03
    for name in ("single shots", "tracks", "tracks, smoothed"):
        assert page.count(f'<td class="text">{name}</td>') == 1


def test_the_poses_are_right_to_what_is_promised(folder: Path) -> None:
    rows = errors_of(folder)
    assert len(rows) >= 11
    near = [row for row in rows if float(row["range_m"]) <= 4.5]
    floor = [row for row in near if row["pallet"] in ("A", "B")]
    assert max(abs(float(row["yaw_rad"])) for row in floor) < np.radians(0.3)
    assert max(abs(float(row["depth_m"])) for row in floor) < 0.015
    assert max(abs(float(row["along_m"])) for row in floor) < 0.030
    level = [row for row in near if row["pallet"] == "C"]  # 0.3 m below the camera
    assert max(abs(float(row["yaw_rad"])) for row in level) < np.radians(1.5)
    assert max(abs(float(row["depth_m"])) for row in level) < 0.06


def test_every_near_pallet_is_found_and_nothing_else(folder: Path, page: str) -> None:
    measured = read_measurements(folder / "measurements.csv")
    assert not any(isinstance(measurement, NoPose) for measurement in measured)
    assert len(measured) == len(errors_of(folder))
    assert re.search(r"\b1[01] of 11\b", page)  # one is 4.3 m away, hardly below the camera


def test_errors_are_those_of_the_measurements_against_the_truth(folder: Path) -> None:
    measured = read_measurements(folder / "measurements.csv")
    truth = read_truth(SAMPLE)
    pallets = {pallet.id: pallet.world_from_pallet for pallet in truth.pallets}
    for row in errors_of(folder):
        assert list(row) == list(ERROR_COLUMNS)
        world = truth.forklift.pose_at(float(row["time_s"])).transform()
        true = pallets[row["pallet"]]
        offset = [float(row["depth_m"]), -float(row["along_m"])]  # into the shelf, and to the right
        into = np.array([np.cos(true.yaw), np.sin(true.yaw)])
        expected = np.array([true.x, true.y]) + offset[0] * into + offset[1] * np.array([into[1], -into[0]])
        places = [
            world.apply(measurement.forklift_from_pallet.as_array()[:3])
            for measurement in measured
            if not isinstance(measurement, NoPose) and measurement.time == float(row["time_s"])
        ]
        assert min(np.hypot(*(place[:2] - expected)) for place in places) < 2e-5


def test_the_page_needs_nothing_from_outside(folder: Path, page: str) -> None:
    parsed = Links(page)
    assert parsed.tags & {"script", "link", "iframe", "object"} == set()
    assert "url(" not in page
    assert len(parsed.links) >= 6
    for link in parsed.links:
        assert ":" not in link
        assert (folder / link).is_file(), link
    assert parsed.without_text == []
    assert parsed.open == []


def test_the_page_shows_every_measurement(folder: Path, page: str) -> None:
    assert page.startswith("<!doctype html>")
    tables = [len(re.findall("<tr>", table)) - 1 for table in re.findall("<table>.*?</table>", page, re.DOTALL)]
    assert tables == [3, 3, len(errors_of(folder))]  # tracks, sources, single shots
    assert '<meta name="viewport"' in page
    assert "from before" not in page


def test_the_explained_shot_is_the_one_with_most_pallets(folder: Path) -> None:
    document = json.loads((folder / "pictures" / "explain.json").read_text())
    counts: dict[str, int] = {}
    for row in errors_of(folder):
        counts[row["file"]] = counts.get(row["file"], 0) + 1
    assert document["pallets"] == counts[document["file"]] == max(counts.values())


def test_the_sample_is_a_recording_of_some_three_megabytes() -> None:
    recording = read_recording(SAMPLE)
    check_shelf(recording)
    assert len(recording.shots) == 6
    assert all(recording.image(shot).shape == (1920, 3840, 3) for shot in recording.shots[:1])
    start, end = recording.odometry.span
    assert start <= recording.shots[0].time <= recording.shots[-1].time <= end
    assert sum(path.stat().st_size for path in SAMPLE.rglob("*") if path.is_file()) < 3.5e6


def test_the_sample_is_sharp_where_the_pallets_are() -> None:
    recording = read_recording(SAMPLE)
    image = recording.image(recording.shots[-1], gray=True)
    detail = cv2.Laplacian(image, cv2.CV_32F).std(axis=0)
    assert detail[900:1900].mean() > 3 * detail[2300:3600].mean()


def test_a_place_that_cannot_be_written_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "file").write_text("")
    assert run(["demo", "--out", str(tmp_path / "file" / "out")], COMMANDS) == 1
    error = capsys.readouterr().err
    assert error.startswith("palletloc: ")
    assert error.count("\n") == 1
