"""The command ``palletloc explain``."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING, Annotated

import typer

from palletloc.choices import Method
from palletloc.cli import options
from palletloc.cli.help import FLAG, INPUT, RESULTS
from palletloc.cli.showing import Shown, say_all, shows, working
from palletloc.errors import PalletLocError

if TYPE_CHECKING:
    from rich.table import Table

    from palletloc.explained import Named
    from palletloc.recording_run import Job


@shows
def explain(
    recording: options.RecordingFolder,
    shot: Annotated[
        int, typer.Option(metavar="I", rich_help_panel=INPUT, help="Number of the shot; the first is 0.")
    ],
    out: options.OutFolder,
    initial: options.Starts = None,
    method: options.MethodName = Method.REFINED,
    config: options.Parameters = None,
    refused: Annotated[
        bool,
        typer.Option(
            "--refused/--no-refused",
            metavar=FLAG,
            rich_help_panel=RESULTS,
            help="Whether to draw the steps of what was given up, too.",
        ),
    ] = True,
) -> Shown:
    """Draw every stage of the localization of one shot.

    Writes pictures, numbered in the order of the stages, the page explain.html with all of them and with what spoke
    against what was given up, and explain.json with all numbers. Pictures that an earlier call left in the folder are
    replaced.
    """
    from palletloc.config import LocalizerConfig
    from palletloc.explained import name_candidates
    from palletloc.io.config_file import read_config
    from palletloc.recording_run import read_job

    parameters = LocalizerConfig() if config is None else read_config(config)
    job = _single(read_job(recording, method, parameters, initial), shot)
    say_all(job.recording.notes)
    explanation = job.explain(0)
    with working("Drawing"):
        from palletloc.report.explanation_folder import PAGE, write_explanation  # drawing is slow to import

        written = write_explanation(job, explanation, out, with_refused=refused or initial is not None)
    named = name_candidates(explanation)
    parts = (_table(named), *_refused(named), "", f"pictures and explain.json: {out}", f"look at {out / PAGE}")
    return Shown({"out": out, "page": out / PAGE, **written.document}, parts)


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


def _table(named: Named) -> Table:
    from rich.text import Text

    from palletloc.candidate import Fit
    from palletloc.cli.tables import POSE_HEADINGS, new_table, pose_cells

    table = new_table(["", "model"], POSE_HEADINGS, ["yaw from"])
    for name, fit in named:
        if isinstance(fit, Fit):
            cells = (*pose_cells(fit.pose, fit.covariance), str(fit.yaw_from))
            table.add_row(name, Text(fit.candidate.model.name), *cells)
    return table


def _refused(named: Named) -> Iterator[str | Table]:
    """Yield how many candidates were given up and why, and what spoke against those that had a pose."""
    from rich.text import Text

    from palletloc.candidate import Refusal
    from palletloc.cli.tables import new_table
    from palletloc.explained import spoke_against

    refusals = [(name, refusal) for name, refusal in named if isinstance(refusal, Refusal)]
    counts = Counter(f"{refusal.stage}: {refusal.reason}" for _, refusal in refusals)
    listed = ", ".join(f"{count} {reason}" for reason, count in counts.most_common())
    yield f"given up: {len(refusals)} ({listed})" if refusals else "given up: none"
    table = new_table(["", "model", "reason", "what spoke against it"])
    for name, refusal in refusals:
        if refusal.fit is not None:
            cells = (refusal.candidate.model.name, str(refusal.reason), spoke_against(refusal))
            table.add_row(name, *(Text(cell) for cell in cells))
    if table.rows:
        yield from ("", table)
