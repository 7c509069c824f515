"""How help looks: options in panels, flags without a type, and examples below."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from typer.core import TyperCommand, TyperGroup

INPUT, RESULTS, MEASURING, REQUIREMENT, MANY = "Input", "Results", "Measuring", "What is required", "Many recordings"
"""Panels of options, by what they are about."""
SCENE, SENSOR, BOARD, TAGS = "Scene", "Sensor", "Board", "Tags on the uprights"
"""Panels of what is drawn, printed or looked for."""
FLAG = ""
"""How the type of an option without a value is shown: not at all."""


def examples(lines: Sequence[str]) -> str:
    """Return command lines as help lists them, each with a comment if it has one."""
    return "\n".join(["Examples:", *(f"  {line}" for line in lines)])


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
        try:
            super().format_help(ctx, formatter)  # type: ignore[misc]
        finally:
            self.epilog = shown
        if shown:
            formatter.write("\n".join(f" {line}" for line in shown.splitlines()) + "\n")


class PlainCommand(_Plain, TyperCommand):
    """A command with such a help."""


class PlainGroup(_Plain, TyperGroup):
    """A group of commands with such a help."""
