"""Public names of a package that are imported at first use: its stub alone says which there are, and from where."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from functools import cache
from pathlib import Path


def names_of_stub(package: str, stub: Path) -> Callable[[str], object]:
    """Return what looks a package's public names up: its module-level ``__getattr__``.

    Parameters
    ----------
    package : str
        Its name.
    stub : Path
        Its ``__init__.pyi``, with a line ``from package.module import Name as Name`` for each of the names. A type
        checker reads the same file in place of the package.

    Returns
    -------
    callable
        From a name to what it stands for; ``__all__`` is the list of all of them.
    """

    @cache
    def homes() -> dict[str, str]:
        lines = (line.split() for line in stub.read_text(encoding="utf-8").splitlines())
        return {words[-1]: words[1] for words in lines if words[:1] == ["from"] and words[-2] == "as"}

    def look_up(name: str) -> object:
        if name == "__all__":
            return sorted(homes())
        if name.startswith("__") or name not in homes():
            raise AttributeError(f"module '{package}' has no attribute '{name}'")
        return getattr(importlib.import_module(homes()[name]), name)

    return look_up
