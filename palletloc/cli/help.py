"""How help looks: options in panels, flags without a type, and examples below."""

from __future__ import annotations

import shutil
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from typer.core import TyperCommand, TyperGroup

INPUT, RESULTS, MEASURING, REQUIREMENT, MANY = "Input", "Results", "Measuring", "What is required", "Many recordings"
"""Panels of options, by what they are about."""
SCENE, SENSOR, BOARD, TAGS = "Scene", "Sensor", "Board", "Tags on the uprights"
"""Panels of what is drawn, printed or looked for."""
LEAST_WIDTH = 70
"""Width in which the help of every command has room for its options, in characters."""
FLAG = ""
"""How the type of an option without a value is shown: not at all."""


def examples(lines: Sequence[str]) -> str:
    """Return command lines as help lists them, each with a comment if it has one."""
    return "\n".join(["Examples:", *(f"  {line}" for line in lines)])


@contextmanager
def _wide_enough() -> Iterator[None]:
    """Let typer write for a terminal in which no option is cut; a narrower one wraps the lines."""
    rich_utils = sys.modules.get("typer.rich_utils")  # the frame imports it where help is asked for
    usual = getattr(rich_utils, "MAX_WIDTH", None)
    if rich_utils is not None and shutil.get_terminal_size().columns < LEAST_WIDTH:
        vars(rich_utils)["MAX_WIDTH"] = LEAST_WIDTH
    try:
        yield
    finally:
        if rich_utils is not None:
            vars(rich_utils)["MAX_WIDTH"] = usual


class _Plain:
    """What help of a command and of a group of commands have in common."""

    epilog: str | None

    def get_params(self, ctx: Any) -> Any:
        """Return the parameters; none of the flags shows a type."""
        params = super().get_params(ctx)  # type: ignore[misc]  # of the class beside this one
        for param in params:
            if getattr(param, "is_flag", False) and param.metavar is None:
                param.metavar = FLAG
        return params

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """Write the help, and the examples line by line at its end."""
        shown, self.epilog = self.epilog, None
        with _wide_enough():
            super().format_help(ctx, formatter)  # type: ignore[misc]
        self.epilog = shown
        if shown:
            formatter.write("\n".join(f" {line}" for line in shown.splitlines()) + "\n")


class PlainCommand(_Plain, TyperCommand):
    """A command with such a help."""


class PlainGroup(_Plain, TyperGroup):
    """A group of commands with such a help."""
