import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from palletloc.cli.app import run
from palletloc.io.recording import check_shelf, read_recording
from palletloc.io.truth import read_truth
from tests.palletloc.cli.sample_runs import SAMPLE, true_poses

Refused = Callable[..., str]
SHOT = 5


def initial_file(folder: Path, rows: list[str]) -> Path:
    path = folder / "initial.csv"
    path.write_text("\n".join(["time_s,model,x_m,y_m,z_m,yaw_rad", *rows]) + "\n")
    return path


def explain(out: Path, initial: Path, *options: str) -> int:
    return run(["explain", str(SAMPLE), "--shot", str(SHOT), "--out", str(out), "--initial", str(initial), *options])


def row_beside(pallet: str, shift: float) -> str:
    """Return a start near a true pallet of the sample's last shot, moved along x."""
    time = read_recording(SAMPLE).shots[SHOT].time
    pose = true_poses(SAMPLE, time)[pallet]
    return f"{time},t11-plastic,{pose.x + shift:.4f},{pose.y:.4f},{pose.z},{pose.yaw:.5f}"


@pytest.fixture(scope="module")
def from_start(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder that explains one given start, with files that were there before."""
    folder = tmp_path_factory.mktemp("from_start")
    for name in ("4-face-P9.png", "3-search-C9.png", "notes.txt", "4-face-P9.txt"):
        (folder / name).write_text("from before")
    initial = initial_file(folder, [row_beside("A", 0.02)])
    assert explain(folder, initial, "--method", "horizontal_plane") == 0
    return folder


@pytest.fixture(scope="module")
def numbers(from_start: Path) -> dict[str, Any]:
    document: dict[str, Any] = json.loads((from_start / "explain.json").read_text())
    return document


def test_the_pictures_of_all_stages_are_there_and_listed(from_start: Path, numbers: dict[str, Any]) -> None:
    made = sorted(path.name for path in from_start.iterdir() if path.suffix in (".png", ".jpg"))
    overlays = ["5-overlay-whole.jpg", "5-overlay.jpg"]
    assert made == ["2-yaw-P1.png", "3-position-P1.png", "4-face-P1.png", *overlays, "6-plan.png"]
    assert all(cv2.imread(str(from_start / name)) is not None for name in made)
    assert {picture["file"] for picture in numbers["pictures"]} == set(made)


def test_only_pictures_of_ours_are_replaced(from_start: Path) -> None:
    assert not (from_start / "4-face-P9.png").exists()
    assert not (from_start / "3-search-C9.png").exists()
    assert (from_start / "notes.txt").read_text() == "from before"
    assert (from_start / "4-face-P9.txt").exists()


def test_the_numbers_say_where_the_pallet_is_and_those_of_all_stages_agree(numbers: dict[str, Any]) -> None:
    (candidate,) = numbers["candidates"]
    assert numbers["pallets"] == 1
    truth = [float(cell) for cell in row_beside("A", 0.0).split(",")[2:]]
    measured = [candidate["pose"][key] for key in ("x_m", "y_m", "z_m", "yaw_rad")]
    assert measured[:3] == pytest.approx(truth[:3], abs=0.02)
    assert measured[3] == pytest.approx(truth[3], abs=np.radians(0.5))
    assert candidate["start"]["x_m"] - truth[0] == pytest.approx(0.02, abs=1e-3)
    sigma = [candidate["sigma"][key] for key in ("x_m", "y_m", "z_m", "yaw_rad")]
    assert np.sqrt(np.diag(candidate["covariance"])) == pytest.approx(sigma, rel=1e-5)
    assert len(candidate["sweep"]["depth_m"]) == len(candidate["sweep"]["score"])
    used = [vote for vote in candidate["yaw"]["votes"] if vote["used"]]
    assert candidate["yaw"]["sigma_rad"] < min(vote["sigma_rad"] for vote in used) * 1.5
    assert candidate["yaw"]["yaw_rad"] == pytest.approx(candidate["pose"]["yaw_rad"], abs=0.01)
    assert "refused" not in candidate


def test_detections_are_explained_with_the_shelf(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", "120")
    assert run(["explain", str(SAMPLE), "--shot", "0", "--out", str(tmp_path / "new" / "folder")]) == 0
    document = json.loads((tmp_path / "new" / "folder" / "explain.json").read_text())
    refused = [candidate for candidate in document["candidates"] if "refused" in candidate]
    printed = capsys.readouterr().out
    assert sum(line.split()[:1] in (["P1"], ["P2"], ["P3"]) for line in printed.splitlines()) == document["pallets"]
    assert document["pallets"] >= 1
    assert f"given up: {len(refused)} (" in printed
    assert all(set(candidate["refused"]) == {"stage", "reason"} for candidate in refused)
    assert (tmp_path / "new" / "folder" / "1-shelf.png").stat().st_size > 10_000


def test_the_usual_method_shows_its_hypotheses_and_edges(tmp_path: Path) -> None:
    initial = initial_file(tmp_path, [row_beside("A", 0.06)])
    out = tmp_path / "out"
    assert explain(out, initial) == 0
    made = {path.name for path in out.iterdir()}
    assert {"3-search-P1.png", "4-face-P1.png", "6-plan.png", "explain.json"} <= made
    (candidate,) = json.loads((out / "explain.json").read_text())["candidates"]
    best = candidate["search"]["peaks"][0]["pose"]
    assert best["y_m"] == pytest.approx(candidate["pose"]["y_m"], abs=0.05)
    assert "sweep" not in candidate


@pytest.mark.parametrize("shot", ["6", "-1", "100000"])
def test_a_shot_that_is_not_there_is_one_line(shot: str, tmp_path: Path, refused: Refused) -> None:
    told = refused("explain", SAMPLE, "--shot", shot, "--out", tmp_path / "out")
    assert told == f"--shot {shot}: {SAMPLE} has 6 shots; expected 0 to 5"
    assert not (tmp_path / "out").exists()


def test_a_folder_that_is_not_there_is_one_line(tmp_path: Path, refused: Refused) -> None:
    told = refused("explain", tmp_path / "no", "--shot", "0", "--out", tmp_path / "out")
    assert told.startswith(f"{tmp_path / 'no'}: no such folder")


def test_a_shot_that_no_start_is_for_is_one_line(tmp_path: Path, refused: Refused) -> None:
    initial = initial_file(tmp_path, [row_beside("A", 0.0)])
    told = refused("explain", SAMPLE, "--shot", "0", "--out", tmp_path / "out", "--initial", initial)
    assert told == "--shot 0: no start has the time of this shot, 0 s"


def test_a_damaged_image_is_one_line_and_leaves_nothing(tmp_path: Path, refused: Refused) -> None:
    copy = Path(shutil.copytree(SAMPLE, tmp_path / "copy"))
    image = copy / read_recording(copy).shots[0].file
    image.write_bytes(image.read_bytes()[:5000])
    assert str(image) in refused("explain", copy, "--shot", "0", "--out", tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_out_is_needed(tmp_path: Path) -> None:
    assert run(["explain", str(SAMPLE), "--shot", "0"]) == 2
    assert run(["explain", str(SAMPLE), "--shot", "first", "--out", str(tmp_path)]) == 2


FEW = ["--shots", "2", "--width", "128", "--level", "0"]


def simulate(folder: Path, *options: str) -> int:
    return run(["simulate", "--out", str(folder), *FEW, *options])


def contents(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


@pytest.mark.parametrize(
    ("camera", "side"),
    [("equirectangular", "left"), ("dual_fisheye", "right"), ("kannala_brandt", "left"), ("pinhole", "right")],
)
def test_what_it_writes_is_a_recording_with_truth(tmp_path: Path, camera: str, side: str) -> None:
    out = tmp_path / "approach"
    assert simulate(out, "--camera", camera, "--side", side, "--model", "t11-plastic", "--model", "epal1-800") == 0
    recording, truth = read_recording(out), read_truth(out)
    check_shelf(recording)
    assert [model.name for model in recording.models] == ["t11-plastic", "epal1-800"]
    assert len(recording.shots) == 2
    for shot in recording.shots:
        image = recording.image(shot)
        assert image.shape == (recording.camera.height, recording.camera.width, 3)
        assert image.std() > 10
    assert truth.forklift.times == pytest.approx([shot.time for shot in recording.shots])
    assert {pallet.model for pallet in truth.pallets} <= {"t11-plastic", "epal1-800"}
    sign = 1 if side == "left" else -1
    assert all(np.sign(pallet.world_from_pallet.y) == sign for pallet in truth.pallets)


def test_the_same_seed_writes_the_same_files(tmp_path: Path) -> None:
    for name, seed in (("a", "3"), ("b", "3"), ("c", "4")):
        assert simulate(tmp_path / name, "--seed", seed) == 0
    a, b, c = (contents(tmp_path / name) for name in "abc")
    assert a == b
    assert a.keys() == c.keys()
    assert all(a[name] != c[name] for name in a if name not in ("pallets.yaml",))


def test_a_folder_with_something_in_it_and_an_unknown_model_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "note.txt").write_text("mine")
    assert simulate(tmp_path) == 1
    assert str(tmp_path) in capsys.readouterr().err
    assert simulate(tmp_path / "x", "--model", "epal1-1201") == 1
    assert "epal1-1200" in capsys.readouterr().err
    assert contents(tmp_path) == {"note.txt": b"mine"}


@pytest.mark.parametrize("option", [["--shots", "0"], ["--light", "moon"], ["--camera", "drone"]])
def test_wrong_usage(tmp_path: Path, option: list[str]) -> None:
    assert simulate(tmp_path / "x", *option) == 2
