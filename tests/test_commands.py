"""Every command, found by walking the program: help with examples, one JSON document, and silence."""

import json
import os
import re
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import typer
import yaml

from palletloc.__main__ import COMMANDS
from palletloc.cli.app import run
from palletloc.cli.showing import Shown, shows
from palletloc.geometry import LevelPose
from palletloc.io.measurements import write_measurements
from palletloc.measurement import PalletMeasurement, YawSource
from palletloc.pallet_library import load_library
from palletloc.synthetic.simulation import Simulation
from tests.palletloc.cli.sample_runs import without_images, write_run

RECORDING = """\
format: 1
camera: {model: equirectangular, width: 64, height: 32}
forklift_from_camera: {translation_m: [0.3, -0.1, 1.8], roll_pitch_yaw_deg: [0, 0, 0]}
shelf: {point_m: [3.0, 2.0], facing_deg: -90.0, levels_m: [0.0]}
pallets: [t11-plastic]
"""
ODOMETRY = "time_s,x_m,y_m,yaw_rad,speed_mps,yaw_rate_radps\n0,0,0,0,0.4,0\n1,0.4,0,0,0.4,0\n2,0.8,0,0,0.4,0\n"


def paths() -> Iterator[tuple[str, ...]]:
    """Yield the words that call each command and each group of commands."""
    yield ()
    for command in COMMANDS:
        yield (command.name,)
        loaded = command.load()
        if isinstance(loaded, typer.Typer):
            yield from ((command.name, name) for name in typer.main.get_group(loaded).commands)


LEAVES = [words for words in paths() if words and words != ("calibrate",)]
"""The commands that do something."""


@pytest.mark.parametrize("words", list(paths()), ids="-".join)
def test_every_help_has_examples_and_flags_without_a_type(
    words: tuple[str, ...], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    assert run([*words, "--help"], COMMANDS) == 0
    shown = capsys.readouterr().out
    assert "bool" not in shown
    _, _, examples = shown.partition("Examples:")
    lines = [line.strip() for line in examples.splitlines() if line.strip()]
    assert lines
    assert all(line.startswith(" ".join(("palletloc", *words))) for line in lines)
    if words in LEAVES:
        assert re.search(r"--json\s+Print", shown)
        assert re.search(r"--quiet\s+-q\s+Print", shown)


@pytest.mark.parametrize("width", [40, 60, 80])
def test_no_help_cuts_an_option(
    width: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", str(width))
    for words in LEAVES:
        assert run([*words, "--help"], COMMANDS) == 0
        shown = capsys.readouterr().out
        assert "\N{HORIZONTAL ELLIPSIS}" not in shown, words
        assert {"--help", "--json", "--quiet"} <= set(shown.split())


@pytest.mark.parametrize("words", LEAVES, ids="-".join)
def test_every_example_names_options_that_the_command_has(
    words: tuple[str, ...], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    run([*words, "--help"], COMMANDS)
    shown, _, examples = capsys.readouterr().out.partition("Examples:")
    assert set(re.findall(r"--[a-z][\w-]*", examples)) <= set(re.findall(r"--[a-z][\w-]*", shown))


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Work beside recordings, one of gray images and one with truth, and what else commands read; draw nothing."""
    import cv2

    monkeypatch.chdir(tmp_path)
    Path("approach/images").mkdir(parents=True)
    shots = "time_s,file\n" + "".join(f"{0.5 * n},images/{n}.png\n" for n in range(4))
    for name, text in {"recording.yaml": RECORDING, "shots.csv": shots, "odometry.csv": ODOMETRY}.items():
        Path("approach", name).write_text(text)
    for number in range(4):
        cv2.imwrite(f"approach/images/{number}.png", np.full((32, 64, 3), 100 + number, np.uint8))
    rows = [
        PalletMeasurement(
            0.5 * n, "t11-plastic", LevelPose(3 - 0.2 * n, 2, 0, 1.5), 1e-4 * np.eye(4), 0.9, YawSource.FACE
        )
        for n in range(4)
    ]
    write_measurements(Path("m.csv"), rows)
    without_images(Path("sample"))
    write_run(Path("measured"))
    monkeypatch.setattr("palletloc.report.evaluation_page.evaluation_page", lambda *_, **__: "")
    monkeypatch.setattr("tracking.cli._picture", lambda *_: b"")
    monkeypatch.setattr("tracking.demo._report", lambda *_: None)
    monkeypatch.setattr("palletloc.report.explanation_folder.stage_pictures", lambda *_, **__: ())
    blank = np.zeros((32, 64, 3), np.uint8)
    monkeypatch.setattr(Simulation, "images", lambda simulation: (blank for _ in simulation.times))
    fisheye = {"model": "kannala_brandt", "width": 640, "height": 480, "focal_px": [200.0, 200.0]}
    fisheye |= {"center_px": [320.0, 240.0], "distortion": [0.01, 0.0, 0.0, 0.0], "max_angle_deg": 80.0}
    Path("camera.yaml").write_text(yaml.safe_dump({"camera": fisheye}))
    return tmp_path


RUNS = {
    "localize": "localize approach --out {out}",
    "track": "track approach --measurements m.csv --out {out}",
    "evaluate": "evaluate sample --estimate measured --out {out}",
    "explain": "explain approach --shot 1 --out {out}",
    "simulate": "simulate --out {out} --shots 1 --width 64",
    "pallets": "pallets",
    "config": "config",
    "board": "calibrate board --out {out}.pdf",
    "convert": "calibrate convert camera.yaml --to ros --out {out}.yaml",
}
"""A short successful call of each kind of command; the calibrations with pages share theirs."""
SAID: dict[str, Callable[[dict[str, Any]], Any]] = {
    "localize": lambda document: document["shots"]["done"],
    "track": lambda document: document["tracks"][0]["hits"],
    "evaluate": lambda document: document["runs"][0]["name"],
    "explain": lambda document: document["pallets"],
    "simulate": lambda document: document["image"][0],
    "pallets": lambda document: sorted(document["pallets"]),
    "config": lambda document: document["tracker"]["life"]["confirm_hits"],
    "board": lambda document: document["written"][0],
    "convert": lambda document: document["cameras"][0]["lost"],
}
"""One thing that each document has to say."""
TRUE = {
    "localize": 4,
    "track": 4,
    "evaluate": "measured",
    "explain": 0,
    "simulate": 64,
    "pallets": sorted(load_library()),
    "config": 3,
    "board": "json.pdf",
    "convert": 0.0,
}


@pytest.mark.parametrize("name", RUNS)
@pytest.mark.usefixtures("here")
def test_json_is_one_document_with_what_the_table_says_and_quiet_prints_nothing(
    name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    line = RUNS[name]
    assert run([*line.format(out="json").split(), "--json"], COMMANDS) == 0
    printed = capsys.readouterr()
    document = json.loads(printed.out)
    assert SAID[name](document) == TRUE[name]
    assert printed.err == ""
    assert run([*line.format(out="quiet").split(), "--quiet"], COMMANDS) == 0
    assert capsys.readouterr() == ("", "")
    assert run(line.format(out="table").split(), COMMANDS) == 0
    assert capsys.readouterr().out


@pytest.mark.usefixtures("here")
@pytest.mark.parametrize("option", ["--json", "--quiet"])
@pytest.mark.parametrize(
    "line",
    [
        "localize nowhere --out out",
        "track nowhere --out out",
        "evaluate nowhere --estimate measured --out out",
        "explain approach --shot 9 --out out",
        "pallets no-such-model",
        "config --file nowhere.yaml",
        "calibrate plan nowhere.yaml",
        "calibrate board --out board.png",
        "calibrate check nowhere",
    ],
)
def test_an_error_is_one_line_on_standard_error_all_the_same(
    line: str, option: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run([*line.split(), option], COMMANDS) == 1
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.startswith("palletloc: ")
    assert printed.err.count("\n") == 1


@pytest.mark.parametrize(("option", "out", "err"), [("", 2, 1), ("--json", 1, 1), ("--quiet", 0, 1)])
def test_a_result_that_fails_says_why_and_keeps_its_exit_code(
    option: str, out: int, err: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    @shows
    def plan(layout: str = "") -> Shown:  # noqa: ARG001 - as the command has it
        """Predict."""
        return Shown({"size": float("nan"), "exit_code": 3}, ("one", "two"), ("fail: far_too_wide: mend it",), 3)

    app = typer.Typer()
    app.command("plan")(plan)
    app.command("other")(plan)
    monkeypatch.setattr("calibration.cli.app", app)
    assert run(["calibrate", "plan", *option.split()], COMMANDS) == 3
    printed = capsys.readouterr()
    assert (bool(printed.out), printed.err.count("\n")) == (bool(out), err)
    if option == "--json":
        assert json.loads(printed.out) == {"size": None, "exit_code": 3}
    elif out:
        assert printed.out.splitlines() == ["one", "two"]


@pytest.mark.parametrize("width", range(40, 121, 10))
@pytest.mark.usefixtures("here")
def test_tables_lose_no_name_at_any_width(
    width: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", str(width))
    name = "a-run-whose-name-is-very-long-indeed"
    write_run(Path(name))
    for line in (
        "track approach --measurements m.csv --out out",
        f"evaluate sample --estimate measured --estimate {name} --out out",
        "pallets",
    ):
        assert run(line.split(), COMMANDS) == 0
    words = set(capsys.readouterr().out.split())
    assert words >= {"t11-plastic", "confirmed", "measured", name, "measurements", *load_library()}


@pytest.mark.parametrize(
    ("typed", "expected"),
    [
        ("palletloc lo", {"localize"}),
        ("palletloc localize --me", {"--method"}),
        ("palletloc calibrate int", {"intrinsics"}),
        ("palletloc explain --no", {"--no-refused"}),
    ],
)
def test_the_shell_completes_commands_and_options(
    typed: str, expected: set[str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("_PALLETLOC_COMPLETE", "complete_bash")
    monkeypatch.setenv("COMP_WORDS", typed)
    monkeypatch.setenv("COMP_CWORD", str(len(typed.split()) - 1))
    run([], COMMANDS)
    assert set(capsys.readouterr().out.split()) == expected


@pytest.mark.parametrize("encoding", ["ascii", "latin-1"])
def test_a_terminal_that_cannot_show_a_sign_stops_nothing(encoding: str) -> None:
    command = [sys.executable, "-m", "palletloc", "pallets", "epal1-800"]
    root = Path(__file__).resolve().parents[1]
    environment = {**os.environ, "PYTHONIOENCODING": encoding}
    ended = subprocess.run(command, capture_output=True, check=True, cwd=root, env=environment)
    assert b"epal1-800" in ended.stdout
    assert ended.stderr == b""
