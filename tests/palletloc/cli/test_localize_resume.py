from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from palletloc.geometry import Image
from palletloc.io.recording import Recording, ShotFile
from palletloc.recording_run import Job

Localize = Callable[..., int]
Contents = Callable[[], dict[str, str]]
Status = Callable[[], dict[str, Any]]

NAMES = ["measurements.csv", "refusals.csv", "run.json"]


def stops_at(number: int, kind: type[BaseException]) -> Callable[[Recording, ShotFile], Image]:
    """Return a reader of images that raises an exception at one shot."""
    read = Recording.image

    def image(recording: Recording, shot: ShotFile) -> Image:
        if shot.file == f"images/{number}.png":
            raise kind
        return read(recording, shot)

    return image


def test_after_a_strict_stop_a_mended_recording_can_be_resumed(
    localize: Localize, status: Status, capsys: pytest.CaptureFixture[str]
) -> None:
    good = Path("approach/images/2.png").read_bytes()
    Path("approach/images/2.png").write_bytes(b"")
    assert localize("--strict") == 1
    assert not Path("out/measurements.csv").exists()
    Path("approach/images/2.png").write_bytes(good)
    capsys.readouterr()
    assert localize("--strict", "--resume", "--verbose") == 0
    assert [line.split(":")[1] for line in capsys.readouterr().err.splitlines()] == [" images/2.png", " images/3.png"]
    assert status()["done"] == 4


@pytest.mark.parametrize("initial", [[], ["--initial", "initial.csv"]])
def test_an_interrupt_keeps_what_is_finished_and_resume_goes_on(
    localize: Localize,
    contents: Contents,
    status: Status,
    initial: list[str],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    shots = 2 if initial else 4
    assert localize(*initial) == 0
    whole = contents()
    with monkeypatch.context() as patch:
        patch.setattr(Recording, "image", stops_at(0 if initial else 3, KeyboardInterrupt))
        assert localize(*initial) == 130
    printed = capsys.readouterr().err.splitlines()
    kept = f"palletloc: {shots - 1} of {shots} shots are kept in out; --resume goes on"
    assert [line for line in printed if line] == [kept, "palletloc: interrupted"]
    assert status()["complete"] is False
    assert contents()["measurements.csv"].count("\n") == (3 if initial else 1)
    assert localize(*initial, "--resume") == 0
    assert contents() == whole
    printed_rows = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert ["shots", "done", str(shots)] in printed_rows
    assert ["of", "them", "before;", "not", "counted", "below", str(shots - 1)] in printed_rows


def test_an_interrupt_before_anything_is_finished_leaves_nothing(
    localize: Localize, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(Recording, "image", stops_at(0, KeyboardInterrupt))
    assert localize() == 130
    assert capsys.readouterr().err.strip() == "palletloc: interrupted"
    assert not Path("out").exists()


def test_a_fault_of_the_program_leaves_earlier_results_alone(
    localize: Localize, contents: Contents, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert localize() == 0
    whole = contents()
    with monkeypatch.context() as patch:
        patch.setattr(Recording, "image", stops_at(2, ZeroDivisionError))
        with pytest.raises(ZeroDivisionError):
            localize("--method", "paper")
    assert {name: text for name, text in contents().items() if name in NAMES} == whole


def test_a_finished_run_is_not_done_again(
    localize: Localize, contents: Contents, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert localize() == 0
    whole = contents()
    monkeypatch.setattr(Job, "explain", lambda *_: pytest.fail("was done again"))
    assert localize("--resume") == 0
    assert contents() == whole
    assert "pallets" not in capsys.readouterr().out.rpartition("of them before")[2]


@pytest.mark.parametrize(
    ("options", "what"),
    [
        (["--method", "paper"], "method"),
        (["--config", "mine.yaml"], "configuration"),
        (["--initial", "initial.csv"], "starts"),
    ],
)
def test_another_run_is_not_resumed(
    localize: Localize, contents: Contents, options: list[str], what: str, capsys: pytest.CaptureFixture[str]
) -> None:
    Path("mine.yaml").write_text("detection: {max_range: 2}\n")
    assert localize() == 0
    whole = contents()
    capsys.readouterr()
    assert localize("--resume", *options) == 1
    printed = capsys.readouterr()
    assert printed.err.startswith(f"palletloc: out: cannot resume: the run there had the {what} ")
    assert printed.err.count("\n") == 1
    assert contents() == whole


def test_parameters_that_change_nothing_are_the_same_run(localize: Localize) -> None:
    assert localize() == 0
    Path("all.yaml").write_text("detection: {}\n")
    assert localize("--resume", "--config", "all.yaml") == 0
