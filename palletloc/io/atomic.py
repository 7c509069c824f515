"""Files that outlive a process that is killed: put in place whole or not at all, or written entry by entry."""

from __future__ import annotations

import json
import os
import re
import shutil
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from palletloc.errors import PalletLocError
from palletloc.io.reading import InputError

PARTIAL = ".partial-{}-{}"
"""Name of what is half written: the number of the process, and the name of what it shall be."""
_LONGEST_LINE = 1 << 26
"""Of a journal, in bytes: thousands of times that of a shot."""


_written: set[Path] = set()
"""What this process has written: leftovers of others are looked for once."""


class OutputError(PalletLocError):
    """A file or folder cannot be written."""


def cannot_write(path: Path, error: Exception) -> OutputError:
    """Return the error about a path, to be raised by the caller."""
    return OutputError(f"{path}: cannot be written: {getattr(error, 'strerror', None) or error}")


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
    try:
        # What is named only by where it is, such as ".", has no name for a file beside it.
        place = path if path.name not in ("", "..") else path.resolve()
        partial = place.with_name(PARTIAL.format(os.getpid(), place.name))
        if path.is_dir() and any(path.iterdir()):
            raise OutputError(f"{path}: is there already; expected a new name or an empty folder")
        path.parent.mkdir(parents=True, exist_ok=True)
        remove_partial(partial)
        if place not in _written:
            remove_leftovers(place.parent, place.name)
            _written.add(place)
    except (OSError, ValueError) as error:
        raise cannot_write(path, error) from error
    try:
        yield partial
        try:
            _put(partial, place, whole=place is path)
        except OSError as error:
            raise cannot_write(path, error) from error
    finally:
        with suppress(OSError):
            remove_partial(partial)


def _put(partial: Path, place: Path, *, whole: bool) -> None:
    """Give what was written its name; into a folder that somebody stands in, part by part or not at all."""
    if whole or not place.is_dir() or not partial.is_dir():
        partial.replace(place)
        return
    done: list[Path] = []
    try:
        for part in sorted(partial.iterdir()):
            part.replace(place / part.name)
            done.append(place / part.name)
    except BaseException:
        for part in done:
            part.replace(partial / part.name)
        raise


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


def remove_leftovers(folder: Path, name: str = "") -> None:
    """Remove what processes that were killed have left half written in a folder, but nothing of one that lives.

    Parameters
    ----------
    folder : Path
        Looked at itself, not at folders in it.
    name : str, optional
        Of the file or folder that it should have become; every one if left out.
    """
    form = re.compile(PARTIAL.format(r"(\d+)", re.escape(name) if name else ".*").replace(".", r"\.", 1))
    for path in folder.iterdir():
        match = form.fullmatch(path.name)
        if match and not _is_alive(int(match[1])):
            with suppress(OSError):
                remove_partial(path)


def _is_alive(process: int) -> bool:
    """Tell whether there is such a process; where the system does not say, there is."""
    if sys.platform == "win32" or process == os.getpid():
        return True
    try:
        os.kill(process, 0)  # asks, and sends nothing
    except (ProcessLookupError, OverflowError):
        return False
    except OSError:
        return True
    return True


def remove_partial(partial: Path) -> None:
    """Remove a file, or a folder with all that is in it; nothing where there is none."""
    if partial.is_dir() and not partial.is_symlink():
        shutil.rmtree(partial)
    else:
        partial.unlink(missing_ok=True)


class JournalError(InputError):
    """A journal that cannot be taken up again."""


class Journal:
    """An append-only file of JSON lines: a heading that says what the run is, then numbered entries.

    An entry has left the process when `append` returns: a process that is killed loses at most the entry
    that it is writing. Where the disk is full, the file ends with the last whole entry. Only the entries' places are
    held in memory.

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
        self.damaged = 0
        """Lines that were taken up and are no entries."""
        if heading is not None:
            write_bytes(path, _line(heading))
        with self._writing():
            self._file = path.open("r+b", buffering=0)
        try:
            self.heading = self._take_up()
        except BaseException:
            self._file.close()
            raise

    def append(self, number: int, entry: dict[str, Any]) -> None:
        """Add the entry of a number; it takes the place of an earlier one of the same number.

        Raises
        ------
        OutputError
            If it cannot be written; the journal is then as it was.
        """
        line = memoryview(_line({"number": number, "entry": entry}))
        with self._writing():
            place = self._file.seek(0, 2)
            try:
                while line:
                    line = line[self._file.write(line) :]
            except BaseException:
                self._file.truncate(place)
                raise
        self._places[number] = place

    def entries(self) -> Iterator[tuple[int, dict[str, Any]]]:
        """Yield number and entry by rising number, read from the file one by one."""
        with self._path.open("rb") as file:
            for number in sorted(self._places):
                file.seek(self._places[number])
                yield number, json.loads(file.readline())["entry"]

    def forget(self, number: int) -> None:
        """Leave out the entry of a number, which says what cannot be."""
        del self._places[number]
        self.damaged += 1

    def close(self, *, remove: bool) -> None:
        """Close the file, and remove it where it is no longer needed."""
        self._file.close()
        if remove:
            self._path.unlink(missing_ok=True)

    def _take_up(self) -> dict[str, Any]:
        """Find the entries, cut off a last line that is not whole, and return the heading."""
        with self._writing(), self._path.open("rb") as file:
            heading = parsed_json(file.readline(_LONGEST_LINE))
            if not isinstance(heading, dict):
                raise JournalError(f"{self._path}: is not the journal of a run; remove it, or do not resume")
            end = file.tell()
            for line in iter(lambda: file.readline(_LONGEST_LINE), b""):
                if not line.endswith(b"\n"):
                    break
                number = _number(parsed_json(line))
                if number is None:
                    self.damaged += 1
                else:
                    self._places[number] = end
                end += len(line)
            if end < self._file.seek(0, 2):
                self._file.truncate(end)
        return heading

    @contextmanager
    def _writing(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise cannot_write(self._path, error) from error


def _line(value: dict[str, Any]) -> bytes:
    return json.dumps(value, allow_nan=False).encode() + b"\n"


def _number(value: Any) -> int | None:
    """Return the number of an entry; None where it is none."""
    if not isinstance(value, dict) or not isinstance(value.get("entry"), dict):
        return None
    number = value.get("number")
    return number if isinstance(number, int) and not isinstance(number, bool) else None


def parsed_json(content: bytes | str) -> Any:
    """Return what a JSON text of this program holds; None where it is none: numbers that are no numbers, too.

    A line of a journal ends with its line break; one that does not was not finished.
    """
    if isinstance(content, bytes) and not content.endswith(b"\n"):
        return None
    try:
        return json.loads(content, parse_constant=_refuse)
    except (ValueError, RecursionError):
        return None


def _refuse(constant: str) -> None:
    raise ValueError(constant)
