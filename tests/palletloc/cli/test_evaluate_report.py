from __future__ import annotations

import base64
import json
import re
import shutil
from html import escape
from html.parser import HTMLParser
from importlib.resources import files
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml

import palletloc.report.evaluation_page
from palletloc.cli.app import run
from palletloc.errors import PalletLocError
from palletloc.geometry import FloatArray, LevelPose, level_pose
from palletloc.io.measurements import write_measurements
from palletloc.io.recording import read_recording
from palletloc.io.truth import read_truth
from palletloc.measurement import PalletMeasurement, YawSource

SAMPLE = Path(str(files("palletloc") / "sample"))
LIFT = {"V1": [-0.9, 0.45, 2.1], "V2": [-0.9, -0.45, 2.08], "V3": [0.55, -0.4, 1.2]}
FACE = {"LL": [0.0, 0.55, 0.012], "LR": [0.0, -0.55, 0.012], "UL": [0.0, 0.55, 0.132]}
SITE = LevelPose(410.0, 187.0, 11.6, 0.62)


class Elements(HTMLParser):
    """Collects where a page's elements point to, and checks that they close."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.links: list[str] = []
        self.tags: list[str] = []
        self.open: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        if tag not in ("img", "meta", "br", "link"):
            self.open.append(tag)
        self.links += [value for name, value in attrs if name in ("src", "href") and value]

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    """Return a copy of the sample without its images."""
    folder = tmp_path / "recording"
    shutil.copytree(SAMPLE, folder, ignore=shutil.ignore_patterns("images"))
    return folder


@pytest.fixture
def estimate(tmp_path: Path) -> Path:
    """Return a run that finds every pallet of the sample 3 mm too deep, and one where none stands."""
    truth, rows = read_truth(SAMPLE), []
    for shot in read_recording(SAMPLE).shots:
        forklift_from_world = truth.forklift.pose_at(shot.time).transform().inv()
        off = LevelPose(0.003, 0.0, 0.0, 0.0).transform()
        poses = [level_pose(forklift_from_world * one.world_from_pallet.transform() * off) for one in truth.pallets]
        for pose in (*poses, LevelPose(9.0, 9.0, 0.0, 0.0)):
            model, covariance = truth.pallets[0].model, 1e-5 * np.eye(4)
            rows.append(PalletMeasurement(shot.time, model, pose, covariance, 0.9, YawSource.FACE, shot.file))
    folder = tmp_path / "run"
    folder.mkdir()
    write_measurements(folder / "measurements.csv", rows)
    return folder


def survey(recording: Path, site_from_world: LevelPose = SITE, shift: float = 0.0) -> None:
    """Add an exact survey at the first two shots, in a frame of its own; ``shift`` moves the forklift only."""
    truth, shots = read_truth(recording), read_recording(recording).shots
    site = site_from_world.transform()
    stops = [{"name": f"S{number}", "time_s": shot.time} for number, shot in enumerate(shots[:2], start=1)]
    points: dict[str, FloatArray] = {}
    for stop in stops:
        pose = truth.forklift.pose_at(float(str(stop["time_s"])))
        body = site * LevelPose(pose.x + shift, pose.y, pose.z, pose.yaw).transform()
        points |= {f"{name}-{stop['name']}": body.apply(place) for name, place in LIFT.items()}
    bodies: dict[str, dict[str, list[float]]] = {"forklift": LIFT}
    for pallet in truth.pallets:
        places = {f"{pallet.id}-{name}": place for name, place in FACE.items()}
        bodies[pallet.id] = places
        body = site * pallet.world_from_pallet.transform()
        points |= {name: body.apply(place) for name, place in places.items()}
    lines = [f"{name},{x:.5f},{y:.5f},{z:.5f}" for name, (x, y, z) in points.items()]
    (recording / "truth" / "survey.csv").write_text("\n".join(["name,x_m,y_m,z_m", *lines]) + "\n")
    plan = {"file": "survey.csv", "sigma_m": 0.0006, "stops": stops, "bodies": bodies}
    (recording / "truth" / "survey.yaml").write_text(yaml.safe_dump(plan))


def move_stops(recording: Path, by: float) -> None:
    plan = recording / "truth" / "survey.yaml"
    spec = yaml.safe_load(plan.read_text())
    for stop in spec["stops"]:
        stop["time_s"] += by
    plan.write_text(yaml.safe_dump(spec))


def evaluate(recording: Path, estimate: Path, out: Path, *options: str) -> int:
    return run(["evaluate", str(recording), "--estimate", str(estimate), "--out", str(out), *options])


def metrics(out: Path) -> Any:
    return json.loads((out / "metrics.json").read_text(encoding="utf-8"))


def test_the_report_needs_nothing_but_itself_and_all_of_its_pictures_open(tmp_path: Path, estimate: Path) -> None:
    assert evaluate(SAMPLE, estimate, tmp_path / "out") == 0
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    elements = Elements(page)
    assert elements.open == []
    assert "script" not in elements.tags
    kinds = [link.split(";")[0] for link in elements.links]
    assert kinds.count("data:image/png") == 4
    assert kinds.count("data:image/jpeg") == 4 + 4 * 2  # each worst shot, and its stages
    assert len(kinds) == 16
    for link in elements.links:
        content = np.frombuffer(base64.b64decode(link.partition("base64,")[2]), dtype=np.uint8)
        image = cv2.imdecode(content, cv2.IMREAD_COLOR)
        assert image is not None
        assert min(image.shape[:2]) > 100
    assert "http" not in re.sub(r'src="[^"]*"', "", page)


def test_the_report_tells_what_the_metrics_tell(tmp_path: Path, estimate: Path) -> None:
    assert evaluate(SAMPLE, estimate, tmp_path / "out", "--no-pictures", "--requirement-mm", "2") == 0
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    detection = metrics(tmp_path / "out")["runs"][0]["sources"]["measurements"]["detection"]
    assert f"<b>{detection['recall']['count']} of {detection['recall']['of']}</b>" in page
    assert f"<b>{detection['false']}</b>" in page
    assert detection["false"] == len(read_recording(SAMPLE).shots)
    assert "the requirement is not met" in page
    assert "data:image/jpeg" not in page


def test_images_that_cannot_be_read_are_said_and_do_not_stop_the_report(
    tmp_path: Path, recording: Path, estimate: Path
) -> None:
    assert evaluate(recording, estimate, tmp_path / "out") == 0
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert page.count("No picture: ") == 4
    assert "<details" not in page


def test_no_half_written_result_when_drawing_fails(
    tmp_path: Path, estimate: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fails(*_: object, **__: object) -> str:
        raise PalletLocError("cannot draw")

    monkeypatch.setattr(palletloc.report.evaluation_page, "evaluation_page", fails)
    assert evaluate(SAMPLE, estimate, tmp_path / "out") == 1
    assert capsys.readouterr().err.splitlines()[-1] == "palletloc: cannot draw"
    assert not (tmp_path / "out").exists()


def test_an_exact_survey_agrees_with_the_path_and_judges_the_stops(
    tmp_path: Path, recording: Path, estimate: Path
) -> None:
    survey(recording)
    assert evaluate(recording, estimate, tmp_path / "out") == 0
    document = metrics(tmp_path / "out")
    assert document["truth"]["kind"] == "path"
    against = document["truth"]["survey"]["against_path"]
    assert len(against) == 2 * len(read_truth(recording).pallets)
    assert max(one["position_m"] for one in against) < 1e-4
    stops = document["runs"][0]["sources"]["measurements"]["stops"]
    assert {one["stop"] for one in stops} == {"S1", "S2"}
    assert [one["ap_m"] for one in stops] == pytest.approx([0.003] * len(stops), abs=2e-4)
    assert all(one["rp_m"] is None and one["n"] == 1 and one["truth_sigma_m"]["depth"] > 0 for one in stops)
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert "At the surveyed stops" in page


def test_a_survey_alone_is_truth_enough_for_its_stops(tmp_path: Path, recording: Path, estimate: Path) -> None:
    survey(recording)
    (recording / "truth" / "forklift.csv").unlink()
    assert evaluate(recording, estimate, tmp_path / "out") == 0
    document = metrics(tmp_path / "out")
    source = document["runs"][0]["sources"]["measurements"]
    assert (document["truth"]["kind"], source["detection"]["shots"]) == ("survey", 2)
    assert source["errors"]["depth_m"]["bias"] == pytest.approx(0.003, abs=2e-4)
    assert len(document["truth"]["pairing"]["shots_without_truth"]) == len(read_recording(recording).shots) - 2


def test_a_survey_of_another_site_or_other_stops_is_refused(
    tmp_path: Path, recording: Path, estimate: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    survey(recording, shift=1.5)
    assert evaluate(recording, estimate, tmp_path / "out") == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert "survey.yaml: stop 'S1'" in line
    assert "another site" in line
    (recording / "truth" / "forklift.csv").unlink()
    move_stops(recording, 0.5)
    assert evaluate(recording, estimate, tmp_path / "out") == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert "no shot within 0.01 s of a stop" in line
    move_stops(recording, 900.0)
    assert evaluate(recording, estimate, tmp_path / "out") == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert re.search(r"survey\.yaml: stops from 900[.\d]* s to 901[.\d]* s, shots from 0 s to 6\.4 s: expected", line)
    assert not (tmp_path / "out").exists()


def test_a_stop_without_a_shot_is_told(
    tmp_path: Path, recording: Path, estimate: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    survey(recording)
    move_stops(recording, 0.5)
    assert evaluate(recording, estimate, tmp_path / "out", "--no-pictures") == 0
    told = "stop 'S1': the nearest shot is 0.5 s away, not 0.01 s; see --stop-limit"
    assert told in capsys.readouterr().out
    assert told in metrics(tmp_path / "out")["truth"]["survey"]["notes"]
    assert escape(told) in (tmp_path / "out" / "report.html").read_text(encoding="utf-8")


def test_the_report_says_how_good_the_survey_is(tmp_path: Path, recording: Path, estimate: Path) -> None:
    survey(recording)
    assert evaluate(recording, estimate, tmp_path / "out", "--no-pictures") == 0
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert "1 mm in each of two targets 1.1 m apart turns a front by 0.07\N{DEGREE SIGN}" in page
    told = metrics(tmp_path / "out")["truth"]["survey"]
    assert told["instrument"] is None  # points alone
    bodies = {one["body"]: one for one in told["bodies"]}
    assert set(bodies) == {"stop 'S1'", "stop 'S2'", "body 'A'", "body 'B'", "body 'C'"}
    for one in bodies.values():
        assert one["rms_m"] < 2e-5
        assert all(point["residual_m"] < 5e-5 for point in one["points"])
        left_out = [point["leave_one_out_m"] for point in one["points"]]  # None where two others fix no pose
        assert len(left_out) == 3
        assert max(value for value in left_out if value is not None) < 1e-4
    across = np.degrees(np.sqrt(2) * 0.0006 / 1.1)
    assert across * 0.5 < bodies["body 'A'"]["yaw_sigma_deg"] <= 1.001 * across


def test_a_pallet_turned_otherwise_than_surveyed_is_refused(
    tmp_path: Path, recording: Path, estimate: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    survey(recording)
    path = recording / "truth" / "pallets.csv"
    lines = path.read_text().splitlines()
    for yaw, told in (("0.9", "are their angles in radians"), ("88.2", "line 2: yaw_rad: expected radians")):
        path.write_text("\n".join([lines[0], lines[1].rpartition(",")[0] + "," + yaw, *lines[2:]]) + "\n")
        assert evaluate(recording, estimate, tmp_path / "out") == 1
        (line,) = capsys.readouterr().err.splitlines()
        assert told in line


def test_a_surveyed_pallet_that_is_not_in_the_table_is_refused(
    tmp_path: Path, recording: Path, estimate: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    survey(recording)
    path = recording / "truth" / "pallets.csv"
    path.write_text("\n".join(path.read_text().splitlines()[:-1]) + "\n")
    assert evaluate(recording, estimate, tmp_path / "out") == 1
    assert "is not in pallets.csv" in capsys.readouterr().err
