import re
from pathlib import Path

import pytest

import palletloc.report.worst_shots
from palletloc.choices import Method
from palletloc.cli.app import run
from palletloc.io.measurements import NoPose, read_measurements, write_measurements
from palletloc.measurement import PalletMeasurement
from palletloc.report.worst_shots import run_method
from tests.palletloc.cli.sample_runs import SAMPLE, evaluate


@pytest.fixture(autouse=True)
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
