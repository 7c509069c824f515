import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import palletloc.report.evaluation_page
from palletloc.cli.app import run
from tests.palletloc.cli.sample_runs import without_images

STARTS = """\
time_s,model,x_m,y_m,z_m,yaw_rad
1.0,t11,3,2,0,1.5
1.0,t11,4,2,0,1.5
0.0,t11,2.5,2,0,1.5
"""


@pytest.fixture
def here(blank_recording: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Work beside a recording called approach and starts in it called initial.csv."""
    monkeypatch.chdir(blank_recording.parent)
    Path("initial.csv").write_text(STARTS)
    return blank_recording.parent


@pytest.fixture
def localize(here: Path) -> Callable[..., int]:  # noqa: ARG001 - the place to work in
    """Return a function that localizes the recording into the folder out, and returns the exit code."""
    return lambda *options: run(["localize", "approach", "--out", "out", *options])


@pytest.fixture
def refused(capsys: pytest.CaptureFixture[str]) -> Callable[..., str]:
    """Return a function that runs what has to end with code 1 and one line, and returns that line."""

    def told(*arguments: str | Path) -> str:
        capsys.readouterr()
        code = run([str(argument) for argument in arguments])
        printed = capsys.readouterr()
        assert (code, printed.out, printed.err.count("\n")) == (1, "", 1), printed
        assert printed.err.startswith("palletloc: ")
        return printed.err[len("palletloc: ") : -1]

    return told


@pytest.fixture
def undrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave the page of an evaluation empty: it takes most of the time and has tests of its own."""
    monkeypatch.setattr(palletloc.report.evaluation_page, "evaluation_page", lambda *_, **__: "")


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    """Return a copy of the sample without its images."""
    return without_images(tmp_path / "recording")


@pytest.fixture
def contents() -> Callable[[], dict[str, str]]:
    """Return a function that reads all files of the folder out; pictures lie in folders below it."""
    return lambda: {path.name: path.read_text() for path in sorted(Path("out").iterdir()) if path.is_file()}


@pytest.fixture
def status() -> Callable[[], dict[str, Any]]:
    """Return a function that reads the status of the run in the folder out."""
    return lambda: dict(json.loads(Path("out/run.json").read_text()))
