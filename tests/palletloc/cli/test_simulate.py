from pathlib import Path

import numpy as np
import pytest

from palletloc.cli.app import run
from palletloc.io.recording import check_shelf, read_recording
from palletloc.io.truth import read_truth

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
