"""The command ``palletloc explain``."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from palletloc.choices import Method
from palletloc.errors import PalletLocError

if TYPE_CHECKING:
    from palletloc.localizer import Explanation
    from palletloc.recording_run import Job

_HEADINGS = (
    *("x m", "y m", "z m", "\N{PLUS-MINUS SIGN} mm", "yaw \N{DEGREE SIGN}"),
    "\N{PLUS-MINUS SIGN} \N{DEGREE SIGN}",
)
"""Of the columns of numbers."""


def explain(
    recording: Annotated[Path, typer.Argument(metavar="RECORDING", help="Folder of the recording.")],
    shot: Annotated[int, typer.Option(metavar="I", help="Number of the shot; the first is 0.")],
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder for the pictures; made if missing.")],
    initial: Annotated[
        Path | None, typer.Option(metavar="CSV", help="Start from these poses instead of detecting pallets.")
    ] = None,
    method: Annotated[Method, typer.Option(help="How poses are measured.")] = Method.REFINED,
    config: Annotated[
        Path | None, typer.Option(metavar="YAML", help="Parameters of your own; see palletloc config.")
    ] = None,
    refused: Annotated[bool, typer.Option("--refused", help="Draw the steps of what was given up, too.")] = False,
) -> None:
    """Draw every stage of the localization of one shot.

    Writes pictures, numbered in the order of the stages, and explain.json with all numbers. Pictures that an
    earlier call left in the folder are replaced.
    """
    from palletloc.config import LocalizerConfig
    from palletloc.io.config_file import read_config
    from palletloc.recording_run import read_job

    parameters = LocalizerConfig() if config is None else read_config(config)
    job = _single(read_job(recording, method, parameters, initial), shot)
    explanation = job.explain(0)
    console = Console()
    with console.status("Drawing"):
        from palletloc.report.explanation_folder import write_explanation  # drawing is slow to import

        write_explanation(job, explanation, out, with_refused=refused or initial is not None)
    console.print(_table(explanation))
    _print_refusals(console, explanation)
    console.print(Text(f"pictures and explain.json: {out}"), soft_wrap=True)


def _single(job: Job, number: int) -> Job:
    """Return the job reduced to one shot of the recording."""
    from palletloc.io.starts import ShotStarts

    shots = job.recording.shots
    if not 0 <= number < len(shots):
        raise PalletLocError(
            f"--shot {number}: {job.recording.folder} has {len(shots)} shots; expected 0 to {len(shots) - 1}"
        )
    shot = shots[number]
    if job.given is None:
        return replace(job, recording=replace(job.recording, shots=(shot,)))
    starts = tuple(start for given in job.given if given.shot == shot for start in given.starts)
    if not starts:
        raise PalletLocError(f"--shot {number}: no start has the time of this shot, {shot.time:.6g} s")
    return replace(job, given=(ShotStarts(shot, starts),))


def _table(explanation: Explanation) -> Table:
    import numpy as np

    from palletloc.candidate import Refusal
    from palletloc.explained import name_candidates

    table = Table(box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0))
    table.add_column("", no_wrap=True)
    table.add_column("model")
    for heading in _HEADINGS:
        table.add_column(heading, justify="right", no_wrap=True)
    table.add_column("yaw from")
    for name, fit in name_candidates(explanation):
        if isinstance(fit, Refusal):
            continue
        sigma = np.sqrt(np.diag(fit.covariance))
        table.add_row(
            name,
            Text(fit.candidate.model.name),
            *(f"{round(value, 3) + 0.0:.3f}" for value in (fit.pose.x, fit.pose.y, fit.pose.z)),
            ", ".join(f"{1000 * value:.0f}" for value in sigma[:3]),
            f"{np.degrees(fit.pose.yaw):.2f}",
            f"{np.degrees(sigma[3]):.2f}",
            str(fit.yaw_from),
        )
    return table


def _print_refusals(console: Console, explanation: Explanation) -> None:
    """Say how many candidates were given up in which step, and why."""
    counts = Counter(f"{refusal.stage}: {refusal.reason}" for refusal in explanation.refusals)
    total = sum(counts.values())
    listed = ", ".join(f"{count} {reason}" for reason, count in counts.most_common())
    console.print(Text(f"given up: {total} ({listed})" if total else "given up: none"), soft_wrap=True)
