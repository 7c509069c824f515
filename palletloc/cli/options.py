"""Options that several commands share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from palletloc.choices import Method
from palletloc.cli.help import FLAG, INPUT, MEASURING, RESULTS


def within(low: float, high: float) -> dict[str, Any]:
    """Return the settings of an option whose numbers have a range; ``min`` and ``max`` alone would let nan in."""

    def checked(parameter: typer.CallbackParam, given: Any) -> Any:
        for number in given if isinstance(given, list | tuple) else [] if given is None else [given]:
            if not low <= number <= high:
                raise typer.BadParameter(f"expected a number from {low:g} to {high:g}, got {number:g}")
        # typer 0.16 wants a list where an option may be repeated, if it was not even given once
        return [] if given is None and parameter.multiple else given

    return {"min": low, "max": high, "callback": checked}


RecordingFolder = Annotated[Path, typer.Argument(metavar="RECORDING", help="Folder of the recording.")]
"""The recording that a command is about."""
OutFolder = Annotated[
    Path,
    typer.Option("--out", metavar="DIR", rich_help_panel=RESULTS, help="Folder for the results; made if missing."),
]
"""Where a command writes."""
SurveyColumns = Annotated[
    str | None,
    typer.Option(
        metavar="NAMES",
        rich_help_panel=INPUT,
        help="What the columns of a surveyed table without header are, from the left: P,E,N,H and the like.",
    ),
]
"""What a table of surveyed points does not say."""
Starts = Annotated[
    Path | None,
    typer.Option(metavar="CSV", rich_help_panel=INPUT, help="Start from these poses instead of detecting pallets."),
]
"""Given starts."""
MethodName = Annotated[
    Method,
    typer.Option(rich_help_panel=MEASURING, metavar="NAME", help=f"How poses are measured: {', '.join(Method)}."),
]
"""How poses are measured."""
Parameters = Annotated[
    Path | None,
    typer.Option(metavar="YAML", rich_help_panel=MEASURING, help="Parameters of your own; see palletloc config."),
]
"""Parameters that differ from their defaults."""
Strict = Annotated[
    bool,
    typer.Option(
        "--strict", metavar=FLAG, rich_help_panel=MEASURING, help="Stop at the first shot that cannot be used."
    ),
]
"""Whether one unusable shot ends the run."""
Resume = Annotated[
    bool,
    typer.Option(
        "--resume",
        metavar=FLAG,
        rich_help_panel=RESULTS,
        help="Go on with an interrupted run; try its skipped shots again.",
    ),
]
"""Whether to keep what an earlier run finished."""
Verbose = Annotated[
    bool,
    typer.Option("--verbose", "-v", metavar=FLAG, rich_help_panel=RESULTS, help="Say what each shot gives."),
]
"""Whether each shot gets a line."""
