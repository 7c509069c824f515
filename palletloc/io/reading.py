"""Reading whole files, with one clear line for whatever goes wrong."""

from __future__ import annotations

from pathlib import Path

from palletloc.errors import PalletLocError

_MAX_FILE_BYTES = 1 << 28
"""Largest file that is read, in bytes: a guard against a wrong file, far above any real one."""


class InputError(PalletLocError):
    """A file that cannot be read, or does not hold what it should."""


def require_file(path: Path, expected: str) -> Path:
    """Return the path of a file that is there.

    Parameters
    ----------
    path : Path
        The file.
    expected : str
        What it should be.

    Raises
    ------
    InputError
        If there is nothing at the path; says what was expected.
    """
    if not path.exists():
        raise InputError(f"{path}: no such file; expected {expected}")
    return path


def read_bytes(path: Path) -> bytes:
    """Read a whole regular file.

    Parameters
    ----------
    path : Path
        The file.

    Raises
    ------
    InputError
        If it is missing, not a regular file, larger than 256 MiB, or not readable.
    """
    try:
        if path.exists() and not path.is_file():
            raise InputError(f"{path}: is not a file")
        if (size := path.stat().st_size) > _MAX_FILE_BYTES:
            raise InputError(f"{path}: has {size} bytes, at most {_MAX_FILE_BYTES} are read")
        return path.read_bytes()
    except FileNotFoundError:
        raise InputError(f"{path}: no such file") from None
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot be read: {getattr(error, 'strerror', None) or error}") from error


def read_text(path: Path) -> str:
    """Read a whole UTF-8 text file; a byte-order mark is dropped.

    Raises
    ------
    InputError
        As in `read_bytes`, and if the file is not UTF-8 text.
    """
    try:
        text = read_bytes(path).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: is not UTF-8 text (byte {error.start})") from None
    if "\0" in text:
        raise InputError(f"{path}: is not text, it has zero bytes")
    return text
