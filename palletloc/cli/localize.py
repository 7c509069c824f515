"""The command ``palletloc localize``."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING, Any

from palletloc.choices import Method
from palletloc.cli import options
from palletloc.cli.showing import Shown, progress, say, say_all, shows

if TYPE_CHECKING:
    from rich.table import Table

    from palletloc.io.run_folder import RunFolder
    from palletloc.measurement import PalletMeasurement, RefusedCandidate
    from palletloc.recording_run import Job, ShotOutcome

_COMMONEST = 5
"""How many reasons of refusals are put into words: the others are rare."""
_FARTHEST = 100.0
"""No pallet is measured from so far away, in metres."""
_MOST_ROWS = 200
"""How many poses are printed; measurements.csv has all of them."""


@shows
def localize(
    recording: options.RecordingFolder,
    out: options.OutFolder,
    initial: options.Starts = None,
    method: options.MethodName = Method.REFINED,
    config: options.Parameters = None,
    strict: options.Strict = False,
    resume: options.Resume = False,
    verbose: options.Verbose = False,
) -> Shown:
    """Measure the pallets in each shot of a recording.

    Writes measurements.csv, refusals.csv, run.json and the page overview.html. A shot that cannot be used is reported
    and skipped.
    """
    from palletloc.config import LocalizerConfig
    from palletloc.io.config_file import read_config
    from palletloc.io.folder_lock import locked
    from palletloc.io.run_folder import Run, RunFolder
    from palletloc.recording_run import read_job

    parameters = LocalizerConfig() if config is None else read_config(config)
    job = read_job(recording, method, parameters, initial)
    say_all(job.recording.notes)
    run = Run.of(job.recording, str(method), repr(parameters), initial)
    tally = Tally()
    output = RunFolder(out, run, recording, job.shots, resume=resume)
    chosen = {"--initial": initial, "--config": config, "--method": None if method is Method.REFINED else method}
    options = tuple(word for name, value in chosen.items() if value is not None for word in (name, str(value)))
    with locked(out):
        fill(output, job, tally, options, strict=strict, verbose=verbose)
        return _shown(output, job, tally)


def fill(
    output: RunFolder,
    job: Job,
    tally: Tally,
    options: Sequence[str] = (),
    *,
    strict: bool = False,
    verbose: bool = False,
) -> None:
    """Localize the pallets of every shot that is left to do, show how far that is, and write the page about them.

    Parameters
    ----------
    output : RunFolder
        Of the job's shots; not open yet.
    job : Job
        What to work through.
    tally : Tally
        Takes the counts.
    options : sequence of str
        Of a command that explains one of the shots in the same way.
    strict, verbose : bool
        As the command's options.

    Raises
    ------
    PalletLocError
        As `palletloc.recording_run.work_through`.
    """
    from palletloc.io.run_folder import JOURNAL
    from palletloc.report.overview_page import OVERVIEW

    try:
        with output:
            tally.done_before = output.done
            if output.damaged:
                place = output.folder / JOURNAL
                say(f"{place}: {output.damaged} damaged entries are left out; their shots are done anew")
            _follow(job, output, tally, strict=strict, verbose=verbose)
    except KeyboardInterrupt:
        if output.done:
            _overview(output, job, options)
            say(f"{output.done} of {len(job.shots)} shots are kept in {output.folder}; --resume goes on")
        raise
    if tally.durations or output.skipped or not (output.folder / OVERVIEW).exists():
        _overview(output, job, options)


def _overview(output: RunFolder, job: Job, options: Sequence[str]) -> None:
    """Write the page about all shots that are done, those of an earlier run included."""
    from palletloc.io.measurements import read_measurements, read_refusals
    from palletloc.io.run_folder import MEASUREMENTS, REFUSALS
    from palletloc.report.overview_page import RunOverview, write_overview

    rows, refusals = read_measurements(output.folder / MEASUREMENTS), read_refusals(output.folder / REFUSALS)
    left = frozenset(number for number, _ in output.remaining()).difference(output.skipped)
    overview = RunOverview(job.recording, job.shots, rows, refusals, output.skipped, left, tuple(options))
    write_overview(output.folder, overview)


def _shown(output: RunFolder, job: Job, tally: Tally) -> Shown:
    """Return what the command says of a run: poses, counts, and the commonest refusals in words."""
    from palletloc.io.measurements import NoPose, read_measurements, read_refusals
    from palletloc.io.run_folder import MEASUREMENTS, REFUSALS
    from palletloc.report.overview_page import OVERVIEW

    folder = output.folder
    rows, refusals = read_measurements(folder / MEASUREMENTS), read_refusals(folder / REFUSALS)
    found = [row for row in rows if not isinstance(row, NoPose)]
    document = {
        "out": folder,
        "overview": folder / OVERVIEW,
        "shots": {"done": output.done, "of": len(job.shots), "done_before": tally.done_before},
        "skipped": [{"file": job.shots[number].file, "why": why} for number, why in sorted(output.skipped.items())],
        "pallets": [_pose_document(row) for row in found],
        "starts_without_pose": len(rows) - len(found),
        "refused": _refused_document(refusals),
        "other_models": tally.better_models(),
        "seconds_per_shot": median(tally.durations) if tally.durations else None,
    }
    parts = [*_poses(found, job), tally.table(output.done, len(output.skipped)), *_in_words(refusals)]
    useless = _useless_starts(job, len(rows) - len(found), refusals)
    parts += [f"results: {folder}", f"look at {folder / OVERVIEW}"]
    return Shown(document, tuple(parts), useless, 1 if useless else 0)


def _useless_starts(job: Job, without_pose: int, refusals: Sequence[RefusedCandidate]) -> tuple[str, ...]:
    """Say where none of the given starts could even be tried, and not because of a range that somebody chose."""
    from palletloc.measurement import Reason, Stage

    starts = [start.forklift_from_pallet for given in job.given or () for start in given.starts]
    reasons = Counter(str(refusal.reason) for refusal in refusals if refusal.stage is Stage.START)
    if not starts or not without_pose == len(starts) == reasons.total():
        return ()
    in_reach = sum(math.hypot(start.x, start.y) < _FARTHEST for start in starts)
    if reasons[Reason.OUT_OF_RANGE] and in_reach:
        return ()
    counts = ", ".join(f"{reason} ({count})" for reason, count in reasons.most_common())
    hint = "" if in_reach else f", {_FARTHEST:g} m and farther away: millimetres?"
    return (f"--initial: none of {len(starts)} starts can be used: {counts}{hint}",)


def _pose_document(row: PalletMeasurement) -> dict[str, Any]:
    pose = row.forklift_from_pallet
    keys = ("x_m", "y_m", "z_m", "yaw_rad")
    sigma = dict(zip(keys, row.covariance.diagonal() ** 0.5, strict=True))
    return {
        "time_s": row.time,
        "file": row.file,
        "model": row.model,
        **dict(zip(keys, pose.as_array(), strict=True)),
        "sigma": sigma,
        "score": row.score,
    }


def _poses(found: Sequence[PalletMeasurement], job: Job) -> list[str | Table]:
    """Return the table of the poses, shot by shot; shots have the numbers that ``palletloc explain`` asks for."""
    from rich.text import Text

    from palletloc.cli.tables import POSE_HEADINGS, new_table, pose_cells

    if not found:
        return []
    numbers = {shot.time: number for number, shot in enumerate(job.recording.shots)}
    table = new_table(["shot", "model"], POSE_HEADINGS, title="poses in the forklift's frame")
    before = None
    for row in found[:_MOST_ROWS]:
        shot = "" if row.time == before else f"{numbers.get(row.time, '')} {Path(row.file).name}"
        table.add_row(Text(shot), Text(row.model), *pose_cells(row.forklift_from_pallet, row.covariance))
        before = row.time
    more = len(found) - _MOST_ROWS
    return [table, *([f"{more} more poses: measurements.csv has all of them"] if more > 0 else []), ""]


def _refused_document(refusals: Sequence[RefusedCandidate]) -> list[dict[str, Any]]:
    from palletloc.explained import IN_WORDS

    counts = Counter((str(refusal.stage), str(refusal.reason)) for refusal in refusals)
    return [
        {"stage": stage, "reason": reason, "count": count, "means": means, "do": remedy}
        for (stage, reason), count in counts.most_common()
        for means, remedy in [IN_WORDS.get(reason, ("", ""))]
    ]


def _in_words(refusals: Sequence[RefusedCandidate]) -> list[str]:
    """Return the commonest refusals in words, with what to do about them."""
    from palletloc.explained import IN_WORDS

    counts = Counter(str(refusal.reason) for refusal in refusals)
    lines = [
        f"  {reason} ({count}): {means}. To do: {remedy}."
        for reason, count in counts.most_common(_COMMONEST)
        for means, remedy in [IN_WORDS.get(reason, ("", ""))]
    ]
    return ["why places were given up, the commonest reasons first:", *lines, ""] if lines else []


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
    better: dict[tuple[str, str], list[float]] = field(default_factory=dict)
    """By stated model and the one that explains its places better: how much likelier it is there, in nats."""

    def add(self, outcome: ShotOutcome) -> None:
        """Count a shot, unless it was skipped."""
        if outcome.problem:
            return
        found = _found(outcome)
        self.pallets.update(found)
        self.without_pose += len(outcome.rows) - len(found)
        self.refusals.update(f"{refusal.stage}: {refusal.reason}" for refusal in outcome.refusals)
        self.durations.append(outcome.duration)
        for refusal in outcome.refusals:
            if refusal.better is not None:
                self.better.setdefault((refusal.model, refusal.better.name), []).append(refusal.better.nats)

    def better_models(self) -> list[dict[str, Any]]:
        """Return which models explain the places of stated ones better, the most frequent first, for a document."""
        pairs = sorted(self.better.items(), key=lambda pair: -len(pair[1]))
        return [
            {"stated": stated, "likelier": name, "places": len(nats), "nats": median(nats)}
            for (stated, name), nats in pairs
        ]

    def table(self, done: int, skipped: int) -> Table:
        """Return the counts for people to read.

        Parameters
        ----------
        done, skipped : int
            Shots of the whole run, those done before included.
        """
        from palletloc.cli.tables import plain_table

        table = plain_table()
        table.add_column()
        table.add_column()
        table.add_column(justify="right")
        table.add_row("shots", "done", str(done))
        if self.done_before:
            table.add_row("", "of them before; not counted below", str(self.done_before))
        table.add_row("", "skipped", str(skipped))
        if self.durations:
            _add_counts(table, "pallets", self.pallets)
            if self.without_pose:
                table.add_row("", "starts without a pose", str(self.without_pose))
            _add_counts(table, "refused", self.refusals)
            for position, pair in enumerate(self.better_models()):
                what = f"{pair['stated']}: rather {pair['likelier']}, by {pair['nats']:.1f} nats"
                table.add_row("" if position else "other model", what, str(pair["places"]))
            table.add_row("time", "per shot (median)", f"{median(self.durations):.2f} s")
        return table


def _add_counts(table: Table, title: str, counts: Counter[str]) -> None:
    rows = counts.most_common() or [("none", 0)]
    for position, (name, count) in enumerate(rows):
        table.add_row("" if position else title, name, str(count))


def _follow(job: Job, output: RunFolder, tally: Tally, *, strict: bool, verbose: bool) -> None:
    """Work through the shots; show how far that is where somebody is looking."""
    from palletloc.recording_run import work_through
    from palletloc.report.overview_page import thumbnail, write_thumbnail

    with progress("Localizing", len(job.shots), output.done) as advance:
        for outcome in work_through(job, output, strict=strict, draw=thumbnail):
            tally.add(outcome)
            if outcome.picture:
                write_thumbnail(output.folder, outcome.number, outcome.picture)
            if outcome.problem:
                say(f"skipped: {outcome.problem}")
            elif verbose:
                say(_summary(outcome))
            advance()


def _found(outcome: ShotOutcome) -> list[str]:
    """Return the models of the measured pallets."""
    from palletloc.io.measurements import NoPose

    return [row.model for row in outcome.rows if not isinstance(row, NoPose)]


def _summary(outcome: ShotOutcome) -> str:
    found = len(_found(outcome))
    refused = len(outcome.refusals)
    pallets = "1 pallet" if found == 1 else f"{found} pallets"
    return f"{outcome.shot.file}: {pallets}, {refused} refused, {outcome.duration:.2f} s"
