"""What a command shows: tables for people, one JSON document for programs, or nothing at all.

A command returns what it has to say. `shows` gives it the options ``--json`` and ``--quiet``, and prints.
"""

from __future__ import annotations

import inspect
import json
import math
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from functools import wraps
from typing import TYPE_CHECKING, Annotated, Any, ParamSpec

import typer

from palletloc.cli.help import FLAG, RESULTS

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

_Given = ParamSpec("_Given")

_is_quiet: ContextVar[bool] = ContextVar("is_quiet", default=False)
"""Whether the command that runs is to show nothing but errors."""
_JSON = Annotated[
    bool,
    typer.Option("--json", metavar=FLAG, rich_help_panel=RESULTS, help="Print one JSON document instead of tables."),
]
"""The option that asks for a document."""
_QUIET = Annotated[
    bool,
    typer.Option("--quiet", "-q", metavar=FLAG, rich_help_panel=RESULTS, help="Print nothing but errors."),
]
"""The option that asks for silence."""


@dataclass(frozen=True, slots=True, eq=False)
class Shown:
    """What a command has to say at its end."""

    document: Mapping[str, Any]
    """All of it in plain values, for ``--json``; numbers that are not finite become null."""
    parts: tuple[str | Table, ...] = ()
    """The same for people."""
    remarks: tuple[str, ...] = ()
    """Lines for standard error, about what restricts the result or fails."""
    exit_code: int = 0
    """How the command ends."""


def shows(command: Callable[_Given, Shown]) -> Callable[_Given, None]:
    """Return a command with the options ``--json`` and ``--quiet``, which prints what it returns."""

    @wraps(command)
    def printed(*given: _Given.args, **named: _Given.kwargs) -> None:
        as_json, quiet = bool(named.pop("as_json", False)), bool(named.pop("quiet", False))
        before = _is_quiet.set(quiet)
        try:
            shown = command(*given, **named)
        finally:
            _is_quiet.reset(before)
        _print(shown, as_json=as_json, quiet=quiet)
        if shown.exit_code:
            raise typer.Exit(shown.exit_code)

    signature = inspect.signature(command, eval_str=True)
    kind = inspect.Parameter.KEYWORD_ONLY
    added = {"as_json": _JSON, "quiet": _QUIET}
    options = [
        inspect.Parameter(name, kind, default=False, annotation=annotation) for name, annotation in added.items()
    ]
    vars(printed)["__signature__"] = signature.replace(parameters=[*signature.parameters.values(), *options])
    printed.__annotations__ = {**command.__annotations__, **added}
    return printed


def _print(shown: Shown, *, as_json: bool, quiet: bool) -> None:
    if as_json:
        sys.stdout.write(json.dumps(_plain(shown.document), indent=1, allow_nan=False) + "\n")
    elif not quiet:
        from palletloc.cli.tables import print_parts

        print_parts(shown.parts)
    if shown.exit_code or not quiet:
        for remark in shown.remarks:
            say(remark)


def _plain(value: Any) -> Any:
    """Return a value as JSON can hold it."""
    if isinstance(value, Mapping):
        return {str(key): _plain(part) for key, part in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(part) for part in value]
    if value is None or isinstance(value, (bool, int)):
        return value
    if isinstance(value, float):  # NumPy's are, too
        return float(value) if math.isfinite(value) else None
    return str(value)


def say(line: str) -> None:
    """Write a line to standard error, also while progress is shown."""
    sys.stderr.write(f"palletloc: {' '.join(line.split())}\n")


def say_all(lines: Iterable[str]) -> None:
    """Write lines to standard error, unless the command is to be quiet."""
    for line in () if _is_quiet.get() else lines:
        say(line)


def _watched() -> tuple[Console, bool]:
    """Return the console for progress, and whether somebody looks at it and wants to."""
    from rich.console import Console

    console = Console(stderr=True)
    return console, console.is_terminal and not _is_quiet.get()


@contextmanager
def progress(title: str, total: int, done: int = 0) -> Iterator[Callable[[], None]]:
    """Show how much of some work is done, where somebody is looking.

    Parameters
    ----------
    title : str
        What is done.
    total, done : int
        How much there is to do, and how much of it is done already.

    Yields
    ------
    callable
        To be called after each piece.
    """
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    console, wanted = _watched()
    columns = (TextColumn(title), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True, disable=not wanted) as bars:
        bar = bars.add_task("", total=total, completed=done)
        yield lambda: bars.advance(bar)


@contextmanager
def working(title: str) -> Iterator[Callable[[str], None]]:
    """Show what is being done, where somebody is looking; yields what takes the name of the next step."""
    console, wanted = _watched()
    if not wanted:
        yield lambda _: None
        return
    with console.status(title) as status:
        yield status.update
