"""The commands ``palletloc track``, ``palletloc demo``, and ``palletloc config`` with the tracker's parameters."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from palletloc.choices import Method
from palletloc.cli import options
from palletloc.cli.help import FLAG, INPUT, RESULTS
from palletloc.cli.showing import Shown, progress, say_all, shows

if TYPE_CHECKING:
    from rich.table import Table

    from palletloc.io.recording import Recording
    from palletloc.io.tracks import TrackRow
    from palletloc.io.truth import Truth
    from palletloc.measurement import PalletMeasurement
    from palletloc.recording_run import Job
    from tracking.config import TrackerConfig
    from tracking.events import Event
    from tracking.recording import TrackedRecording

_ONLY_WITH_IMAGES = ("method", "strict", "resume", "verbose")
"""Options that say how to localize; they have no meaning where measurements are given."""


@shows
def track(
    context: typer.Context,
    recording: options.RecordingFolder,
    out: options.OutFolder,
    method: options.MethodName = Method.REFINED,
    config: options.Parameters = None,
    smooth: Annotated[
        bool,
        typer.Option(
            "--smooth",
            metavar=FLAG,
            rich_help_panel=RESULTS,
            help="Also write each track as all shots together know it.",
        ),
    ] = False,
    measurements: Annotated[
        Path | None,
        typer.Option(metavar="CSV", rich_help_panel=INPUT, help="Track these measurements.csv; no image is read."),
    ] = None,
    strict: options.Strict = False,
    resume: options.Resume = False,
    verbose: options.Verbose = False,
) -> Shown:
    """Follow the pallets of a recording from shot to shot.

    Measures the pallets in each shot, as palletloc localize does, and fuses them with the odometry. Adds tracks.csv,
    the folder tracks, events.csv and the picture tracks.png to its files.
    """
    from palletloc.config import LocalizerConfig
    from palletloc.io.config_file import read_config
    from palletloc.io.folder_lock import locked
    from palletloc.io.recording import read_recording
    from palletloc.mounting_yaw import seen_turn, turn_document, turn_lines
    from palletloc.recording_run import read_job
    from palletloc.report.overview_page import OVERVIEW
    from tracking.config import TrackerConfig, read_tracker_config
    from tracking.recording import check_used, read_measured, write_run

    parameters = LocalizerConfig() if config is None else read_config(config)
    tracker = TrackerConfig() if config is None else read_tracker_config(config)
    if measurements is not None:
        _refuse_others(context)
        given = read_recording(recording)
        say_all(given.notes)
        truth = _truth_of(given)
        inputs: Inputs | None = Inputs(given, read_measured(measurements, given))
    else:
        job = read_job(recording, method, parameters)
        say_all(job.recording.notes)
        truth = _truth_of(job.recording)
        inputs = None
    with locked(out):
        if inputs is None:
            inputs = _localized(job, out, (strict, resume, verbose), config)
        run = _tracked(inputs, tracker, smooth=smooth)
        check_used(run)
        write_run(out, run, _picture(run, truth))
    turn = seen_turn(inputs.measured, inputs.recording.odometry, inputs.recording.forklift_from_camera)
    document = {**_document(inputs, run, out), **turn_document(turn)}
    pages = [f"look at {out / OVERVIEW}"] if measurements is None else []
    return Shown(document, (_table(run), _tally(inputs, run), f"results: {out}", *pages), turn_lines(turn))


@shows
def config(
    file: Annotated[
        Path | None,
        typer.Option("--file", metavar="YAML", help="Your own parameters; the others keep their defaults."),
    ] = None,
) -> Shown:
    """Print every parameter with its default.

    The output is YAML. Put it into a file, change what you like, delete the rest, and give the file to
    palletloc localize --config or palletloc track --config.
    """
    import yaml

    from palletloc.io.config_file import format_config, read_config
    from tracking.config import format_tracker_config, read_tracker_config

    parameters = None if file is None else read_config(file)
    tracker = None if file is None else read_tracker_config(file)
    text = f"{format_config(parameters)}\n{format_tracker_config(tracker)}"
    return Shown(yaml.safe_load(text), (text.rstrip("\n"),))


@shows
def demo(out: options.OutFolder = Path("palletloc-demo")) -> Shown:
    """Localize, track and evaluate the sample that comes along.

    Writes what palletloc localize, track, evaluate and explain write, and index.html, which shows and links it all.
    """
    from tracking.demo import run_demo

    return run_demo(out)


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


def _localized(job: Job, out: Path, how: tuple[bool, bool, bool], config: Path | None) -> Inputs:
    """Localize the pallets of a recording, and take their poses from the file, as a later run would."""
    from palletloc.cli.localize import Tally, fill
    from palletloc.io.run_folder import MEASUREMENTS, Run, RunFolder
    from tracking.files import remove_run
    from tracking.recording import read_measured

    (strict, resume, verbose), method = how, job.localizer.method
    run = Run.of(job.recording, str(method), repr(job.localizer.config))
    output = RunFolder(out, run, job.recording.folder, job.shots, resume=resume)
    try:
        options = [] if config is None else ["--config", str(config)]
        options += [] if method is Method.REFINED else ["--method", str(method)]
        fill(output, job, Tally(), options, strict=strict, verbose=verbose)
    except KeyboardInterrupt:
        if output.done:
            remove_run(out)  # tracks of other measurements than those that are there now
        raise
    unread = tuple(job.shots[number].time for number in sorted(output.skipped))
    return Inputs(job.recording, read_measured(out / MEASUREMENTS, job.recording), unread)


def _tracked(inputs: Inputs, config: TrackerConfig, *, smooth: bool) -> TrackedRecording:
    from tracking.recording import track_recording

    with progress("Tracking", len(inputs.recording.shots)) as advance:
        return track_recording(
            inputs.recording, inputs.measured, config, inputs.unread, smooth=smooth, follow=lambda _: advance()
        )


def _picture(run: TrackedRecording, truth: Truth | None) -> bytes:
    from palletloc.drawing.canvas import png  # drawing is slow to import
    from tracking.figure import track_deviations, track_figure

    name = run.recording.folder.resolve().name or "a recording"
    return png(track_figure(track_deviations(run, truth), name))


def _table(run: TrackedRecording) -> Table:
    """Return the tracks as they were last known."""
    from rich.text import Text

    from palletloc.cli.tables import POSE_HEADINGS, new_table, pose_cells

    last = {row.track: row for row in run.rows}
    troubles = {number: _troubles(run.events, number) for number in last}
    table = new_table(["", "model", "state"], ["hits", *POSE_HEADINGS], ["events"] if any(troubles.values()) else [])
    for number, row in sorted(last.items()):
        poses = pose_cells(row.pose, row.covariance)
        cells: list[str | Text] = [
            str(number),
            Text(row.model),
            _state(run, row),
            str(row.hits),
            *poses,
            troubles[number],
        ]
        table.add_row(*cells[: len(table.columns)])
    return table


def _state(run: TrackedRecording, row: TrackRow) -> str:
    """Return what became of a track."""
    from tracking.events import EventKind

    lost = any(event.track == row.track and event.kind is EventKind.LOST for event in run.events)
    return "lost" if lost else str(row.status)


def _document(inputs: Inputs, run: TrackedRecording, out: Path) -> dict[str, Any]:
    """Return the same in plain values."""
    fates = Counter(str(event.kind) for event in run.events)
    keys = ("x_m", "y_m", "z_m", "yaw_rad")
    tracks = [
        {
            "track": number,
            "model": row.model,
            "state": _state(run, row),
            "hits": row.hits,
            "time_s": row.time,
            **dict(zip(keys, row.pose.as_array(), strict=True)),
            "sigma": dict(zip(keys, abs(row.covariance.diagonal()) ** 0.5, strict=True)),
            "events": _troubles(run.events, number),
        }
        for number, row in sorted({row.track: row for row in run.rows}.items())
    ]
    return {
        "out": out,
        "shots": len(inputs.recording.shots),
        "not_usable": len(inputs.unread),
        "measurements": len(inputs.measured),
        "events": fates,
        "tracks": tracks,
        "summary": _tally(inputs, run),
    }


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
