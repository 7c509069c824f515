import base64
import re
from collections.abc import Callable
from html import escape
from html.parser import HTMLParser
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml

import palletloc.report.evaluation_page
import palletloc.report.worst_shots
from palletloc import Method, PalletLocError, PalletMeasurement, read_recording
from palletloc.cli.app import run
from palletloc.evaluation.requirement import Requirement
from palletloc.evaluation.run import evaluate_run, read_run
from palletloc.evaluation.truth import read_recording_truth
from palletloc.io.measurements import NoPose, read_measurements, write_measurements
from palletloc.io.truth import read_truth
from palletloc.report.worst_shots import run_method, worst_shots
from tests.palletloc.cli.sample_runs import SAMPLE, evaluate, read_metrics, without_images, write_run, write_survey

Refused = Callable[..., str]


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


@pytest.fixture(scope="module")
def estimate(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a run that finds every pallet of the sample 3 mm too deep, and one where none stands."""
    return write_run(tmp_path_factory.mktemp("runs") / "run", yaw=0.0, false=True)


@pytest.fixture(scope="module")
def surveyed(tmp_path_factory: pytest.TempPathFactory, estimate: Path) -> Path:
    """Return the results of a recording with an exact survey beside its path, and images that are not there."""
    folder = tmp_path_factory.mktemp("surveyed")
    survey(without_images(folder / "recording"), without_shot=True)
    assert evaluate(folder / "recording", folder / "out", "--estimate", estimate) == 0
    return folder / "out"


def page_of(out: Path) -> str:
    return (out / "report.html").read_text(encoding="utf-8")


def survey(recording: Path, shift: float = 0.0, without_shot: bool = False) -> None:
    """Add an exact survey at the first two shots, and at a time of no shot; ``shift`` moves the forklift only."""
    times = [shot.time for shot in read_recording(recording).shots[:2]] + [0.5] * without_shot
    write_survey(recording, {f"S{number}": time for number, time in enumerate(times, start=1)}, shift)


def move_stops(recording: Path, by: float) -> None:
    plan = recording / "truth" / "survey.yaml"
    spec = yaml.safe_load(plan.read_text())
    for stop in spec["stops"]:
        stop["time_s"] += by
    plan.write_text(yaml.safe_dump(spec))


@pytest.mark.usefixtures("only_the_worst")
def test_the_report_needs_nothing_but_itself_and_all_of_its_pictures_open(tmp_path: Path, estimate: Path) -> None:
    assert evaluate(SAMPLE, tmp_path / "out", "--estimate", estimate) == 0
    page = page_of(tmp_path / "out")
    elements = Elements(page)
    assert elements.open == []
    assert "script" not in elements.tags
    kinds = [link.split(";")[0] for link in elements.links]
    assert kinds.count("data:image/png") == 4
    assert kinds.count("data:image/jpeg") == 2 + 2  # the worst shot, its face enlarged, and its stages
    assert len(kinds) == 8
    for link in elements.links:
        content = np.frombuffer(base64.b64decode(link.partition("base64,")[2]), dtype=np.uint8)
        image = cv2.imdecode(content, cv2.IMREAD_COLOR)
        assert image is not None
        assert min(image.shape[:2]) > 100
    assert "http" not in re.sub(r'src="[^"]*"', "", page)
    # the localizer does not give this pose, so its stages are those of a measurement that starts there
    (part,) = re.findall(r"<details.*?</details>", page, flags=re.DOTALL)
    assert "The method refined with its default parameters does not give this pose by itself" in part
    captions = re.findall(r"<figcaption>(.*?)</figcaption>", part)
    assert [caption.split(": ")[1].split()[0] for caption in captions] == ["hypotheses", "front"]


def test_the_report_tells_what_the_metrics_tell(tmp_path: Path, estimate: Path) -> None:
    other = write_run(tmp_path / "other")
    options = ("--no-pictures", "--requirement-mm", "2", "--estimate", other)
    assert evaluate(SAMPLE, tmp_path / "out", "--estimate", estimate, *options) == 0
    page = page_of(tmp_path / "out")
    detection = read_metrics(tmp_path / "out")["runs"][0]["sources"]["measurements"]["detection"]
    assert f"<b>{detection['recall']['count']} of {detection['recall']['of']}</b>" in page
    assert f"<b>{detection['false']}</b>" in page
    assert detection["false"] == len(read_recording(SAMPLE).shots)
    assert "the requirement is not met" in page
    assert "Runs side by side" in page
    assert "data:image/jpeg" not in page


def test_no_half_written_result_when_drawing_fails(
    tmp_path: Path, estimate: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fails(*_: object, **__: object) -> str:
        raise PalletLocError("cannot draw")

    monkeypatch.setattr(palletloc.report.evaluation_page, "evaluation_page", fails)
    assert evaluate(SAMPLE, tmp_path / "out", "--estimate", estimate) == 1
    assert capsys.readouterr().err.splitlines()[-1] == "palletloc: cannot draw"
    assert not (tmp_path / "out").exists()


def test_an_exact_survey_agrees_with_the_path_and_judges_the_stops_and_missing_images_are_said(
    surveyed: Path,
) -> None:
    document = read_metrics(surveyed)
    assert document["truth"]["kind"] == "path"
    against = document["truth"]["survey"]["against_path"]
    assert len(against) == 3 * len(read_truth(SAMPLE).pallets)
    assert max(pose["position_m"] for pose in against) < 1e-4
    stops = document["runs"][0]["sources"]["measurements"]["stops"]
    assert {stop["stop"] for stop in stops} == {"S1", "S2"}
    assert [stop["ap_m"] for stop in stops] == pytest.approx([0.003] * len(stops), abs=2e-4)
    assert all(stop["rp_m"] is None and stop["n"] == 1 and stop["truth_sigma_m"]["depth"] > 0 for stop in stops)
    page = page_of(surveyed)
    assert "At the surveyed stops" in page
    assert page.count("No picture: ") == 4
    assert "<details" not in page


def test_a_survey_alone_is_truth_enough_for_its_stops(tmp_path: Path, recording: Path, estimate: Path) -> None:
    survey(recording)
    (recording / "truth" / "forklift.csv").unlink()
    assert evaluate(recording, tmp_path / "out", "--estimate", estimate) == 0
    document = read_metrics(tmp_path / "out")
    source = document["runs"][0]["sources"]["measurements"]
    assert (document["truth"]["kind"], source["detection"]["shots"]) == ("survey", 2)
    assert source["errors"]["depth_m"]["bias"] == pytest.approx(0.003, abs=2e-4)
    assert len(document["truth"]["pairing"]["shots_without_truth"]) == len(read_recording(recording).shots) - 2


def test_a_survey_of_another_site_or_other_stops_is_refused(
    tmp_path: Path, recording: Path, estimate: Path, refused: Refused
) -> None:
    command = ("evaluate", recording, "--out", tmp_path / "out", "--estimate", estimate)
    survey(recording, shift=1.5)
    assert re.search(r"survey\.yaml: stop 'S1'.*another site", refused(*command))
    (recording / "truth" / "forklift.csv").unlink()
    move_stops(recording, 0.5)
    assert "no shot within 0.01 s of a stop" in refused(*command)
    move_stops(recording, 900.0)
    said = r"survey\.yaml: stops from 900[.\d]* s to 901[.\d]* s, shots from 0 s to 6\.4 s: expected"
    assert re.search(said, refused(*command))
    assert not (tmp_path / "out").exists()


@pytest.mark.usefixtures("undrawn")
def test_a_stop_without_a_shot_is_told(
    tmp_path: Path, recording: Path, estimate: Path, surveyed: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    survey(recording, without_shot=True)
    assert evaluate(recording, tmp_path / "out", "--estimate", estimate) == 0
    told = r"stop 'S3': the nearest shot is 0\.\d+ s away, not 0\.01 s; see --stop-limit"
    note = re.search(told, capsys.readouterr().out)
    assert note is not None
    assert note[0] in read_metrics(tmp_path / "out")["truth"]["survey"]["notes"]
    assert escape(note[0]) in page_of(surveyed)


def test_the_report_says_how_good_the_survey_is(surveyed: Path) -> None:
    page = page_of(surveyed)
    assert "1 mm in each of two targets 1.1 m apart turns a front by 0.07\N{DEGREE SIGN}" in page
    described = read_metrics(surveyed)["truth"]["survey"]
    assert described["instrument"] is None  # points alone
    bodies = {body["body"]: body for body in described["bodies"]}
    assert set(bodies) == {"stop 'S1'", "stop 'S2'", "stop 'S3'", "body 'A'", "body 'B'", "body 'C'"}
    for body in bodies.values():
        assert body["rms_m"] < 2e-5
        assert all(point["residual_m"] < 5e-5 for point in body["points"])
        left_out = [point["leave_one_out_m"] for point in body["points"]]  # None where two others fix no pose
        assert len(left_out) == 3
        assert max(value for value in left_out if value is not None) < 1e-4
    across = np.degrees(np.sqrt(2) * 0.0006 / 1.1)
    assert across * 0.5 < bodies["body 'A'"]["yaw_sigma_deg"] <= 1.001 * across


def test_a_pallet_turned_otherwise_than_surveyed_or_not_in_the_table_is_refused(
    tmp_path: Path, recording: Path, estimate: Path, refused: Refused
) -> None:
    survey(recording)
    path = recording / "truth" / "pallets.csv"
    header, first, *others = path.read_text().splitlines()
    turned = [[header, f"{first.rpartition(',')[0]},{yaw}", *others] for yaw in ("0.9", "88.2")]
    for lines, told in (
        (turned[0], "are their angles in radians"),
        (turned[1], "line 2: yaw_rad: expected radians"),
        ([header, first, *others[:-1]], "is not in pallets.csv"),
    ):
        path.write_text("\n".join(lines) + "\n")
        assert told in refused("evaluate", recording, "--out", tmp_path / "out", "--estimate", estimate)


@pytest.fixture
def only_the_worst(monkeypatch: pytest.MonkeyPatch) -> None:
    """Show a single shot, to be fast."""
    monkeypatch.setattr(palletloc.report.worst_shots, "WORST", 1)


@pytest.fixture(scope="module")
def localized(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the pallets on the floor by a method that takes their yaw from a horizontal view."""
    folder = tmp_path_factory.mktemp("localized") / "run"
    assert run(["localize", str(SAMPLE), "--out", str(folder), "--method", "horizontal_plane"]) == 0
    write_measurements(
        folder / "measurements.csv", [row for row in poses(folder) if row.forklift_from_pallet.z < 0.5]
    )
    return folder


def poses(folder: Path) -> list[PalletMeasurement]:
    return [row for row in read_measurements(folder / "measurements.csv") if not isinstance(row, NoPose)]


def report(estimate: Path, out: Path) -> str:
    assert evaluate(SAMPLE, out, "--estimate", estimate) == 0
    return (out / "report.html").read_text(encoding="utf-8")


def folds(page: str) -> list[str]:
    return re.findall(r"<details.*?</details>", page, flags=re.DOTALL)


@pytest.mark.usefixtures("only_the_worst")
def test_the_worst_shots_come_with_every_stage_of_the_run_s_own_method(localized: Path, tmp_path: Path) -> None:
    page = report(localized, tmp_path / "out")
    assert len(page) < 4e6
    (part,) = folds(page)
    name = re.findall(r"method horizontal_plane on the way to (P\d)\.", part)[0]
    captions = re.findall(r"<figcaption>(.*?)</figcaption>", part)
    assert captions[0] == "Where pallets were looked for, and where they were found."
    assert [caption.split(": ")[1].split()[0] for caption in captions[1:]] == ["yaw", "position", "front"]
    assert all(caption.startswith(f"{name}: ") for caption in captions[1:])
    assert part.count("data:image/jpeg;base64,") == len(captions) == 4


def test_a_folder_that_tells_no_method_has_none(tmp_path: Path, localized: Path) -> None:
    assert run_method(localized) is Method.HORIZONTAL_PLANE
    assert run_method(tmp_path) is None
    for text in ("", "[]", '{"run": {"method": "guess"}}', '{"run": null}'):
        (tmp_path / "run.json").write_text(text)
        assert run_method(tmp_path) is None


def test_the_true_outline_stays_visible_where_the_measured_one_agrees_with_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(palletloc.report.worst_shots, "_shot_stages", lambda *_: None)
    truth = read_recording_truth(SAMPLE)
    files = read_run(write_run(tmp_path / "run", depth=0.0, yaw=0.0), truth.recording, "run")
    (worst,) = worst_shots(evaluate_run(truth, files), truth.recording, Requirement(), number=1)
    for content, least in ((worst.picture, 100), (worst.closer, 150)):
        picture = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_COLOR)
        blue, green, red = np.asarray(picture).astype(int).transpose(2, 0, 1)
        assert ((red > 180) & (green < 130)).sum() > least  # pink
        assert ((green > 110) & (green > red) & (green > blue + 10)).sum() > least // 4
