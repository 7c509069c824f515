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
from benchmarks.consistency import measure_consistency
from benchmarks.evaluation import measure_evaluation
from benchmarks.speed import measure_speed
from benchmarks.tables import Section, as_markdown, as_table
from benchmarks.tracking import measure_tracking
from palletloc.choices import Method
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
    parser = _parser()
    options = parser.parse_args(arguments)
    if options.figure and not options.accuracy:
        parser.error("--figure needs --accuracy")
    cv2.setNumThreads(1)
    console = Console(stderr=True)
    try:
        with as_file(files("palletloc") / SAMPLE) as sample:
            sections = _measured(options, options.recordings or [sample], console)
    except PalletLocError as error:
        sys.stderr.write(f"benchmarks: {' '.join(str(error).split())}\n")
        return 1
    _print(sections, options.form)
    return 0


def _measured(options: argparse.Namespace, recordings: Sequence[Path], console: Console) -> list[Section]:
    if options.consistency:
        seeds = range(options.seed, options.seed + options.consistency)
        return measure_consistency(seeds, options.methods, options.shots, options.width, console)
    if options.evaluation:
        return measure_evaluation(recordings[0], options.rounds)
    if options.tracking:
        return measure_tracking(options.rounds)
    if options.accuracy:
        return measure_accuracy(recordings, console, options.figure)
    return measure_speed(recordings[0], options.rounds, console)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks",
        description="CPU time in one thread, as medians and ratios; accuracy; consistency; tracking.",
    )
    parser.add_argument(
        "recordings",
        nargs="*",
        type=Path,
        metavar="RECORDING",
        help="folders of recordings; the sample that comes along if none. Speed takes the first.",
    )
    instead = parser.add_mutually_exclusive_group()
    instead.add_argument(
        "--accuracy", action="store_true", help="compare the methods on recordings with truth instead"
    )
    instead.add_argument(
        "--tracking", action="store_true", help="how long the tracker takes instead; needs no recording"
    )
    instead.add_argument(
        "--evaluation", action="store_true", help="what a second worker gives to palletloc evaluate --batch instead"
    )
    instead.add_argument(
        "--consistency",
        type=_count,
        metavar="SCENES",
        help="errors and covariances over so many synthetic scenes instead; needs no recording",
    )
    parser.add_argument(
        "--figure", type=Path, metavar="DIR", help="with --accuracy: draw methods_RECORDING.png there, too"
    )
    parser.add_argument("--rounds", type=_count, default=5, help="how often everything is timed (5)")
    _add_scenes(parser)
    form = parser.add_mutually_exclusive_group()
    form.add_argument("--json", dest="form", action="store_const", const="json", help="print as JSON")
    form.add_argument(
        "--markdown", dest="form", action="store_const", const="markdown", help="print as Markdown tables"
    )
    return parser


def _add_scenes(parser: argparse.ArgumentParser) -> None:
    scenes = parser.add_argument_group("consistency")
    scenes.add_argument("--seed", type=_seed, default=1000, help="of the first scene; the others follow (1000)")
    scenes.add_argument(
        "--method",
        dest="methods",
        action="append",
        default=[],
        type=Method,
        choices=list(Method),
        metavar="NAME",
        help=f"{', '.join(Method)}; may be repeated (the usual one if none)",
    )
    scenes.add_argument("--shots", type=_count, default=3, help="of each scene (3)")
    scenes.add_argument("--width", type=_count, help="of all images, in pixels, in place of what each scene draws")


def _count(text: str) -> int:
    if not (text.isdecimal() and int(text) > 0):
        raise argparse.ArgumentTypeError(f"expected a whole number from 1 on, got '{text}'")
    return int(text)


def _seed(text: str) -> int:
    if not text.isdecimal():
        raise argparse.ArgumentTypeError(f"expected a whole number from 0 on, got '{text}'")
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
