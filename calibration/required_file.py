"""Files that a command cannot do without: who forgets one is told what it should hold."""

from __future__ import annotations

from pathlib import Path

from palletloc.io.reading import InputError


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
