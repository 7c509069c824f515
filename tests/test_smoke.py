"""Whether an installation works: short ways through all three packages, each to its end."""

import json
import shutil
from importlib.resources import files
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

from palletloc.__main__ import COMMANDS
from palletloc.cameras import KannalaBrandt
from palletloc.cli.app import run

SAMPLE = Path(str(files("palletloc") / "sample"))
LENS = KannalaBrandt(480, 400, 140.0, 140.5, 243.0, 198.0, 0.03, -0.012, 0.002, -0.0002, 1.6)


def program(*arguments: object) -> None:
    assert run([str(argument) for argument in arguments], COMMANDS) == 0


def test_a_shot_is_explained_with_pictures(tmp_path: Path) -> None:
    program("explain", SAMPLE, "--shot", 0, "--out", tmp_path)
    assert json.loads((tmp_path / "explain.json").read_text())
    pictures = list(tmp_path.glob("*.png"))
    assert pictures
    assert all(cv2.imread(str(picture)) is not None for picture in pictures)


def test_a_recording_is_simulated_and_tracked(tmp_path: Path) -> None:
    program("simulate", "--out", tmp_path / "scene", "--width", 960, "--shots", 2)
    program("track", tmp_path / "scene", "--out", tmp_path / "run")
    assert (tmp_path / "run" / "tracks.csv").is_file()


def test_recordings_are_evaluated_by_workers(tmp_path: Path) -> None:
    pytest.importorskip("distributed")
    program("track", SAMPLE, "--out", tmp_path / "run")
    for name in ("a", "b"):
        shutil.copytree(SAMPLE, tmp_path / "all" / name, ignore=shutil.ignore_patterns("images"))
        shutil.copytree(tmp_path / "run", tmp_path / "all" / name / "run")
    program(
        *("evaluate", "--batch", tmp_path / "all", "--estimate", "run", "--workers", 2), *("--out", tmp_path / "out")
    )
    assert (tmp_path / "out" / "batch.json").is_file()


def test_a_lens_is_calibrated_and_converted(tmp_path: Path) -> None:
    lines, rng = ["shot,board,lens,x_m,y_m,z_m,u_px,v_px"], np.random.default_rng(0)
    board = np.array([[x, y, 0.0] for x in np.arange(6) * 0.05 for y in np.arange(5) * 0.05])
    for shot in range(8):
        aim = Rotation.from_euler("zyx", [0.9 * np.cos(2.4 * shot), 0.6 * np.sin(2.4 * shot), rng.normal(0, 0.3)])
        tilt = Rotation.from_euler("yz", rng.normal(0, 0.35, 2))
        points = aim.apply(tilt.apply((board - board.mean(axis=0))[:, [2, 0, 1]]) + np.array([0.4, 0.0, 0.0]))
        pixels, valid = LENS.project(points)
        corners = np.hstack([board, pixels])[valid].round(4).tolist()
        lines += [f"s{shot},A,0," + ",".join(map(str, corner)) for corner in corners]
    (tmp_path / "corners.csv").write_text("\n".join(lines) + "\n")
    task = {"format": 1, "width": LENS.width, "height": LENS.height, "corners": "corners.csv"}
    (tmp_path / "intrinsics.yaml").write_text(yaml.safe_dump(task))
    found = tmp_path / "camera.yaml"
    program("calibrate", "intrinsics", tmp_path, "--model", "kannala_brandt", "--out", found)
    assert yaml.safe_load(found.read_text())["camera"]["focal_px"] == pytest.approx([140.0, 140.5], abs=0.1)
    program("calibrate", "convert", found, "--to", "opencv", "--out", tmp_path / "camera.xml")
    assert (tmp_path / "camera.xml").is_file()


def test_what_is_no_yaml_is_refused_with_file_and_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "recording.yaml").write_text("format: 1\ncamera: {width: [}\n")
    assert run(["track", str(tmp_path), "--out", str(tmp_path / "run")], COMMANDS) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"palletloc: {tmp_path / 'recording.yaml'}, line 2: is not yaml: ")
