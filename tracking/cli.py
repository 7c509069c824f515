"""The commands ``palletloc track``, ``palletloc demo``, and ``palletloc config`` with the tracker's parameters."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich import box
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn
from rich.table import Table
from rich.text import Text

from palletloc.choices import Method

if TYPE_CHECKING:
    from palletloc.config import LocalizerConfig
    from palletloc.io.recording import Recording
    from palletloc.io.tracks import TrackRow
    from palletloc.io.truth import Truth
    from palletloc.measurement import PalletMeasurement
    from tracking.config import TrackerConfig
    from tracking.events import Event
    from tracking.recording import TrackedRecording

_ONLY_WITH_IMAGES = ("method", "strict", "resume", "verbose")
"""Options that say how to localize; they have no meaning where measurements are given."""


def track(
    context: typer.Context,
    recording: Annotated[Path, typer.Argument(metavar="RECORDING", help="Folder of the recording.")],
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder for the results; made if missing.")],
    method: Annotated[Method, typer.Option(help="How poses are measured.")] = Method.REFINED,
    config: Annotated[
        Path | None, typer.Option(metavar="YAML", help="Parameters of your own; see palletloc config.")
    ] = None,
    smooth: Annotated[
        bool, typer.Option("--smooth", help="Also write each track as all shots together know it.")
    ] = False,
    measurements: Annotated[
        Path | None, typer.Option(metavar="CSV", help="Track these measurements.csv; no image is read.")
    ] = None,
    strict: Annotated[bool, typer.Option("--strict", help="Stop at the first shot that cannot be used.")] = False,
    resume: Annotated[
        bool, typer.Option("--resume", help="Go on with an interrupted run; try its skipped shots again.")
    ] = False,
    verbose: Annotated[bool, typer.Option("--verbose", "-v", help="Say what each shot gives.")] = False,
) -> None:
    """Follow the pallets of a recording from shot to shot.

    Measures the pallets in each shot, as palletloc localize does, and fuses them with the odometry. Adds tracks.csv,
    the folder tracks, events.csv and the picture tracks.png to its files.
    """
    from palletloc.config import LocalizerConfig
    from palletloc.io.config_file import read_config
    from palletloc.io.recording import read_recording
    from tracking.config import TrackerConfig, read_tracker_config
    from tracking.recording import read_measured, write_run

    console = Console(stderr=True)
    parameters = LocalizerConfig() if config is None else read_config(config)
    tracker = TrackerConfig() if config is None else read_tracker_config(config)
    if measurements is not None:
        _refuse_others(context)
        given = read_recording(recording)
        for note in given.notes:
            console.print(Text(f"palletloc: {note}"), soft_wrap=True)
        truth = _truth_of(given)
        inputs = Inputs(given, read_measured(measurements, given))
    else:
        truth = _truth_of(read_recording(recording))
        inputs = _localized(recording, out, method, parameters, console, (strict, resume, verbose))
    run = _tracked(inputs, tracker, console, smooth=smooth)
    write_run(out, run, _picture(run, truth))
    stdout = Console()
    stdout.print(_table(run))
    for line in (_tally(inputs, run), f"results: {out}"):
        stdout.print(Text(line), soft_wrap=True)


def config(
    file: Annotated[
        Path | None,
        typer.Option("--file", metavar="YAML", help="Your own parameters; the others keep their defaults."),
    ] = None,
) -> None:
    """Print every parameter with its default.

    The output is YAML. Put it into a file, change what you like, delete the rest, and give the file to
    palletloc localize --config or palletloc track --config.
    """
    from palletloc.io.config_file import format_config, read_config
    from tracking.config import format_tracker_config, read_tracker_config

    parameters = None if file is None else read_config(file)
    tracker = None if file is None else read_tracker_config(file)
    typer.echo(f"{format_config(parameters)}\n{format_tracker_config(tracker)}", nl=False)


def demo(
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder for the results; made if missing.")] = Path(
        "palletloc-demo"
    ),
) -> None:
    """Localize, track and evaluate the sample that comes along.

    Writes what palletloc localize, track, evaluate and explain write, and index.html, which shows and links it all.
    """
    from tracking.demo import run_demo

    run_demo(out)


@dataclass(frozen=True, slots=True, eq=False)
class Inputs:
    """What the tracker gets."""

    recording: Recording
    """The recording."""
    measured: tuple[PalletMeasurement, ...]
    """Its measurements."""
    unread: tuple[float, ...] = ()
    """Times of the shots that could not be used, in seconds."""


def _refuse_others(context: typer.Context) -> None:
    """Refuse options that say how to localize, where nothing is localized."""
    for name in _ONLY_WITH_IMAGES:
        source = context.get_parameter_source(name)
        if source is not None and source.name != "DEFAULT":
            raise typer.BadParameter(f"--{name} has no meaning together with --measurements", context)


def _truth_of(recording: Recording) -> Truth | None:
    """Return the truth for the picture, where it has a path; its faults are found before the work begins."""
    from palletloc.io.truth import path_file, read_truth

    return read_truth(recording.folder, recording.truth_form) if path_file(recording.folder) else None


def _localized(
    folder: Path,
    out: Path,
    method: Method,
    parameters: LocalizerConfig,
    console: Console,
    how: tuple[bool, bool, bool],
) -> Inputs:
    """Localize the pallets of a recording, and take their poses from the file, as a later run would."""
    from palletloc.cli.localize import Tally, fill
    from palletloc.io.run_folder import MEASUREMENTS, Run, RunFolder
    from palletloc.recording_run import read_job
    from tracking.files import remove_run
    from tracking.recording import read_measured

    strict, resume, verbose = how
    job = read_job(folder, method, parameters)
    run = Run.of(job.recording, str(method), repr(parameters))
    output = RunFolder(out, run, folder, job.shots, resume=resume)
    try:
        fill(output, job, Tally(), console, strict=strict, verbose=verbose)
    except KeyboardInterrupt:
        if output.done:
            remove_run(out)  # tracks of other measurements than those that are there now
        raise
    unread = tuple(job.shots[number].time for number in sorted(output.skipped))
    return Inputs(job.recording, read_measured(out / MEASUREMENTS, job.recording), unread)


def _tracked(inputs: Inputs, config: TrackerConfig, console: Console, *, smooth: bool) -> TrackedRecording:
    from tracking.recording import track_recording

    columns = (TextColumn("Tracking"), BarColumn(), MofNCompleteColumn())
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as progress:
        bar = progress.add_task("", total=len(inputs.recording.shots))
        return track_recording(
            inputs.recording,
            inputs.measured,
            config,
            inputs.unread,
            smooth=smooth,
            follow=lambda _: progress.advance(bar),
        )


def _picture(run: TrackedRecording, truth: Truth | None) -> bytes:
    from palletloc.drawing.canvas import png  # drawing is slow to import
    from tracking.figure import track_deviations, track_figure

    name = run.recording.folder.resolve().name or "a recording"
    return png(track_figure(track_deviations(run, truth), name))


def _table(run: TrackedRecording) -> Table:
    """Return the tracks as they were last known."""
    from tracking.events import EventKind

    table = Table(box=box.SIMPLE_HEAD, padding=0, show_edge=False)
    for heading in ("", "model", "state"):
        table.add_column(heading, no_wrap=True)
    plus_minus = "\N{PLUS-MINUS SIGN}"
    for heading in ("hits", f"x m {plus_minus}mm", "y", "z", "yaw \N{DEGREE SIGN}"):
        table.add_column(heading, justify="right", no_wrap=True)
    last = {row.track: row for row in run.rows}
    lost = {event.track for event in run.events if event.kind is EventKind.LOST}
    troubles = {number: _troubles(run.events, number) for number in last}
    if any(troubles.values()):
        table.add_column("events")
    for number, row in sorted(last.items()):
        state = "lost" if number in lost else str(row.status)
        cells = [str(number), row.model, state, str(row.hits), *_pose(row), troubles[number]]
        table.add_row(*cells[: len(table.columns)])
    return table


def _pose(row: TrackRow) -> list[str]:
    import numpy as np

    pose, sigma = row.pose, np.sqrt(np.maximum(np.diag(row.covariance), 0.0))
    places = zip((pose.x, pose.y, pose.z), 1000 * sigma[:3], strict=True)
    cells = [f"{value:.3f} \N{PLUS-MINUS SIGN}{sigma_mm:.{1 if sigma_mm < 10 else 0}f}" for value, sigma_mm in places]
    return [*cells, f"{np.degrees(pose.yaw):.2f} \N{PLUS-MINUS SIGN}{np.degrees(sigma[3]):.2f}"]


def _troubles(events: Iterable[Event], number: int) -> str:
    """Return what happened to a track beyond the ordinary."""
    from tracking.events import EventKind

    ordinary = {EventKind.ACCEPTED, EventKind.BORN, EventKind.CONFIRMED, EventKind.LOST}
    counts = Counter(str(event.kind) for event in events if event.track == number and event.kind not in ordinary)
    return ", ".join(f"{count} {kind}" for kind, count in counts.items())


def _tally(inputs: Inputs, run: TrackedRecording) -> str:
    """Return what became of shots and measurements in one line."""
    from palletloc.track_status import Status
    from tracking.events import EventKind

    fates = Counter(event.kind for event in run.events)
    used = sum(event.kind is EventKind.ACCEPTED and not event.revised for event in run.events)
    counts = [f"{len(inputs.recording.shots)} shots"]
    counts += [f"{len(inputs.unread)} of them not usable"] if inputs.unread else []
    counts.append(f"{len(inputs.measured)} measurements, {used} used")
    kinds = (EventKind.GATED, EventKind.REJECTED, EventKind.TOO_LATE, EventKind.DUPLICATE)
    counts += [f"{fates[kind]} {kind.replace('_', ' ')}" for kind in kinds if fates[kind]]
    confirmed = {row.track for row in run.rows if row.status is not Status.TENTATIVE}
    return ", ".join(counts) + f"; {len(confirmed)} tracks confirmed"
