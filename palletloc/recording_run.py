"""A recording, shot by shot: where the shelf is, what stands there, and which shots cannot be used."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter

from palletloc.candidate import Fit
from palletloc.choices import Method
from palletloc.config import LocalizerConfig
from palletloc.errors import PalletLocError, nearest_name
from palletloc.io.csv_table import read_rows, shortened
from palletloc.io.measurements import NoPose
from palletloc.io.recording import Recording, ShotError, ShotFile, check_shelf, read_recording
from palletloc.io.run_folder import RunFolder
from palletloc.io.starts import START_COLUMNS, ShotStarts, read_starts
from palletloc.localizer import Explanation, Localizer, Start
from palletloc.measurement import PalletMeasurement, RefusedCandidate
from palletloc.shelf_view import ShelfPlaneError
from palletloc.trajectory import TrajectoryError


@dataclass(frozen=True, slots=True, eq=False)
class Job:
    """A recording with the localizer that works through it."""

    recording: Recording
    """The recording."""
    localizer: Localizer
    """For its camera and pallets."""
    given: tuple[ShotStarts, ...] | None = None
    """Starts in place of detections; None to detect."""

    @property
    def shots(self) -> tuple[ShotFile, ...]:
        """What there is to do; with given starts in the order of their file, where a shot may come back."""
        return self.recording.shots if self.given is None else tuple(given.shot for given in self.given)

    def explain(self, number: int) -> Explanation:
        """Read a shot and localize its pallets.

        Parameters
        ----------
        number : int
            Index into `shots`.

        Returns
        -------
        Explanation
            What was found in it, stage by stage.

        Raises
        ------
        ImageError
            If the image cannot be read.
        ShotError
            If the odometry does not reach it, or the camera is not before the shelf.
        """
        shot = self.recording.shot(self.shots[number])
        if self.given is not None:
            starts = [Start(start.model, start.forklift_from_pallet) for start in self.given[number].starts]
            return self.localizer.explain_from(shot, starts, self.recording.shelf.levels)
        shelf = self.recording.shelf_at(shot.time, self.localizer.config.prior)
        try:
            return self.localizer.explain(shot, shelf)
        except ShelfPlaneError as error:
            raise ShotError(f"{self.recording.folder / shot.file}: {error}") from error

    def rows(self, explanation: Explanation) -> list[PalletMeasurement | NoPose]:
        """Return a shot's rows of measurements.csv: with given starts, one for each in order."""
        if self.given is None:
            return list(explanation.measurements)
        shot = explanation.shot
        return [
            outcome.measurement(shot)
            if isinstance(outcome, Fit)
            else NoPose(shot.time, outcome.candidate.model.name, shot.file)
            for outcome in explanation.outcomes
        ]


def read_job(
    folder: Path, method: Method = Method.REFINED, config: LocalizerConfig | None = None, initial: Path | None = None
) -> Job:
    """Read a recording and make its localizer.

    Parameters
    ----------
    folder : Path
        The recording.
    method : Method
        How poses are measured.
    config : LocalizerConfig, optional
        Parameters of every step; the defaults if left out.
    initial : Path, optional
        A file of starts, which takes the place of detection.

    Returns
    -------
    Job
        Checked as far as that goes without an image.

    Raises
    ------
    PalletLocError
        If a file is missing or wrong, the camera is not before the shelf at the first shot, or a start names
        a pallet that the recording does not use.
    """
    recording = read_recording(folder)
    with suppress(TrajectoryError):  # then the first shot cannot be used, but others may
        check_shelf(recording)
    given = None
    if initial is not None:
        _check_models(initial, [model.name for model in recording.models])
        given = read_starts(initial, recording.shots)
    return Job(recording, Localizer(recording.models, method, config), given)


def _check_models(initial: Path, known: Collection[str]) -> None:
    """Raise an error where a start names a pallet that is not looked for."""
    for row in read_rows(initial, START_COLUMNS):
        if (name := row.text("model")) not in known:
            raise row.fault(
                f"model: the recording's pallets do not include {shortened(name)}{nearest_name(name, known)}"
            )


@dataclass(frozen=True, slots=True, eq=False)
class ShotOutcome:
    """What became of one shot."""

    number: int
    """Index into the job's shots."""
    shot: ShotFile
    """The shot."""
    duration: float
    """How long it took, in seconds."""
    rows: tuple[PalletMeasurement | NoPose, ...] = ()
    """Its rows of measurements.csv."""
    refusals: tuple[RefusedCandidate, ...] = ()
    """Its rows of refusals.csv. Views and image of the shot are not kept: they are large."""
    picture: bytes = b""
    """What was drawn of it while the image was there: the content of a file; empty where nothing was."""
    problem: str = ""
    """Why it was skipped, in one line; empty where it was not."""


Draw = Callable[[Explanation], bytes]
"""Draws a small picture of a shot: the content of a file."""


def work_through(
    job: Job, output: RunFolder, *, strict: bool = False, draw: Draw | None = None
) -> Iterator[ShotOutcome]:
    """Localize the pallets of every shot that is left to do, and keep the rows.

    A shot that cannot be used is noted and passed over as soon as another one could be used: where none can,
    the fault is the recording's, and nothing is written.

    Parameters
    ----------
    job : Job
        What to work through.
    output : RunFolder
        Opened by the caller for the job's shots.
    strict : bool
        Whether the first shot that cannot be used ends the work.
    draw : callable, optional
        Draws each shot that can be used; the outcomes keep the pictures.

    Yields
    ------
    ShotOutcome
        One for each shot, when its rows are kept.

    Raises
    ------
    PalletLocError
        If no shot can be used, with `strict` if one cannot, or if the output cannot be written.
    """
    held: list[ShotOutcome] = []
    for number, shot in output.remaining():
        outcome = _worked(job, number, shot, strict, draw)
        held.append(outcome)
        if not output.done and outcome.problem:
            continue
        for done in held:
            _keep(done, output)
            yield done
        held.clear()
    if held:
        raise _useless(job, held)


def _worked(job: Job, number: int, shot: ShotFile, strict: bool, draw: Draw | None) -> ShotOutcome:
    started = perf_counter()
    try:
        explanation = job.explain(number)
    except PalletLocError as error:
        if strict:
            raise
        return ShotOutcome(number, shot, perf_counter() - started, problem=str(error))
    rows, refusals = tuple(job.rows(explanation)), tuple(explanation.refusals)
    duration = perf_counter() - started
    return ShotOutcome(number, shot, duration, rows, refusals, draw(explanation) if draw else b"")


def _keep(outcome: ShotOutcome, output: RunFolder) -> None:
    if outcome.problem:
        output.skip(outcome.number, outcome.problem)
    else:
        output.add(outcome.number, outcome.rows, outcome.refusals)


def _useless(job: Job, skipped: list[ShotOutcome]) -> ShotError:
    """Return the error about a recording of which no shot can be used."""
    first = skipped[0].problem
    if len(skipped) == 1:
        return ShotError(first)
    return ShotError(f"{job.recording.folder}: none of {len(skipped)} shots can be used; the first: {first}")
