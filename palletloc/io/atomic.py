"""Files that outlive a process that is killed: put in place whole or not at all, or written entry by entry."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from palletloc.errors import PalletLocError
from palletloc.io.reading import InputError


class OutputError(PalletLocError):
    """A file or folder cannot be written."""


def cannot_write(path: Path, error: OSError) -> OutputError:
    """Return the error about a path, to be raised by the caller."""
    return OutputError(f"{path}: cannot be written: {error.strerror or error}")


@contextmanager
def written_beside(path: Path) -> Iterator[Path]:
    """Give a path in the same folder to write to; it takes the place of `path` at the end.

    Any exception, KeyboardInterrupt included, leaves `path` as it was and removes what was written.
    Missing parent folders are made.

    Parameters
    ----------
    path : Path
        The file or folder to appear. It may take the place of a file or of an empty folder.

    Yields
    ------
    Path
        Where to write: it does not exist yet and has the same suffix.

    Raises
    ------
    OutputError
        If there is a folder with something in it, a parent cannot be made, or the result cannot be put in
        place.
    """
    partial = path.with_name(f".partial-{os.getpid()}-{path.name}")
    try:
        if path.is_dir() and any(path.iterdir()):
            raise OutputError(f"{path}: is there already; expected a new name or an empty folder")
        path.parent.mkdir(parents=True, exist_ok=True)
        _remove(partial)
    except OSError as error:
        raise cannot_write(path, error) from error
    try:
        yield partial
        try:
            partial.replace(path)
        except OSError as error:
            raise cannot_write(path, error) from error
    finally:
        _remove(partial)


def write_bytes(path: Path, content: bytes) -> None:
    """Write a file whole or not at all.

    Parameters
    ----------
    path : Path
        The file; an existing one is replaced.
    content : bytes
        All of it.

    Raises
    ------
    OutputError
        If it cannot be written.
    """
    with written_beside(path) as partial:
        try:
            partial.write_bytes(content)
        except OSError as error:
            raise cannot_write(path, error) from error


def write_text(path: Path, content: str) -> None:
    """Write a UTF-8 text file whole or not at all, as `write_bytes` does."""
    write_bytes(path, content.encode("utf-8"))


def _remove(partial: Path) -> None:
    if partial.is_dir() and not partial.is_symlink():
        shutil.rmtree(partial)
    else:
        partial.unlink(missing_ok=True)


class JournalError(InputError):
    """A journal that cannot be taken up again."""


class Journal:
    """An append-only file of JSON lines: a heading that says what the run is, then numbered entries.

    An entry has left the process when `append` returns: a process that is killed loses at most the entry
    that it is writing. Only the entries' places are held in memory.

    Parameters
    ----------
    path : Path
        The file; its folder exists.
    heading : dict, optional
        What the run is: starts the file anew. Without it the file is taken up as it is, but for a last line
        that was not finished.

    Raises
    ------
    JournalError
        If the file to be taken up is not a journal.
    OutputError
        If the file cannot be opened or written.
    """

    def __init__(self, path: Path, heading: dict[str, Any] | None = None) -> None:
        self._path = path
        self._places: dict[int, int] = {}
        with self._writing():
            self._file = path.open("r+b" if heading is None else "w+b")
            if heading is None:
                self.heading = self._take_up()
            else:
                self.heading = heading
                self._write(heading)

    def append(self, number: int, entry: dict[str, Any]) -> None:
        """Add the entry of a number; it takes the place of an earlier one of the same number.

        Raises
        ------
        OutputError
            If it cannot be written.
        """
        with self._writing():
            place = self._file.seek(0, 2)
            self._write({"number": number, "entry": entry})
        self._places[number] = place

    def entries(self) -> Iterator[tuple[int, dict[str, Any]]]:
        """Yield number and entry by rising number, read from the file one by one."""
        for number in sorted(self._places):
            self._file.seek(self._places[number])
            yield number, json.loads(self._file.readline())["entry"]

    def close(self, *, remove: bool) -> None:
        """Close the file, and remove it where it is no longer needed."""
        self._file.close()
        if remove:
            self._path.unlink(missing_ok=True)

    def _take_up(self) -> dict[str, Any]:
        """Find the entries, cut off what follows the last whole one, and return the heading."""
        heading = _parsed(self._file.readline())
        if heading is None:
            self._file.close()
            raise JournalError(f"{self._path}: is not the journal of a run; remove it, or do not resume")
        end = self._file.tell()
        for line in iter(self._file.readline, b""):
            if (value := _parsed(line)) is None or not {"number", "entry"} <= value.keys():
                break
            self._places[value["number"]] = end
            end += len(line)
        self._file.truncate(end)
        return heading

    def _write(self, value: dict[str, Any]) -> None:
        self._file.write(json.dumps(value, allow_nan=False).encode() + b"\n")
        self._file.flush()

    @contextmanager
    def _writing(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise cannot_write(self._path, error) from error


def _parsed(line: bytes) -> dict[str, Any] | None:
    """Return the object of a whole line; None where there is none."""
    try:
        value = json.loads(line) if line.endswith(b"\n") else None
    except ValueError:
        return None
    return value if isinstance(value, dict) else None
