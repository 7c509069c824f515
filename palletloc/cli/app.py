"""The frame of the command line: which commands there are, and how a command fails.

A command's module is imported when that command is asked for, and imports what it works with when it runs, so that
the list of commands and the help of each appear at once.
"""

from __future__ import annotations

import importlib
import os
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from io import TextIOWrapper
from types import ModuleType
from typing import TYPE_CHECKING, Annotated

import typer

from palletloc import __version__
from palletloc.cli.help import FLAG, PlainCommand, PlainGroup, examples
from palletloc.errors import PalletLocError

if TYPE_CHECKING:
    import logging

_SUCCESS, _FAILURE, _INTERRUPTED = 0, 1, 130
"""Exit codes; 128 and the number of the signal is what shells expect of an interrupted program."""
_HELP_OPTIONS = ("-h", "--help")
"""What asks for help, of the program and of every command."""
_COMPLETING, _WORDS = "_PALLETLOC_COMPLETE", ("COMP_WORDS", "_TYPER_COMPLETE_ARGS")
"""Variables by which a shell asks what may be typed next, and that hold what has been typed so far."""
_EXAMPLES = (
    "palletloc demo                           # a look at everything",
    "palletloc localize RECORDING --out RUN   # poses of pallets, and RUN/overview.html",
    "palletloc COMMAND --help                 # options and examples of one command",
    "palletloc --install-completion           # the shell completes names and options",
)
"""Command lines for the program's help."""
_UNUSED = {"rich.markdown": "Markdown", "rich.traceback": "Traceback"}
"""Modules that typer's help imports, with the class that it takes from them. No help of this program is written in
Markdown, and no traceback is shown: their parsers would take a quarter of the time until help appears."""


@dataclass(frozen=True, slots=True)
class Command:
    """A subcommand that is not imported yet."""

    name: str
    """What the user types."""
    target: str
    """``"module:function"``, or ``"module:app"`` for a `typer.Typer` that has commands of its own."""
    summary: str
    """One line for the list of commands: the first line of the function's docstring."""
    examples: tuple[str, ...] = ()
    """Command lines for its help."""

    def load(self) -> Callable[..., None] | typer.Typer:
        """Import and return the function or the `typer.Typer` that the target names."""
        module, _, attribute = self.target.partition(":")
        loaded: Callable[..., None] | typer.Typer = getattr(importlib.import_module(module), attribute)
        return loaded


COMMANDS = (
    Command(
        "localize",
        "palletloc.cli.localize:localize",
        "Measure the pallets in each shot of a recording.",
        (
            "palletloc localize RECORDING --out RUN",
            "palletloc localize RECORDING --out RUN --resume     # after an interrupt",
            "palletloc localize RECORDING --out RUN --json       # for programs",
        ),
    ),
    Command(
        "evaluate",
        "palletloc.cli.evaluate:evaluate",
        "Hold measured poses against the truth of a recording.",
        (
            "palletloc evaluate RECORDING --estimate RUN --out DIR",
            "palletloc evaluate RECORDING --estimate A --estimate B --out DIR",
            "palletloc evaluate --batch RECORDINGS --estimate run --out DIR",
        ),
    ),
    Command(
        "explain",
        "palletloc.cli.explain:explain",
        "Draw every stage of the localization of one shot.",
        (
            "palletloc explain RECORDING --shot 0 --out DIR",
            "palletloc explain RECORDING --shot 7 --out DIR --no-refused",
        ),
    ),
    Command(
        "simulate",
        "palletloc.cli.simulate:simulate",
        "Write a synthetic recording with its truth: an approach to a rack, drawn from a seed.",
        (
            "palletloc simulate --out RECORDING",
            "palletloc simulate --out RECORDING --seed 3 --camera dual_fisheye",
        ),
    ),
    Command(
        "pallets",
        "palletloc.cli.pallets:pallets",
        "List and draw the pallet models.",
        (
            "palletloc pallets",
            "palletloc pallets epal1-800 gma",
            "palletloc pallets --file pallets.yaml --draw all.png",
        ),
    ),
    Command(
        "config",
        "palletloc.cli.config:config",
        "Print every parameter with its default.",
        ("palletloc config > mine.yaml", "palletloc config --file mine.yaml   # checks it, too"),
    ),
)
"""The commands of palletloc itself, in the order in which help lists them."""


def run(arguments: Sequence[str], commands: Sequence[Command] = COMMANDS) -> int:
    """Run the command that the arguments name.

    Parameters
    ----------
    arguments : sequence of str
        What follows the program's name on the command line.
    commands : sequence of Command
        The subcommands to offer.

    Returns
    -------
    int
        Exit code: 0 on success, 1 on bad input (one line on standard error says what, where, and what was
        expected), 2 on wrong usage, 130 when interrupted.
    """
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="replace")  # a terminal that cannot show a sign shows another one
    if _COMPLETING not in os.environ and (not arguments or any(option in arguments for option in _HELP_OPTIONS)):
        _import_help()
    try:
        _build(arguments, commands)(args=list(arguments), prog_name="palletloc")
    except SystemExit as ending:  # how typer ends every run, a successful one too
        if ending.code == _INTERRUPTED:
            _say("interrupted")
        return ending.code if isinstance(ending.code, int) else _FAILURE
    except KeyboardInterrupt:  # while a command's module was being imported
        _say("interrupted")
        return _INTERRUPTED
    except (PalletLocError, OSError) as error:
        _say(_line(error))
        _logger().debug("where it happened", exc_info=True)
        return _FAILURE
    return _SUCCESS


def _build(arguments: Sequence[str], commands: Sequence[Command]) -> typer.Typer:
    """Return the application with the asked-for command loaded and a stand-in for each of the others."""
    asked = next((word for word in _words(arguments) if not word.startswith("-")), None)  # no option takes a value
    app = typer.Typer(
        cls=PlainGroup,
        epilog=examples(_EXAMPLES),
        no_args_is_help=True,
        pretty_exceptions_enable=False,
        context_settings={"help_option_names": list(_HELP_OPTIONS)},
    )
    app.callback()(_root)
    for command in commands:
        loaded = command.load() if command.name == asked else _stand_in
        if isinstance(loaded, typer.Typer):
            app.add_typer(loaded, name=command.name, help=command.summary)
        else:
            shown = examples(command.examples) if command.examples else None
            app.command(command.name, cls=PlainCommand, short_help=command.summary, epilog=shown)(loaded)
    return app


def _words(arguments: Sequence[str]) -> Sequence[str]:
    """Return what follows the program's name: the arguments, or what has been typed so far where a shell asks."""
    if _COMPLETING not in os.environ:
        return arguments
    return next((os.environ[name].split()[1:] for name in _WORDS if name in os.environ), arguments)


def _import_help() -> None:
    """Import typer's help with stand-ins for what it does not use; they are gone when this returns."""
    stand_ins = {module: ModuleType(module) for module in _UNUSED if module not in sys.modules}
    for module, stand_in in stand_ins.items():
        vars(stand_in)[_UNUSED[module]] = type(_UNUSED[module], (), {})
    sys.modules.update(stand_ins)
    try:
        with suppress(ImportError):  # another release of typer may have its help elsewhere
            importlib.import_module("typer.rich_utils")
    finally:
        for module in stand_ins:
            del sys.modules[module]


def _stand_in() -> None:
    """Hold a place in the list of commands; never called."""


def _show_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"palletloc {__version__}")
        raise typer.Exit


def _root(
    verbose: Annotated[
        bool, typer.Option("--verbose", "-v", metavar=FLAG, help="Say where an error comes from.")
    ] = False,
    _version: Annotated[
        bool, typer.Option("--version", callback=_show_version, is_eager=True, help="Print the version and exit.")
    ] = False,
) -> None:
    """Find pallets on shelves in 360-degree shots and measure their poses."""
    import logging  # not needed for help

    logging.basicConfig(format="%(name)s: %(message)s")
    _logger().setLevel(logging.DEBUG if verbose else logging.WARNING)


def _logger() -> logging.Logger:
    import logging  # not needed for help

    return logging.getLogger("palletloc")


def _line(error: PalletLocError | OSError) -> str:
    """Return what went wrong as one line."""
    if isinstance(error, OSError) and error.filename is not None:
        return f"{error.filename}: {error.strerror}"
    return " ".join(str(error).split())


def _say(line: str) -> None:
    sys.stderr.write(f"palletloc: {line}\n")
