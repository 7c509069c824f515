"""The journal of an unfinished run: one line per shot, appended as soon as the shot is done."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from palletloc.io.atomic import cannot_write
from palletloc.io.reading import InputError


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
