"""Several shots while the forklift stands: accuracy and repeatability in the terms of ISO 9283."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from palletloc.geometry import FloatArray, LevelPose, level_pose
from palletloc.io.measurements import write_measurements
from palletloc.io.truth import read_truth
from palletloc.measurement import PalletMeasurement, YawSource
from tests.palletloc.cli.sample_runs import SAMPLE, evaluate, read_metrics, true_poses, without_images, write_survey

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
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
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
def evaluated(tmp_path_factory: pytest.TempPathFactory, recording: Path, estimate: Path) -> Path:
    """Return the results with every shot of a stop as a repetition."""
    out = tmp_path_factory.mktemp("results")
    assert evaluate(recording, out, "--estimate", estimate, "--no-pictures", "--stop-limit", "0.6") == 0
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
def test_the_limit_says_which_shots_belong_to_a_stop(tmp_path: Path, recording: Path, estimate: Path) -> None:
    assert evaluate(recording, tmp_path / "out", "--estimate", estimate, "--stop-limit", "0.11") == 0
    assert {stop["n"] for stop in stops_of(tmp_path / "out")} == {2}
    assert evaluate(recording, tmp_path / "none", "--estimate", estimate, "--stop-limit", "0.05") == 1
    assert not (tmp_path / "none").exists()
