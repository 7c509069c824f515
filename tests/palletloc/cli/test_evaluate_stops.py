"""Several shots while the forklift stands: accuracy and repeatability in the terms of ISO 9283."""

from __future__ import annotations

import json
import shutil
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from palletloc.cli.app import run
from palletloc.geometry import FloatArray, LevelPose, level_pose
from palletloc.io.measurements import write_measurements
from palletloc.io.truth import read_truth
from palletloc.measurement import PalletMeasurement, YawSource

SAMPLE = Path(str(files("palletloc") / "sample"))
STOPS = {"S1": 2.694737, "S2": 5.389474}
REPEATS, BETWEEN = 6, 0.2
BIAS = np.array([0.004, -0.002, 0.001, 0.003])
SCATTER = np.array([0.002, 0.003, 0.0005, 0.002])
SITE = LevelPose(410.0, 187.0, 11.6, 0.62)
LIFT = {"V1": [-0.9, 0.45, 2.1], "V2": [-0.9, -0.45, 2.08], "V3": [0.55, -0.4, 1.2]}
FACE = {"LL": [0.0, 0.55, 0.012], "LR": [0.0, -0.55, 0.012], "UL": [0.0, 0.55, 0.132]}


def times_at(stop: str) -> list[float]:
    return [round(STOPS[stop] + BETWEEN * (number - (REPEATS - 1) / 2), 6) for number in range(REPEATS)]


def errors_at(stop: str, pallet: str) -> FloatArray:
    """Return (n, 4) errors of depth, along, height and yaw: the same ones whenever they are asked for."""
    rng = np.random.default_rng([list(STOPS).index(stop), ord(pallet)])
    return BIAS + SCATTER * rng.standard_normal((REPEATS, 4))


def standing() -> dict[str, LevelPose]:
    path = read_truth(SAMPLE).forklift
    return {name: path.pose_at(time) for name, time in STOPS.items()}


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    """Return a recording whose forklift stands twice, surveyed there and nowhere else."""
    folder = tmp_path / "recording"
    shutil.copytree(SAMPLE, folder, ignore=shutil.ignore_patterns("images", "forklift.csv"))
    times = [time for stop in STOPS for time in times_at(stop)]
    shots = [f"{time},images/{number:06}.jpg" for number, time in enumerate(times)]
    (folder / "shots.csv").write_text("\n".join(["time_s,file", *shots]) + "\n")
    bodies: dict[str, dict[str, list[float]]] = {"forklift": LIFT}
    points: dict[str, FloatArray] = {}
    for name, pose in standing().items():
        placed = (SITE.transform() * pose.transform()).apply(list(LIFT.values()))
        points |= dict(zip((f"{target}-{name}" for target in LIFT), placed, strict=True))
    for pallet in read_truth(SAMPLE).pallets:
        bodies[pallet.id] = {f"{pallet.id}-{target}": place for target, place in FACE.items()}
        placed = (SITE.transform() * pallet.world_from_pallet.transform()).apply(list(FACE.values()))
        points |= dict(zip(bodies[pallet.id], placed, strict=True))
    lines = [f"{name},{x:.6f},{y:.6f},{z:.6f}" for name, (x, y, z) in points.items()]
    (folder / "truth" / "survey.csv").write_text("\n".join(["name,x_m,y_m,z_m", *lines]) + "\n")
    stops = [{"name": name, "time_s": time} for name, time in STOPS.items()]
    plan = {"file": "survey.csv", "sigma_m": 0.0006, "stops": stops, "bodies": bodies}
    (folder / "truth" / "survey.yaml").write_text(yaml.safe_dump(plan))
    return folder


@pytest.fixture
def estimate(tmp_path: Path) -> Path:
    rows = []
    for stop, forklift in standing().items():
        for pallet in read_truth(SAMPLE).pallets:
            true = forklift.transform().inv() * pallet.world_from_pallet.transform()
            for time, error in zip(times_at(stop), errors_at(stop, pallet.id), strict=True):
                pose = level_pose(true * LevelPose(*error).transform())
                covariance = np.diag(SCATTER**2)
                rows.append(PalletMeasurement(time, pallet.model, pose, covariance, 0.9, YawSource.FACE, "a.jpg"))
    folder = tmp_path / "run"
    folder.mkdir()
    write_measurements(folder / "measurements.csv", rows)
    return folder


def stops_of(out: Path) -> list[Any]:
    document = json.loads((out / "metrics.json").read_text(encoding="utf-8"))
    return list(document["runs"][0]["sources"]["measurements"]["stops"])


def evaluate(recording: Path, estimate: Path, out: Path, *options: str) -> int:
    return run(
        ["evaluate", str(recording), "--estimate", str(estimate), "--out", str(out), "--no-pictures", *options]
    )


def test_every_shot_of_a_stop_is_a_repetition(tmp_path: Path, recording: Path, estimate: Path) -> None:
    assert evaluate(recording, estimate, tmp_path / "out", "--stop-limit", "0.6") == 0
    found = stops_of(tmp_path / "out")
    assert len(found) >= 4
    for one in found:
        errors = errors_at(one["stop"], one["pallet"])
        middle = errors.mean(axis=0)
        away = np.sqrt(((errors[:, :3] - middle[:3]) ** 2).sum(axis=1))
        deviation = np.sqrt(((away - away.mean()) ** 2).sum() / (REPEATS - 1))
        turned = np.sqrt(((errors[:, 3] - middle[3]) ** 2).sum() / (REPEATS - 1))
        assert one["n"] == REPEATS
        assert one["ap_m"] == pytest.approx(np.sqrt((middle[:3] ** 2).sum()), abs=3e-5)
        assert one["rp_m"] == pytest.approx(away.mean() + 3 * deviation, abs=1e-5)
        assert one["ap_yaw_deg"] == pytest.approx(np.degrees(middle[3]), abs=3e-3)
        assert one["rp_yaw_deg"] == pytest.approx(np.degrees(3 * turned), abs=1e-3)


def test_the_report_has_a_row_for_each_stop_with_its_repeatability(
    tmp_path: Path, recording: Path, estimate: Path
) -> None:
    assert evaluate(recording, estimate, tmp_path / "out", "--stop-limit", "0.6") == 0
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    for one in stops_of(tmp_path / "out"):
        cells = [one["stop"], one["pallet"], str(REPEATS), f"{1000 * one['ap_m']:.1f}", f"{1000 * one['rp_m']:.1f}"]
        row = "".join(f'<td class="text">{cell}</td>' for cell in cells[:2])
        assert row + "".join(f"<td>{cell}</td>" for cell in cells[2:]) in page


def test_the_limit_says_which_shots_belong_to_a_stop(tmp_path: Path, recording: Path, estimate: Path) -> None:
    assert evaluate(recording, estimate, tmp_path / "out", "--stop-limit", "0.11") == 0
    assert {one["n"] for one in stops_of(tmp_path / "out")} == {2}
    assert evaluate(recording, estimate, tmp_path / "none", "--stop-limit", "0.05") == 1
    assert not (tmp_path / "none").exists()
