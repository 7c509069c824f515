import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from calibration.drive import Drive
from calibration.findings import DEGENERATE, FAIL, PASS
from calibration.result_page import html_text, json_text
from calibration.shelf.assessment import ShelfAssessment, assess_shelf, plane_beside
from calibration.shelf.front_line import PALLETS, UPRIGHTS
from calibration.shelf.landmarks import Skipped, motion_refusal
from calibration.shelf.plane import Foot, PlaneEstimate, fuse
from calibration.shelf.plane_sweep import Peak, PlaneSweep
from calibration.shelf.problem import DriveSolution, Observed
from calibration.shelf.report import recording_text, shelf_page
from calibration.shelf.survey import Front, ShelfSurvey
from calibration.shelf.upright_edges import Edges
from palletloc.errors import PalletLocError
from palletloc.geometry import FloatArray, LevelPose, wrap_angle
from palletloc.io.csv_table import read_rows
from palletloc.io.recording import RECORDING, read_recording
from palletloc.io.schema import RecordingSpec
from palletloc.io.yaml_document import read_document
from palletloc.shelf import ShelfPlane
from tests.calibration.expecting import Calibrate

SAMPLE = Path(__file__).resolve().parents[3] / "palletloc" / "sample"
FOOT = Foot(np.array([1.0, 0.0]), np.pi / 2)
CAMERA = np.array([0.2, 0.0])
PRIOR = ShelfPlane(0.0, 1.9, -np.pi / 2, (0.0,))


def said(
    method: str, turn_deg: float, distance: float, sigma_deg: float = 0.1, sigma: float = 0.005
) -> PlaneEstimate:
    information = np.diag([1 / np.radians(sigma_deg) ** 2, 1 / sigma**2])
    return PlaneEstimate(method, float(np.radians(turn_deg)), distance, information, "seen")


def way(ends: tuple[float, float], count: int = 5) -> Drive:
    """Return a straight way from the origin to a place, heading along x."""
    steps = np.tile([ends[0] / count, ends[1] / count, 0.0], (count, 1))
    return Drive(LevelPose(0.0, 0.0, 0.0, 0.0), steps, np.ones(count))


def survey(*estimates: PlaneEstimate, skipped: tuple[Skipped, ...] = (), scale: float = 1.0) -> ShelfSurvey:
    drive = way((2.0, 0.0))
    none: FloatArray = np.zeros((0, 3))
    solution = DriveSolution(scale, 0.0, 0.0, drive.poses(), none, np.zeros((0, 2)), np.eye(18), none, np.zeros(0))
    return ShelfSurvey(
        read_recording(SAMPLE), tuple(range(5)), PRIOR, Front.UPRIGHTS, FOOT, Observed(drive, CAMERA), solution, (),
        Edges.none(), np.zeros(0), estimates, skipped, fuse(estimates) if estimates else None,
    )  # fmt: skip


def codes(found: ShelfSurvey) -> tuple[int, set[str]]:
    assessment = assess_shelf(found)
    return assessment.exit_code, {finding.code for finding in assessment.findings}


def shown(assessment: ShelfAssessment) -> tuple[dict[str, Any], str]:
    """Return a result as plain values and as a page."""
    page = shelf_page(assessment)
    return json.loads(json_text(page)), html_text(page)


def test_methods_that_agree_pass() -> None:
    assert codes(survey(said(UPRIGHTS, 0.3, 1.91), said(PALLETS, 0.2, 1.92, 0.5, 0.05))) == (PASS, set())


@pytest.mark.parametrize(
    ("estimates", "code"),
    [
        ((said(UPRIGHTS, 0.0, 1.9), said("tags", 0.0, 1.95)), "methods_disagree"),
        ((said(UPRIGHTS, 0.0, 3.2),), "far_from_prior"),
        ((said(UPRIGHTS, 16.0, 1.9),), "far_from_prior"),
        ((said(UPRIGHTS, 0.0, 1.9, sigma=0.2),), "too_uncertain"),
        ((said(UPRIGHTS, 0.0, 1.9, sigma_deg=2.0),), "too_uncertain"),
    ],
)
def test_each_fault_fails_under_its_own_name(estimates: tuple[PlaneEstimate, ...], code: str) -> None:
    assert codes(survey(*estimates)) == (FAIL, {code})


def test_the_two_that_disagree_are_named() -> None:
    found = assess_shelf(
        survey(said(UPRIGHTS, 0.0, 1.9), said("tags", 0.0, 1.95), said(PALLETS, 0.0, 1.9, 1.0, 0.05))
    )
    (fault,) = found.findings
    assert "uprights" in fault.what
    assert "tags" in fault.what
    assert "+50 mm" in fault.what


def test_restrictions_are_told_and_pass() -> None:
    missing = Skipped(UPRIGHTS, "no_uprights", "no two tall vertical edges line up")
    alone = survey(said(PALLETS, 0.0, 1.9, 0.5, 0.05), skipped=(missing,), scale=1.05)
    assert codes(alone) == (PASS, {"pallets_only", "no_uprights", "uncertain", "odometry_scale"})


def test_nothing_seen_is_degenerate_and_says_why() -> None:
    missing = Skipped(UPRIGHTS, "short_baseline", "the camera moves 0.1 m"), Skipped(PALLETS, "no_pallets", "none")
    found = assess_shelf(survey(skipped=missing))
    assert (found.exit_code, found.findings[0].code) == (DEGENERATE, "short_baseline")
    assert "0.1 m" in found.findings[0].what
    data, page = shown(found)
    assert data["exit_code"] == DEGENERATE
    assert "cannot give the plane" in page


@pytest.mark.parametrize(
    ("ends", "count", "code"),
    [
        ((2.0, 0.0), 5, None),
        ((2.0, 0.3), 5, None),
        ((0.3, 0.0), 5, "short_baseline"),
        ((0.0, 0.0), 5, "short_baseline"),
        ((0.05, 1.2), 5, "along_the_ray"),
        ((2.0, 0.0), 2, "few_shots"),
    ],
)
def test_ways_that_cannot_triangulate_are_named(ends: tuple[float, float], count: int, code: str | None) -> None:
    refusal = motion_refusal(way(ends, count), CAMERA, FOOT, PRIOR)
    assert (None if refusal is None else refusal.code) == code


def test_the_report_holds_every_method_and_no_other_file() -> None:
    found = assess_shelf(survey(said(UPRIGHTS, 0.3, 1.91), replace(said("lines", 0.1, 1.0), distance=float("nan"),
                                information=np.diag([1e5, 0.0]))))  # fmt: skip
    data, page = shown(found)
    assert [method["method"] for method in data["methods"]] == [UPRIGHTS, "lines"]
    assert data["methods"][1]["distance_m"] is None
    assert 'src="data:' in page
    assert "http://" not in page.replace("http://www.w3.org", "")


@pytest.mark.parametrize("refusal", [None, "sweep_flat", "sweep_at_edge", "sweep_ambiguous"])
def test_the_peaks_of_a_sweep_are_told(refusal: str | None) -> None:
    before = survey(said(UPRIGHTS, 0.3, 1.91))
    peaks = (Peak(2.01, 0.2), Peak(1.87, 0.17))
    after = replace(before, sweep=PlaneSweep(np.array([1.9, 2.0]), np.array([0.1, 0.2]), 900, peaks, refusal))
    assert codes(after) == (PASS, {refusal} - {None})
    data, page = shown(assess_shelf(after))
    assert data["shelf"] == shown(assess_shelf(before))[0]["shelf"]
    told = data["sweep"]
    assert [told["code"], told["distance_m"]] == ([None, 2.01] if refusal is None else [refusal, None])
    assert [peak["distance_m"] for peak in told["peaks"]] == [2.01, 1.87]
    assert "+100" in page
    assert "-40" in page


SAMPLE = Path(__file__).resolve().parents[3] / "palletloc" / "sample"
DATA = Path(__file__).resolve().parents[3].parent / "shared/data"
UPRIGHTS_M = {"dev_lab": 1.895, "dev_warehouse": 1.645}
"""World y of the uprights' front faces: where vertical edges of all shots cross at the true poses."""
needs_data = pytest.mark.skipif(not DATA.is_dir(), reason="the recordings are not there")


def copied(source: Path, place: Path, **shelf: object) -> Path:
    """Return a copy of a recording without its truth, with another shelf."""
    shutil.copytree(source, place, ignore=shutil.ignore_patterns("truth"))
    content = yaml.safe_load((place / RECORDING).read_text())
    content["shelf"] |= shelf
    (place / RECORDING).write_text(yaml.safe_dump(content))
    return place


def true_front(folder: Path) -> ShelfPlane:
    """Return the uprights' plane in odom, by the true pose at the first shot."""
    row = next(iter(read_rows(folder / "truth" / "forklift.csv", ("time_s", "x_m", "y_m", "z_m", "yaw_rad"))))
    first = LevelPose(row.number("x_m"), row.number("y_m"), 0.0, row.number("yaw_rad"))
    return ShelfPlane(0.0, UPRIGHTS_M[folder.name], -np.pi / 2).seen_from(first)


def test_only_the_shelf_changes_in_the_written_file() -> None:
    spec = read_document(SAMPLE / RECORDING, RecordingSpec)
    plane = ShelfPlane(1.23456, 2.0, float(np.radians(-91.23456)))
    written = yaml.safe_load(recording_text(spec, plane))
    before = yaml.safe_load((SAMPLE / RECORDING).read_text())
    assert written["shelf"]["point_m"] == [1.2346, 2.0]
    assert written["shelf"]["facing_deg"] == -91.235
    assert RecordingSpec.model_validate(written).model_copy(update={"shelf": spec.shelf}) == spec
    assert written["shelf"].get("levels_m") == before["shelf"].get("levels_m")


@pytest.mark.parametrize(("side", "turn"), [("left", np.pi / 2), ("right", -np.pi / 2)])
def test_a_side_and_a_distance_make_a_plane_along_the_way(side: str, turn: float) -> None:
    recording = read_recording(SAMPLE)
    plane = plane_beside(recording, side, 1.7)
    first, last = (recording.odometry.pose_at(shot.time) for shot in (recording.shots[0], recording.shots[-1]))
    heading = np.arctan2(last.y - first.y, last.x - first.x)
    assert abs(wrap_angle(plane.yaw - heading - turn)) < 0.3
    middle = recording.odometry.pose_at(recording.shots[len(recording.shots) // 2].time)
    x, y, _ = middle.transform().apply(recording.mounting.center)
    assert (plane.x - x) * np.cos(plane.yaw) + (plane.y - y) * np.sin(plane.yaw) == pytest.approx(1.7)


def test_a_wrong_side_or_distance_is_named() -> None:
    recording = read_recording(SAMPLE)
    with pytest.raises(PalletLocError, match="--side above: expected left or right"):
        plane_beside(recording, "above", 1.7)
    with pytest.raises(PalletLocError, match="--distance"):
        plane_beside(recording, "left", 0.1)


@pytest.mark.slow
def test_where_nothing_is_seen_the_run_is_degenerate_and_writes_no_plane(
    tmp_path: Path, calibrate: Calibrate
) -> None:
    away = read_recording(SAMPLE).shelf
    turned = {"facing_deg": float(np.degrees(away.facing)) + 180.0}
    place = copied(SAMPLE, tmp_path / "away", **turned)
    rows = (place / "shots.csv").read_text().splitlines()
    (place / "shots.csv").write_text("\n".join(rows[:2]) + "\n")  # one shot: nothing to triangulate
    out = tmp_path / "out.yaml"
    out.write_text("kept")
    ended = calibrate("shelf", place, "--out", out)
    assert ended.code in (1, 3)
    assert out.read_text() == "kept"
    report = json.loads((tmp_path / "out.failed.json").read_text())
    assert report["exit_code"] in (1, 3)
    assert "palletloc: " in ended.err


@pytest.mark.slow
@needs_data
@pytest.mark.parametrize("name", sorted(UPRIGHTS_M))
@pytest.mark.parametrize(("off", "turn_deg"), [(0.4, -9.0), (-0.45, 8.0)])
def test_the_front_of_a_recording_is_found_from_a_rough_guess(
    name: str, off: float, turn_deg: float, tmp_path: Path, calibrate: Calibrate
) -> None:
    recording = read_recording(DATA / name)
    rough = plane_beside(recording, "left", 1.75)
    point = (rough.x + off * np.cos(rough.yaw), rough.y + off * np.sin(rough.yaw))
    facing = float(np.degrees(rough.facing)) + turn_deg
    place = copied(DATA / name, tmp_path / name, point_m=[float(v) for v in point], facing_deg=facing)
    out = tmp_path / "found.yaml"
    assert calibrate("shelf", place, "--out", out).code == 0
    shutil.copy(out, place / RECORDING)
    found, truth = read_recording(place).shelf, true_front(DATA / name)
    camera = recording.mounting.center[:2] + np.array([1.0, 0.0])
    into = np.array([np.cos(truth.yaw), np.sin(truth.yaw)])
    depth = [
        float(
            (np.array([p.x, p.y]) - camera) @ (np.cos(p.yaw), np.sin(p.yaw)) / (into @ (np.cos(p.yaw), np.sin(p.yaw)))
        )
        for p in (found, truth)
    ]
    report = json.loads(out.with_suffix(".json").read_text())
    assert abs(depth[0] - depth[1]) < min(0.015, 2.5 * report["shelf"]["distance_sigma_m"])
    assert abs(np.degrees(wrap_angle(found.facing - truth.facing))) < 0.3
    assert report["sweep"]["peaks"]
    swept = [method for method in report["methods"] if method["method"] == "sweep"]
    assert len(swept) == (report["sweep"]["code"] is None)
    assert "data:image/png;base64," in out.with_suffix(".html").read_text()
