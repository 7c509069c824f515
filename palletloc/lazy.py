"""Public names of a package, imported at first use; its `__init__` says once which there are, and from where."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from functools import cache
from pathlib import Path


def late_names(package: str, source: str) -> Callable[[str], object]:
    """Return what looks a package's public names up: its module-level ``__getattr__``.

    Parameters
    ----------
    package : str
        Its name.
    source : str
        Its file ``__init__.py``, with a line ``from package.module import Name as Name`` for each of the names below
        ``if TYPE_CHECKING:``, where a type checker reads them and Python does not.

    Returns
    -------
    callable
        From a name to what it stands for; ``__all__`` is the list of all of them.
    """

    @cache
    def homes() -> dict[str, str]:
        lines = (line.split() for line in Path(source).read_text(encoding="utf-8").splitlines())
        return {words[5]: words[1] for words in lines if len(words) == 6 and words[0] == "from" and words[4] == "as"}

    def look_up(name: str) -> object:
        if name == "__all__":
            return sorted(homes())
        if name.startswith("__") or name not in homes():
            raise AttributeError(f"module '{package}' has no attribute '{name}'")
        return getattr(importlib.import_module(homes()[name]), name)

    return look_up
