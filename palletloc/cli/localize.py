"""The command ``palletloc localize``."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING, Annotated

import typer
from rich import box
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table
from rich.text import Text

from palletloc.choices import Method

if TYPE_CHECKING:
    from palletloc.io.run_folder import RunFolder
    from palletloc.recording_run import Job, ShotOutcome


def localize(
    recording: Annotated[Path, typer.Argument(metavar="RECORDING", help="Folder of the recording.")],
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder for the results; made if missing.")],
    initial: Annotated[
        Path | None, typer.Option(metavar="CSV", help="Start from these poses instead of detecting pallets.")
    ] = None,
    method: Annotated[Method, typer.Option(help="How poses are measured.")] = Method.REFINED,
    config: Annotated[
        Path | None, typer.Option(metavar="YAML", help="Parameters of your own; see palletloc config.")
    ] = None,
    strict: Annotated[bool, typer.Option("--strict", help="Stop at the first shot that cannot be used.")] = False,
    resume: Annotated[
        bool, typer.Option("--resume", help="Go on with an interrupted run; try its skipped shots again.")
    ] = False,
    verbose: Annotated[bool, typer.Option("--verbose", "-v", help="Say what each shot gives.")] = False,
) -> None:
    """Measure the pallets in each shot of a recording.

    Writes measurements.csv, refusals.csv and run.json. A shot that cannot be used is reported and skipped.
    """
    from palletloc.config import LocalizerConfig
    from palletloc.io.config_file import read_config
    from palletloc.io.run_folder import Run, RunFolder
    from palletloc.recording_run import read_job

    parameters = LocalizerConfig() if config is None else read_config(config)
    job = read_job(recording, method, parameters, initial)
    run = Run.of(job.recording, str(method), repr(parameters), initial)
    console = Console(stderr=True)
    tally = Tally()
    output = RunFolder(out, run, recording, job.shots, resume=resume)
    fill(output, job, tally, console, strict=strict, verbose=verbose)
    stdout = Console()
    stdout.print(tally.table(output.done, len(output.skipped)))
    stdout.print(Text(f"results: {out}"), soft_wrap=True)


def fill(
    output: RunFolder, job: Job, tally: Tally, console: Console, *, strict: bool = False, verbose: bool = False
) -> None:
    """Localize the pallets of every shot that is left to do, and show how far that is.

    Parameters
    ----------
    output : RunFolder
        Of the job's shots; not open yet.
    job : Job
        What to work through.
    tally : Tally
        Takes the counts.
    console : Console
        For progress and warnings.
    strict, verbose : bool
        As the command's options.

    Raises
    ------
    PalletLocError
        As `palletloc.recording_run.work_through`.
    """
    for note in job.recording.notes:
        _say(console, note)
    try:
        with output:
            tally.done_before = output.done
            _follow(job, output, tally, console, strict=strict, verbose=verbose)
    except KeyboardInterrupt:
        if output.done:
            kept = f"{output.done} of {len(job.shots)} shots are kept in {output.folder}"
            _say(console, f"{kept}; --resume goes on")
        raise


@dataclass(slots=True)
class Tally:
    """Counts of what the shots gave."""

    done_before: int = 0
    """Shots that an earlier run had done; nothing else counts them."""
    pallets: Counter[str] = field(default_factory=Counter)
    """Measured pallets by model."""
    without_pose: int = 0
    """Given starts from which none was found."""
    refusals: Counter[str] = field(default_factory=Counter)
    """Candidates given up by stage and reason."""
    durations: list[float] = field(default_factory=list)
    """Time of each shot, in seconds."""

    def add(self, outcome: ShotOutcome) -> None:
        """Count a shot, unless it was skipped."""
        if outcome.problem:
            return
        found = _found(outcome)
        self.pallets.update(found)
        self.without_pose += len(outcome.rows) - len(found)
        self.refusals.update(f"{refusal.stage}: {refusal.reason}" for refusal in outcome.refusals)
        self.durations.append(outcome.duration)

    def table(self, done: int, skipped: int) -> Table:
        """Return the counts for people to read.

        Parameters
        ----------
        done, skipped : int
            Shots of the whole run, those done before included.
        """
        table = Table(show_header=False, show_edge=False, box=box.SIMPLE)
        table.add_column(no_wrap=True)
        table.add_column(no_wrap=True)
        table.add_column(justify="right", no_wrap=True)
        table.add_row("shots", "done", str(done))
        if self.done_before:
            table.add_row("", "of them before; not counted below", str(self.done_before))
        table.add_row("", "skipped", str(skipped))
        if self.durations:
            _add_counts(table, "pallets", self.pallets)
            if self.without_pose:
                table.add_row("", "starts without a pose", str(self.without_pose))
            _add_counts(table, "refused", self.refusals)
            table.add_row("time", "per shot (median)", f"{median(self.durations):.2f} s")
        return table


def _add_counts(table: Table, title: str, counts: Counter[str]) -> None:
    rows = counts.most_common() or [("none", 0)]
    for position, (name, count) in enumerate(rows):
        table.add_row("" if position else title, Text(name), str(count))


def _follow(job: Job, output: RunFolder, tally: Tally, console: Console, *, strict: bool, verbose: bool) -> None:
    """Work through the shots; show how far that is where somebody is looking."""
    from palletloc.recording_run import work_through

    columns = (TextColumn("Localizing"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as progress:
        bar = progress.add_task("", total=len(job.shots), completed=output.done)
        for outcome in work_through(job, output, strict=strict):
            tally.add(outcome)
            if outcome.problem:
                _say(console, f"skipped: {outcome.problem}")
            elif verbose:
                _say(console, _summary(outcome))
            progress.advance(bar)


def _found(outcome: ShotOutcome) -> list[str]:
    """Return the models of the measured pallets."""
    from palletloc.io.measurements import NoPose

    return [row.model for row in outcome.rows if not isinstance(row, NoPose)]


def _summary(outcome: ShotOutcome) -> str:
    found = len(_found(outcome))
    refused = len(outcome.refusals)
    pallets = "1 pallet" if found == 1 else f"{found} pallets"
    return f"{outcome.shot.file}: {pallets}, {refused} refused, {outcome.duration:.2f} s"


def _say(console: Console, line: str) -> None:
    console.print(Text(f"palletloc: {line}"), soft_wrap=True)
