import errno
import fcntl
import json
import os
import resource
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

import pytest

from palletloc.io.atomic import OutputError
from palletloc.io.folder_lock import LOCK, FolderInUseError, locked
from palletloc.io.run_folder import JOURNAL, ResumeError, RunFolder
from tests.palletloc.io.test_run_folder import NAMES, RUN, SHOTS, SOURCE, files, work


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """Return the files of a run without interruption."""
    folder = tmp_path_factory.mktemp("whole")
    work(folder)
    return files(folder)


@contextmanager
def largest_file(size: int) -> Iterator[None]:
    """Let no file grow beyond a size, as a full disk does."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.mark.parametrize("size", [0, 20, 100, 500, 900, 1500, 2000])
def test_on_a_full_disk_the_file_is_named_and_the_run_can_be_resumed(
    tmp_path: Path, whole: dict[str, str], size: int
) -> None:
    out = tmp_path / "out"
    with largest_file(size), pytest.raises(OutputError, match=r"out/\S+: cannot be written: "):
        work(out)
    assert {path.name for path in out.iterdir()} <= {JOURNAL} if out.exists() else size < 300
    work(out, resume=True)
    assert files(out) == whole


@pytest.mark.parametrize("name", NAMES)
def test_a_table_that_cannot_be_put_in_place_is_named_and_the_others_are_whole(
    tmp_path: Path, whole: dict[str, str], name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    put = Path.replace

    def replace(partial: Path, target: Path) -> Path:
        if target.name == name:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return put(partial, target)

    with monkeypatch.context() as patch:
        patch.setattr(Path, "replace", replace)
        with pytest.raises(OutputError, match=rf"{name}: cannot be written: No space"):
            work(tmp_path)
    assert all(text == whole[file] for file, text in files(tmp_path).items() if file != JOURNAL)
    assert work(tmp_path, resume=True) == []
    assert files(tmp_path) == whole


def hold(out: Path) -> BinaryIO:
    """Lock a folder as another process does."""
    out.mkdir(exist_ok=True)
    file = (out / LOCK).open("wb")
    file.write(b"4711\n")
    file.flush()
    fcntl.flock(file, fcntl.LOCK_EX)
    return file


def test_a_second_run_into_a_folder_is_refused_by_name_and_changes_nothing(
    tmp_path: Path, whole: dict[str, str]
) -> None:
    with hold(tmp_path):
        for resume in (False, True):
            with pytest.raises(FolderInUseError, match=r"another run \(process 4711\) writes into it; expected"):
                work(tmp_path, resume=resume)
        assert list(files(tmp_path)) == [LOCK]
    assert work(tmp_path) == [0, 1, 2, 3, 4], "the lock ends with the process that held it"
    assert files(tmp_path) == whole
    with locked(tmp_path), locked(tmp_path):
        assert work(tmp_path) == [0, 1, 2, 3, 4], "a part of a command locks what the command has locked"
        assert (tmp_path / LOCK).exists()
    assert files(tmp_path) == whole


def test_what_killed_runs_left_half_written_is_removed_but_nothing_of_a_live_one(
    tmp_path: Path, whole: dict[str, str]
) -> None:
    dead = subprocess.Popen([sys.executable, "-c", ""])
    dead.wait()
    for number, name in ((dead.pid, "refusals.csv"), (dead.pid, "tracks.csv"), (os.getppid(), "run.json")):
        (tmp_path / f".partial-{number}-{name}").write_text("half")
    (tmp_path / f".partial-{dead.pid}-folder").mkdir()
    (tmp_path / f".partial-{dead.pid}-folder" / "file").touch()
    (tmp_path / ".partial-of-somebody").touch()
    work(tmp_path, resume=True)
    kept = {f".partial-{os.getppid()}-run.json", ".partial-of-somebody"}
    assert set(files(tmp_path)) == {*whole, *kept}


SOUND: dict[str, list[object]] = {"measurements": [], "refusals": []}
ROW = ["0.5", "images/1.jpg", "t11", *["1.0"] * 4, *["1e-6"] * 10, "0.5", "top"]
DAMAGED = [
    '{"number": 1, "entry": {}}',
    '{"number": 99, "entry": {"measurements": [], "refusals": []}}',
    '{"number": -1, "entry": {"measurements": [], "refusals": []}}',
    '{"number": [1], "entry": {"measurements": [], "refusals": []}}',
    '{"number": "a", "entry": {"measurements": [], "refusals": []}}',
    '{"number": true, "entry": {"measurements": [], "refusals": []}}',
    '{"number": 1.5, "entry": {"measurements": [], "refusals": []}}',
    '{"number": Infinity, "entry": {"measurements": [], "refusals": []}}',
    '{"number": 1, "entry": [1]}',
    '{"number": 1, "entry": {"measurements": 5, "refusals": []}}',
    '{"number": 1, "entry": {"measurements": [5], "refusals": []}}',
    '{"number": 1, "entry": {"measurements": [["a"]], "refusals": []}}',
    json.dumps({"number": 1, "entry": SOUND | {"measurements": [[*ROW[:3], "x", *ROW[4:]]]}}),
    json.dumps({"number": 1, "entry": SOUND | {"measurements": [["1.0", *ROW[1:]]]}}),
    json.dumps({"number": 1, "entry": SOUND | {"measurements": [[ROW[0], "images/2.jpg", *ROW[2:]]]}}),
    json.dumps({"number": 1, "entry": SOUND | {"measurements": [[*ROW[:3], "1e300", *ROW[4:]]]}}),
    json.dumps({"number": 1, "entry": SOUND | {"refusals": [["0.5", "images/1.jpg", "t11", "yaw", "why"]]}}),
    '{"number": 1, "entry": {"skipped": 5}}',
    "[" * 100_000,
    "{}",
    "no json",
    '{"number": ' + "9" * 5000 + "}",
]


@pytest.mark.parametrize("line", DAMAGED, ids=range(len(DAMAGED)))
def test_a_damaged_entry_is_left_out_and_its_shot_done_again(
    tmp_path: Path, whole: dict[str, str], line: str
) -> None:
    with pytest.raises(RuntimeError):
        work(tmp_path, fail_at=3, kind=RuntimeError)
    heading, *entries = (tmp_path / JOURNAL).read_text().splitlines()
    (tmp_path / JOURNAL).write_text("\n".join([heading, entries[0], line, entries[2]]) + "\n")
    with RunFolder(tmp_path, RUN, SOURCE, SHOTS, resume=True) as output:
        assert output.damaged == 1
        assert [number for number, _ in output.remaining()] == [1, 3, 4]
    assert work(tmp_path, resume=True) == [1, 3, 4]
    assert files(tmp_path) == whole


@pytest.mark.parametrize("name", ["deep", "number_99", "number_list", "number_text", "rows_int"])
def test_entries_that_were_taken_or_broke_a_run_are_left_out(
    tmp_path: Path, whole: dict[str, str], name: str, shared_data: Path
) -> None:
    _, *lines = (shared_data / "faults" / f"journal_{name}" / "unfinished.jsonl").read_text().splitlines()
    with pytest.raises(RuntimeError):
        work(tmp_path, fail_at=3, kind=RuntimeError)
    with (tmp_path / JOURNAL).open("a") as journal:
        journal.write("\n".join(lines) + "\n")
    assert set(work(tmp_path, resume=True)) - {0} == {3, 4}  # some name shot 0: it is done again
    assert files(tmp_path) == whole


@pytest.mark.parametrize("done", ["Infinity", "true", '"5"', "-1", "6", "5.0", "[5]", "1e999", "9" * 5000, "null"])
def test_a_status_with_a_count_that_cannot_be_is_not_resumed(tmp_path: Path, done: str) -> None:
    work(tmp_path)
    status = (tmp_path / "run.json").read_text().replace('"done": 5', f'"done": {done}')
    for content in (status, "[" * 100_000, '{"run":' * 100_000):
        (tmp_path / "run.json").write_text(content)
        with pytest.raises(ResumeError, match=r"run\.json: is not the status of a run; .* remove it, or do not"):
            work(tmp_path, resume=True)


def test_a_folder_named_by_where_it_is_can_be_written(
    tmp_path: Path, whole: dict[str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert work(Path()) == [0, 1, 2, 3, 4]
    assert files(tmp_path) == whole
