"""Writing beside, then renaming: a file or folder appears whole or not at all."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from palletloc.errors import PalletLocError


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
