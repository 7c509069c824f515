import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import yaml

from calibration.shelf.assessment import plane_beside
from calibration.shelf.report import recording_text
from palletloc.__main__ import COMMANDS
from palletloc.cli.app import run
from palletloc.errors import PalletLocError
from palletloc.geometry import LevelPose, wrap_angle
from palletloc.io.csv_table import read_rows
from palletloc.io.recording import RECORDING, read_recording
from palletloc.io.schema import RecordingSpec
from palletloc.io.yaml_document import read_document
from palletloc.shelf import ShelfPlane

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


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (["--out", "plane.txt"], 1, ".yaml"),
        (["--out", "plane.yaml", "--side", "left"], 2, "go together"),
        (["--out", "plane.yaml", "--front", "beams"], 2, "expected uprights or pallets"),
        ([], 2, "--out"),
    ],
)
def test_wrong_usage_is_told(arguments: list[str], code: int, words: str, capfd: pytest.CaptureFixture[str]) -> None:
    assert run(["calibrate", "shelf", str(SAMPLE), *arguments], COMMANDS) == code
    assert words in capfd.readouterr().err


def test_a_missing_recording_is_one_line(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    assert run(["calibrate", "shelf", str(tmp_path / "no"), "--out", str(tmp_path / "o.yaml")], COMMANDS) == 1
    assert capfd.readouterr().err.count("\n") == 1
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_where_nothing_is_seen_the_run_is_degenerate_and_writes_no_plane(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    away = read_recording(SAMPLE).shelf
    turned = {"facing_deg": float(np.degrees(away.facing)) + 180.0}
    place = copied(SAMPLE, tmp_path / "away", **turned)
    rows = (place / "shots.csv").read_text().splitlines()
    (place / "shots.csv").write_text("\n".join(rows[:2]) + "\n")  # one shot: nothing to triangulate
    out = tmp_path / "out.yaml"
    out.write_text("kept")
    assert run(["calibrate", "shelf", str(place), "--out", str(out)], COMMANDS) in (1, 3)
    assert out.read_text() == "kept"
    report = json.loads((tmp_path / "out.failed.json").read_text())
    assert report["exit_code"] in (1, 3)
    assert "palletloc: " in capfd.readouterr().err


@pytest.mark.slow
@needs_data
@pytest.mark.parametrize("name", sorted(UPRIGHTS_M))
@pytest.mark.parametrize(("off", "turn_deg"), [(0.4, -9.0), (-0.45, 8.0)])
def test_the_front_of_a_recording_is_found_from_a_rough_guess(
    name: str, off: float, turn_deg: float, tmp_path: Path
) -> None:
    recording = read_recording(DATA / name)
    rough = plane_beside(recording, "left", 1.75)
    point = (rough.x + off * np.cos(rough.yaw), rough.y + off * np.sin(rough.yaw))
    facing = float(np.degrees(rough.facing)) + turn_deg
    place = copied(DATA / name, tmp_path / name, point_m=[float(v) for v in point], facing_deg=facing)
    out = tmp_path / "found.yaml"
    assert run(["calibrate", "shelf", str(place), "--out", str(out)], COMMANDS) == 0
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
