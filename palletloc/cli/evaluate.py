"""The command ``palletloc evaluate``."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from palletloc.choices import MAX_RANGE, NEAREST_LIMIT, TimeRule
from palletloc.cli import options
from palletloc.cli.help import FLAG, INPUT, MANY, REQUIREMENT, RESULTS
from palletloc.cli.showing import Shown, shows
from palletloc.errors import PalletLocError


@shows
def evaluate(
    estimate: Annotated[
        list[Path],
        typer.Option(
            metavar="DIR",
            rich_help_panel=INPUT,
            help="Folder of a run: measurements.csv and, if there, tracks.csv; may be repeated."
            " With --batch relative to each recording.",
        ),
    ],
    out: options.OutFolder,
    recording: Annotated[
        Path | None, typer.Argument(metavar="[RECORDING]", help="Folder of the recording, with its truth.")
    ] = None,
    batch: Annotated[
        Path | None,
        typer.Option(
            rich_help_panel=MANY, metavar="DIR", help="Evaluate every recording in this folder, in parallel."
        ),
    ] = None,
    workers: Annotated[
        int | None,
        typer.Option(rich_help_panel=MANY, metavar="N", min=1, help="With --batch: how many processes to start."),
    ] = None,
    scheduler: Annotated[
        str | None,
        typer.Option(rich_help_panel=MANY, metavar="ADDRESS", help="With --batch: use this Dask scheduler instead."),
    ] = None,
    max_range: Annotated[
        float,
        typer.Option(
            rich_help_panel=REQUIREMENT, metavar="M", help="Farthest pallet that has to be found, in metres."
        ),
    ] = MAX_RANGE,
    pair: Annotated[
        TimeRule,
        typer.Option(
            rich_help_panel=INPUT,
            metavar="NAME",
            help=f"How the truth is taken for a shot's time: {', '.join(TimeRule)}.",
        ),
    ] = TimeRule.NEAREST,
    pair_limit: Annotated[
        float | None,
        typer.Option(
            rich_help_panel=INPUT,
            metavar="S",
            help="Largest time to the nearest sample, or between the samples on both sides.",
        ),
    ] = None,
    columns: options.SurveyColumns = None,
    stop_limit: Annotated[
        float,
        typer.Option(
            rich_help_panel=INPUT, metavar="S", help="How far a shot may be from the time of a surveyed stop."
        ),
    ] = NEAREST_LIMIT,
    requirement_yaw_deg: Annotated[
        float,
        typer.Option(rich_help_panel=REQUIREMENT, metavar="DEG", help="Largest error of the yaw that is allowed."),
    ] = 2.0,
    requirement_mm: Annotated[
        float,
        typer.Option(
            rich_help_panel=REQUIREMENT,
            metavar="MM",
            help="Largest error of depth, along and height that is allowed.",
        ),
    ] = 20.0,
    no_pictures: Annotated[
        bool,
        typer.Option(
            "--no-pictures",
            metavar=FLAG,
            rich_help_panel=RESULTS,
            help="Leave the images of the worst shots out of the report.",
        ),
    ] = False,
) -> Shown:
    """Hold measured poses against the truth of a recording.

    Writes metrics.json, errors.csv and report.html.
    """
    from palletloc.cli.evaluation import BatchWork, evaluate_batch, evaluate_one, settings_of
    from palletloc.evaluation.batch import find_jobs

    settings = settings_of(max_range, pair, pair_limit, stop_limit, requirement_yaw_deg, requirement_mm)
    if batch is not None and recording is None:
        if columns is not None:
            raise typer.BadParameter("goes with one RECORDING; state it in each survey.yaml", param_hint="--columns")
        _check_batch(estimate, workers, scheduler)
        jobs = find_jobs(batch, [str(name) for name in estimate], out, settings)
        work = BatchWork(workers, scheduler, with_pictures=not no_pictures)
        return evaluate_batch(jobs, batch, out, work)
    if recording is None or batch is not None:
        raise typer.BadParameter("expected either RECORDING or --batch DIR", param_hint="RECORDING")
    if workers is not None or scheduler is not None:
        raise typer.BadParameter("go with --batch DIR only", param_hint="--workers, --scheduler")
    return evaluate_one(recording, estimate, out, settings, columns, with_pictures=not no_pictures)


def _check_batch(estimates: Sequence[Path], workers: int | None, scheduler: str | None) -> None:
    if workers is not None and scheduler is not None:
        raise typer.BadParameter("a scheduler has its own workers; expected one of them", param_hint="--workers")
    for name in estimates:
        if name.is_absolute():
            raise typer.BadParameter(
                f"with --batch expected a name in each recording, got {name}", param_hint="--estimate"
            )
    if len(set(estimates)) < len(estimates):
        raise PalletLocError("--estimate: a run is given twice; expected different runs")
