import json
from collections.abc import Sequence
from contextlib import nullcontext
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from palletloc.geometry import LevelPose
from palletloc.io.atomic import JournalError, OutputError
from palletloc.io.measurements import NoPose, read_measurements, read_refusals
from palletloc.io.recording import ShotFile, read_recording
from palletloc.io.run_folder import JOURNAL, ResumeError, Run, RunFolder
from palletloc.measurement import PalletMeasurement, Reason, RefusedCandidate, Stage, YawSource

SHOTS = tuple(ShotFile(0.5 * number, f"images/{number}.jpg") for number in range(5))
RUN = Run(recording="0123", method="paper", configuration="4567", starts="", version="1.0")
SOURCE = Path("approach")
NAMES = ["measurements.csv", "refusals.csv", "run.json"]


def rows_of(shot: ShotFile) -> list[PalletMeasurement | NoPose]:
    """Return rows that depend on the shot alone, as a localizer's do."""
    covariance = np.diag([1e-6, 2e-6, 3e-6, 4e-6]) * (1 + shot.time)
    pose = LevelPose(shot.time, 2.0, 0.0, 0.1)
    pallet = PalletMeasurement(shot.time, "t11", pose, covariance, 0.5, YawSource.TOP, shot.file)
    return [pallet, NoPose(shot.time, "epal", shot.file)] if shot.time >= 1 else [pallet]


def work(
    folder: Path,
    *,
    run: Run = RUN,
    shots: Sequence[ShotFile] = SHOTS,
    resume: bool = False,
    fail_at: int | None = None,
    kind: type[BaseException] = KeyboardInterrupt,
    unreadable: Sequence[int] = (),
) -> list[int]:
    """Run to the end or to where it fails, and return which shots were worked on."""
    worked = []
    with RunFolder(folder, run, SOURCE, shots, resume=resume) as output:
        for number, shot in output.remaining():
            if number == fail_at:
                raise kind
            worked.append(number)
            if number in unreadable:
                output.skip(number, f"{shot.file}: is truncated")
            else:
                refusal = RefusedCandidate(shot.time, "t11", Stage.YAW, Reason.NO_LINE, shot.file)
                output.add(number, rows_of(shot), [refusal] * (number % 2))
    return worked


def files(folder: Path) -> dict[str, str]:
    return {path.name: path.read_text() for path in folder.iterdir()}


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """Return the files of a run without interruption."""
    folder = tmp_path_factory.mktemp("whole")
    work(folder)
    return files(folder)


def test_a_whole_run_leaves_the_tables_and_its_status(tmp_path: Path) -> None:
    out = tmp_path / "a" / "out"
    assert work(out) == [0, 1, 2, 3, 4]
    assert sorted(path.name for path in out.iterdir()) == NAMES
    rows = read_measurements(out / "measurements.csv")
    assert [(row.file, type(row)) for row in rows] == [
        (row.file, type(row)) for shot in SHOTS for row in rows_of(shot)
    ]
    assert [refusal.file for refusal in read_refusals(out / "refusals.csv")] == ["images/1.jpg", "images/3.jpg"]
    status = json.loads((out / "run.json").read_text())
    assert status["complete"] is True
    assert (status["shots"], status["done"], status["skipped"]) == (5, 5, [])
    assert status["run"]["method"] == "paper"
    assert status["source"] == "approach"


@pytest.mark.parametrize("fail_at", [1, 4])
def test_an_interrupt_keeps_what_is_finished(tmp_path: Path, whole: dict[str, str], fail_at: int) -> None:
    out = tmp_path / "out"
    with pytest.raises(KeyboardInterrupt):
        work(out, fail_at=fail_at)
    rows = read_measurements(out / "measurements.csv")
    assert {row.file for row in rows} == {shot.file for shot in SHOTS[:fail_at]}
    status = json.loads((out / "run.json").read_text())
    assert (status["complete"], status["done"], status["shots"]) == (False, fail_at, 5)

    assert work(out, resume=True) == list(range(fail_at, 5))
    assert files(out) == whole


def test_a_run_interrupted_twice_ends_like_one_without(tmp_path: Path, whole: dict[str, str]) -> None:
    for fail_at in (2, 3):
        with pytest.raises(KeyboardInterrupt):
            work(tmp_path, fail_at=fail_at, resume=True)
    assert work(tmp_path, resume=True) == [3, 4]
    assert files(tmp_path) == whole


@given(st.data())
def test_a_run_killed_anywhere_ends_like_one_without(whole: dict[str, str], data: st.DataObject) -> None:
    with TemporaryDirectory() as folder:
        out = Path(folder) / "out"
        with pytest.raises(RuntimeError):
            work(out, fail_at=4, kind=RuntimeError)
        journal = out / JOURNAL
        content = journal.read_bytes()
        heading = content.index(b"\n") + 1
        kept = data.draw(st.integers(heading, len(content)))
        journal.write_bytes(content[:kept])
        again = work(out, resume=True)
        assert again == list(range(content[heading:kept].count(b"\n"), 5))
        assert files(out) == whole


def test_a_run_killed_twice_ends_like_one_without(tmp_path: Path, whole: dict[str, str]) -> None:
    with pytest.raises(RuntimeError):
        work(tmp_path, fail_at=3, kind=RuntimeError)
    journal = tmp_path / JOURNAL
    journal.write_bytes(journal.read_bytes()[:-20])
    with pytest.raises(RuntimeError):
        work(tmp_path, fail_at=4, kind=RuntimeError, resume=True)
    assert work(tmp_path, resume=True) == [4]
    assert files(tmp_path) == whole


def test_what_is_added_is_in_the_file_at_once_and_an_error_writes_no_tables_but_can_be_resumed(
    tmp_path: Path, whole: dict[str, str]
) -> None:
    out = tmp_path / "out"
    with pytest.raises(RuntimeError):
        work(out, fail_at=3, kind=RuntimeError)
    assert list(files(out)) == [JOURNAL]
    assert work(out, resume=True) == [3, 4]
    assert files(out) == whole
    with RunFolder(tmp_path, RUN, SOURCE, SHOTS) as output:
        for number, shot in output.remaining():
            output.add(number, rows_of(shot), [])
            assert shot.file in (tmp_path / JOURNAL).read_text().splitlines()[-1]


def test_an_error_leaves_the_earlier_tables_alone(tmp_path: Path, whole: dict[str, str]) -> None:
    work(tmp_path)
    with pytest.raises(RuntimeError):
        work(tmp_path, run=Run("9", "joint_search", "9", ""), fail_at=3, kind=RuntimeError)
    assert {name: text for name, text in files(tmp_path).items() if name != JOURNAL} == whole


@pytest.mark.parametrize("kind", [KeyboardInterrupt, RuntimeError])
def test_a_run_that_finished_nothing_leaves_nothing(tmp_path: Path, kind: type[BaseException]) -> None:
    with pytest.raises(kind):
        work(tmp_path / "out", fail_at=0, kind=kind)
    assert list(tmp_path.iterdir()) == []


def test_a_run_without_resume_starts_anew(tmp_path: Path, whole: dict[str, str]) -> None:
    with pytest.raises(KeyboardInterrupt):
        work(tmp_path, fail_at=3)
    assert work(tmp_path) == [0, 1, 2, 3, 4]
    assert files(tmp_path) == whole


def test_skipped_shots_are_reported_and_tried_again(tmp_path: Path, whole: dict[str, str]) -> None:
    assert work(tmp_path, unreadable=[1, 3]) == [0, 1, 2, 3, 4]
    status = json.loads((tmp_path / "run.json").read_text())
    assert (status["complete"], status["done"]) == (True, 3)
    assert status["skipped"] == [
        {"time_s": 0.5, "file": "images/1.jpg", "reason": "images/1.jpg: is truncated"},
        {"time_s": 1.5, "file": "images/3.jpg", "reason": "images/3.jpg: is truncated"},
    ]
    kept = {row.file for row in read_measurements(tmp_path / "measurements.csv")}
    assert kept == {f"images/{number}.jpg" for number in (0, 2, 4)}
    assert work(tmp_path, resume=True, unreadable=[3]) == [1, 3]
    assert [skip["time_s"] for skip in json.loads((tmp_path / "run.json").read_text())["skipped"]] == [1.5]
    assert work(tmp_path, resume=True) == [3]
    assert files(tmp_path) == whole


def test_counts_include_what_was_resumed(tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt):
        work(tmp_path, fail_at=3, unreadable=[0])
    with RunFolder(tmp_path, RUN, SOURCE, SHOTS, resume=True) as output:
        assert output.done == 2
        assert output.skipped == {0: "images/0.jpg: is truncated"}
        assert [number for number, _ in output.remaining()] == [0, 3, 4]


def test_resuming_nothing_is_a_first_run_and_resuming_a_finished_one_does_nothing(
    tmp_path: Path, whole: dict[str, str]
) -> None:
    for worked in ([0, 1, 2, 3, 4], []):
        assert work(tmp_path / "out", resume=True) == worked
        assert files(tmp_path / "out") == whole


@pytest.mark.parametrize("name", ["recording", "method", "configuration", "starts", "version"])
@pytest.mark.parametrize("finished", [True, False])
def test_another_run_is_not_resumed(tmp_path: Path, name: str, finished: bool) -> None:
    with nullcontext() if finished else pytest.raises(KeyboardInterrupt):
        work(tmp_path, fail_at=None if finished else 3)
    before = files(tmp_path)
    values = {"recording": "0123", "method": "paper", "configuration": "4567", "starts": "", "version": "1.0"}
    other = Run(**values | {name: "other"})
    with pytest.raises(ResumeError, match=rf"cannot resume: .*{name} '{values[name]}', not 'other'") as caught:
        work(tmp_path, run=other, resume=True)
    assert "\n" not in str(caught.value)
    assert files(tmp_path) == before


@pytest.mark.parametrize("content", ["", "[1]\n", "time_s,file\n", '{"recor'])
def test_a_damaged_journal_is_not_resumed(tmp_path: Path, content: str) -> None:
    (tmp_path / JOURNAL).write_text(content)
    with pytest.raises(JournalError, match="is not the journal of a run"):
        work(tmp_path, resume=True)


@pytest.mark.parametrize("content", ["", "[1]", "{}", '{"run": [1, 2], "done": 5}', '{"run": {}, "done": "x"}'])
def test_a_damaged_status_is_not_resumed(tmp_path: Path, content: str) -> None:
    work(tmp_path)
    (tmp_path / "run.json").write_text(content)
    with pytest.raises(ResumeError, match=r"run\.json: is not the status of a run"):
        work(tmp_path, resume=True)


def test_a_shot_that_comes_back_is_worked_on_twice_in_order_and_no_shots_write_empty_tables(tmp_path: Path) -> None:
    assert work(tmp_path, shots=[SHOTS[1], SHOTS[0], SHOTS[1]]) == [0, 1, 2]
    written = [row.file for row in read_measurements(tmp_path / "measurements.csv")]
    assert written == ["images/1.jpg", "images/0.jpg", "images/1.jpg"]
    assert work(tmp_path, shots=[]) == []
    assert read_measurements(tmp_path / "measurements.csv") == ()
    assert json.loads((tmp_path / "run.json").read_text())["complete"] is True


def test_a_folder_that_cannot_be_made_is_an_error_and_a_closed_one_takes_nothing(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    for out in (tmp_path / "file", tmp_path / "file" / "out"):
        with pytest.raises(OutputError, match=r"file.*: cannot be written"):
            work(out)
    with pytest.raises(ValueError, match="not open"):
        RunFolder(tmp_path, RUN, SOURCE, SHOTS).skip(0, "why")


def test_a_run_is_told_apart_by_all_that_changes_its_rows(folder: Path, tmp_path: Path) -> None:
    recording = read_recording(folder)
    starts = tmp_path / "initial.csv"
    starts.write_text("time_s\n")
    runs = {
        Run.of(recording, "paper", "reach: 1"),
        Run.of(recording, "paper", "reach: 2"),
        Run.of(recording, "joint_search", "reach: 1"),
        Run.of(recording, "paper", "reach: 1", starts),
    }
    assert len(runs) == 4
    assert Run.of(read_recording(folder), "paper", "reach: 1") in runs
