"""The command line of the benchmarks."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from importlib.resources import as_file, files
from pathlib import Path

import cv2
from rich.console import Console

from benchmarks.accuracy import measure_accuracy
from benchmarks.speed import measure_speed
from benchmarks.tables import Section, as_markdown, as_table
from palletloc.errors import PalletLocError

SAMPLE = "sample"
"""Where the package keeps the recording that comes along."""
WIDTH = 150
"""Of a printed table at most, in characters."""


def run(arguments: Sequence[str]) -> int:
    """Measure what the arguments ask for, and print it.

    Returns
    -------
    int
        Exit code: 0 on success, 1 on bad input, which one line on standard error describes.
    """
    options = _parser().parse_args(arguments)
    cv2.setNumThreads(1)
    console = Console(stderr=True)
    try:
        with as_file(files("palletloc") / SAMPLE) as sample:
            recordings = options.recordings or [sample]
            if options.accuracy:
                sections = measure_accuracy(recordings, console)
            else:
                sections = measure_speed(recordings[0], options.rounds, console)
    except PalletLocError as error:
        sys.stderr.write(f"benchmarks: {' '.join(str(error).split())}\n")
        return 1
    _print(sections, options.form)
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks",
        description="CPU time in one thread, as medians and as ratios within one process; or accuracy.",
    )
    parser.add_argument(
        "recordings",
        nargs="*",
        type=Path,
        metavar="RECORDING",
        help="folders of recordings; the sample that comes along if none. Speed takes the first.",
    )
    parser.add_argument(
        "--accuracy", action="store_true", help="compare the methods on recordings with truth instead"
    )
    parser.add_argument("--rounds", type=_count, default=5, help="how often everything is timed (5)")
    form = parser.add_mutually_exclusive_group()
    form.add_argument("--json", dest="form", action="store_const", const="json", help="print as JSON")
    form.add_argument(
        "--markdown", dest="form", action="store_const", const="markdown", help="print as Markdown tables"
    )
    return parser


def _count(text: str) -> int:
    if not (text.isdecimal() and int(text) > 0):
        raise argparse.ArgumentTypeError(f"expected a whole number from 1 on, got '{text}'")
    return int(text)


def _print(sections: Sequence[Section], form: str | None) -> None:
    if form == "json":
        print(json.dumps([section.plain() for section in sections], indent=1))
        return
    for section in sections:
        if form == "markdown":
            print(as_markdown(section))
        else:
            Console(width=WIDTH).print(as_table(section))
