"""One run at a time in a folder: a lock of the operating system, which ends with the process however that ends."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from io import FileIO
from pathlib import Path

from palletloc.io.atomic import OutputError, cannot_write, remove_leftovers

LOCK = ".running"
"""Name of the file in the folder that is locked; it holds the number of the process."""
_held: dict[Path, int] = {}
"""Folders that this process has locked, and how often: a command may lock what a part of it locks, too."""


class FolderInUseError(OutputError):
    """Another run writes into the folder."""


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Keep other runs out of a folder, and remove what runs that were killed have left half written in it.

    A run that is killed leaves no lock behind: the system takes it away with the process.

    Parameters
    ----------
    folder : Path
        Made if missing, and removed again where nothing has come into it.

    Raises
    ------
    FolderInUseError
        If another process writes into it; names that process.
    OutputError
        If the folder cannot be made or written.
    """
    try:
        missing = not folder.exists()
        folder.mkdir(parents=True, exist_ok=True)
        place = folder.resolve()
        file = None if place in _held else _locked_file(folder)
    except OSError as error:
        raise cannot_write(folder, error) from error
    _held[place] = _held.get(place, 0) + 1
    try:
        if file is not None:
            remove_leftovers(folder)
        yield
    finally:
        _held[place] -= 1
        if file is not None:
            del _held[place]
            _unlock(folder / LOCK, file)
            with suppress(OSError):
                if missing:
                    folder.rmdir()


def _locked_file(folder: Path) -> FileIO:
    """Return the open and locked file of a folder."""
    while True:
        file = (folder / LOCK).open("a+b", buffering=0)
        try:
            if not _lock(file):
                raise FolderInUseError(
                    f"{folder}: {_owner(file)} writes into it; expected it to end, or another folder"
                )
            # An owner that ends removes the file: what is locked must be the one that others find.
            if os.path.samestat(os.fstat(file.fileno()), (folder / LOCK).stat()):
                with suppress(OSError):  # a full disk: then others are not told who it is
                    file.truncate(0)
                    file.write(f"{os.getpid()}\n".encode())
                return file
        except FileNotFoundError:
            pass
        except BaseException:
            _close(file)
            raise
        _close(file)


def _owner(file: FileIO) -> str:
    file.seek(0)
    number = file.read(20).strip()
    return f"another run (process {number.decode()})" if number.isdigit() else "another run"


def _lock(file: FileIO) -> bool:
    """Lock an open file; False where another process has. A file system without locks takes every run."""
    try:
        if sys.platform == "win32":
            import msvcrt

            file.seek(1 << 20)  # bytes that nobody reads
            msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK, 1)
        else:
            import fcntl

            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except (BlockingIOError, PermissionError):
        return False
    except OSError:
        return True
    return True


def _unlock(path: Path, file: FileIO) -> None:
    """Remove the file and let go of it."""
    with suppress(OSError):
        path.unlink()
    _close(file)


def _close(file: FileIO) -> None:
    with suppress(OSError):  # a full disk: what it would still write is the number of a process
        file.close()
