"""A run: its files, its errors against the truth of its recording, and how they compare with another run's."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from palletloc.choices import NEAREST_LIMIT, TimeRule
from palletloc.errors import seconds
from palletloc.evaluation.breakdown import StopAccuracy, by_stop, stop_accuracy
from palletloc.evaluation.comparison import RunComparison, compare_runs
from palletloc.evaluation.pose_error import (
    EvaluationError,
    PalletEstimate,
    PoseError,
    Visibility,
    from_measurements,
    offsets,
    true_faces,
)
from palletloc.evaluation.requirement import Requirement, RequirementCheck, check_requirement
from palletloc.evaluation.run_match import (
    SAME_TIME,
    DetectionRate,
    ShotMatch,
    TrueScene,
    by_shot,
    detection,
    match_run,
    match_shot,
)
from palletloc.evaluation.time_pairing import nearest_pairs, require_overlap
from palletloc.evaluation.truth import RecordingTruth
from palletloc.geometry import LevelPose
from palletloc.io.measurements import read_measurements
from palletloc.io.recording import Recording
from palletloc.io.tracks import TRACKS, TrackRow, read_tracks
from palletloc.io.truth import path_file
from palletloc.measurement import PalletMeasurement
from palletloc.mounting_yaw import SeenTurn, seen_turn
from palletloc.survey.truth import SurveyedStop
from palletloc.track_status import Status

MEASUREMENTS = "measurements.csv"
"""Name of the file that a run must have."""
SHOTS_SOURCE, TRACKS_SOURCE = "measurements", "tracks"
"""Names of the sources of estimates: single shots, and tracks."""
INTERPOLATED_LIMIT = 0.5
"""How far apart the truth's samples on both sides of a shot may be, in seconds, where nothing else is asked."""
SEED = 0
"""Of the bootstrap: the same runs give the same intervals."""
RESAMPLES = 2000
"""How many bootstrap samples are drawn."""
_FORKLIFT = LevelPose(0.0, 0.0, 0.0, 0.0)
"""The forklift's pose where poses of pallets are given in its own frame."""


@dataclass(frozen=True, slots=True, eq=False)
class RunFiles:
    """The estimates of a run over a recording."""

    name: str
    """What it is called in results."""
    folder: Path
    """Where it is."""
    sources: Mapping[str, Sequence[PalletEstimate]]
    """The estimates of single shots and, where the run has them, of tracks that are believed."""


def read_run(folder: str | Path, recording: Recording, name: str = "") -> RunFiles:
    """Read a run's estimates and check that they are of the recording.

    Parameters
    ----------
    folder : str or Path
        With measurements.csv and, if the pallets were tracked, tracks.csv.
    recording : Recording
        Gives the shots.
    name : str
        What to call the run; the folder's name if empty.

    Returns
    -------
    RunFiles
        Without rows that hold no pose, and without tentative tracks: these do not claim to be a pallet yet.

    Raises
    ------
    PalletLocError
        If a file is missing or wrong, or has no pose, or a pose is of no shot.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise EvaluationError(f"{folder}: no such folder; expected {MEASUREMENTS} in it")
    path = folder / MEASUREMENTS
    measured = from_measurements(row for row in read_measurements(path) if isinstance(row, PalletMeasurement))
    if not measured:
        raise EvaluationError(f"{path}: has no pose of a pallet; expected at least one")
    sources = {SHOTS_SOURCE: measured}
    _check_times(path, measured, recording)
    if (folder / TRACKS).exists():
        path = folder / TRACKS
        rows = [_estimate(row) for row in read_tracks(path)]
        if not rows:
            raise EvaluationError(f"{path}: has no rows; expected at least one track")
        _check_times(path, rows, recording)
        sources[TRACKS_SOURCE] = [row for row in rows if row.state != Status.TENTATIVE]
    return RunFiles(name or folder.resolve().name, folder, sources)


def _estimate(row: TrackRow) -> PalletEstimate:
    return PalletEstimate(row.time, row.model, row.pose, row.covariance, str(row.track), str(row.status))


def _check_times(path: Path, estimates: Sequence[PalletEstimate], recording: Recording) -> None:
    shots = np.array([shot.time for shot in recording.shots])
    require_overlap(np.array([estimate.time for estimate in estimates]), shots, (str(path), "shots"), slack=SAME_TIME)
    for estimate in estimates:
        nearest = float(shots[np.abs(shots - estimate.time).argmin()])
        if abs(nearest - estimate.time) > SAME_TIME:
            at, there = seconds(estimate.time, nearest)
            raise EvaluationError(
                f"{path}: the pose at {at} s is of no shot; the nearest is at {there} s;"
                " is it a run over this recording?"
            )


@dataclass(frozen=True, slots=True)
class Settings:
    """How to evaluate."""

    visibility: Visibility = field(default_factory=Visibility)
    """Which pallets have to be found."""
    rule: TimeRule = TimeRule.NEAREST
    """How the truth is taken for a shot's time."""
    limit: float = NEAREST_LIMIT
    """Largest time to the nearest sample, or between the samples on both sides, in seconds."""
    stop_limit: float = NEAREST_LIMIT
    """How far a shot may be from the time of its surveyed stop, in seconds."""
    requirement: Requirement = field(default_factory=Requirement)
    """What the errors are held against."""
    bin_width: float = 0.5
    """Of the bins of distance, in metres."""


@dataclass(frozen=True, slots=True, eq=False)
class StopErrors:
    """A pallet at a surveyed stop."""

    stop: str
    """Name of the stop."""
    time: float
    """When, in seconds."""
    pallet: str
    """Id of the pallet."""
    errors: tuple[PoseError, ...]
    """Against the surveyed pose, with its covariance: one for each shot at the stop."""

    @property
    def accuracy(self) -> StopAccuracy:
        """In the terms of ISO 9283."""
        return stop_accuracy(offsets(self.errors))


@dataclass(frozen=True, slots=True, eq=False)
class EvaluatedSource:
    """One source of estimates of a run: single shots or tracks."""

    shots: tuple[ShotMatch, ...]
    """Every shot whose truth is known."""
    stops: tuple[StopErrors, ...]
    """Against the survey, where there is one."""
    requirement: RequirementCheck
    """The verdict; missed pallets are left out."""

    @property
    def errors(self) -> tuple[PoseError, ...]:
        """Of the pallets that have to be found, in the order of time."""
        return tuple(error for shot in self.shots for error in shot.errors)

    @property
    def detection(self) -> DetectionRate:
        """What was found, missed and false."""
        return detection(self.shots)


@dataclass(frozen=True, slots=True, eq=False)
class EvaluatedRun:
    """A run against the truth."""

    files: RunFiles
    """The run."""
    sources: Mapping[str, EvaluatedSource]
    """By name, as in the files."""
    largest: float
    """Largest time from a shot to the sample of the truth that was used, in seconds."""
    without_truth: tuple[float, ...]
    """Times of the shots that were left out, in seconds."""
    turn: SeenTurn | None = None
    """By how much its shots saw everything turned; None where the drive does not tell."""


def evaluate_run(truth: RecordingTruth, run: RunFiles, settings: Settings | None = None) -> EvaluatedRun:
    """Compare a run with the truth.

    Where the truth has the forklift's path, every shot is held against that, and the shots at surveyed stops
    against the survey as well. Without a path, the stops are all there is.

    Parameters
    ----------
    truth : RecordingTruth
        Of the recording.
    run : RunFiles
        Over it.
    settings : Settings, optional
        The defaults if left out.

    Returns
    -------
    EvaluatedRun
        One result for each source.

    Raises
    ------
    EvaluationError
        If truth and shots have no time in common.
    """
    asked = settings or Settings()
    times = [shot.time for shot in truth.recording.shots]
    sources: dict[str, EvaluatedSource] = {}
    largest = 0.0
    left_out: tuple[float, ...] = ()
    for name, estimates in run.sources.items():
        at_stops = _shots_at_stops(truth, times, estimates, asked)
        if truth.path is None:
            shots = tuple(at_stops)
            known = {shot.time for shot in shots}
            largest, left_out = asked.stop_limit, tuple(time for time in times if time not in known)
        else:
            folder = truth.recording.folder
            scene = TrueScene(
                truth.path,
                truth.pallets,
                truth.widths,
                truth.recording.forklift_from_camera,
                asked.visibility,
                name=str(path_file(folder) or "truth"),
            )
            match = match_run(times, estimates, scene, asked.rule, asked.limit)
            shots, largest, left_out = match.shots, match.largest, match.without_truth
        if not shots:
            raise EvaluationError(_no_truth(truth, asked))
        check = check_requirement(offsets([error for shot in shots for error in shot.errors]), asked.requirement)
        sources[name] = EvaluatedSource(shots, _by_stop(truth, at_stops, asked), check)
    recording = truth.recording
    turn = seen_turn(run.sources.get(SHOTS_SOURCE, ()), recording.odometry, recording.forklift_from_camera)
    return EvaluatedRun(run, sources, largest, left_out, turn)


def _no_truth(truth: RecordingTruth, asked: Settings) -> str:
    where = truth.recording.folder / "truth"
    if truth.path is None:
        return f"{where / 'survey.yaml'}: no shot within {asked.stop_limit:g} s of a stop; see --stop-limit"
    reach = "apart" if asked.rule is TimeRule.INTERPOLATED else "from a shot"
    return f"{where}: no truth for any shot: expected samples at most {asked.limit:g} s {reach}; see --pair"


def _shots_at_stops(
    truth: RecordingTruth, times: Sequence[float], estimates: Sequence[PalletEstimate], asked: Settings
) -> list[ShotMatch]:
    """Match the shots that were taken at stops with the surveyed poses."""
    if truth.surveyed is None:
        return []
    stops = truth.surveyed.stops
    pairs = nearest_pairs(np.array(times), np.array([stop.time for stop in stops]), asked.stop_limit)
    shots = by_shot(times, estimates)
    return [
        _match_surveyed(truth, stops[stop], times[shot], shots[shot], asked.visibility)
        for shot, stop in zip(pairs.first, pairs.second, strict=True)
    ]


@dataclass(frozen=True, slots=True)
class _AtForklift:
    """A pallet whose frame of reference is the forklift."""

    id: str
    model: str
    world_from_pallet: LevelPose


def _match_surveyed(
    truth: RecordingTruth, stop: SurveyedStop, time: float, found: Sequence[PalletEstimate], visibility: Visibility
) -> ShotMatch:
    models = {pallet.id: pallet.model for pallet in truth.pallets}
    placed = [_AtForklift(pose.id, models[pose.id], pose.forklift_from_pallet) for pose in stop.poses]
    faces = true_faces(placed, truth.widths, _FORKLIFT, truth.recording.forklift_from_camera, visibility)
    return match_shot(time, found, faces, {pose.id: pose.covariance for pose in stop.poses})


def _by_stop(truth: RecordingTruth, shots: Sequence[ShotMatch], asked: Settings) -> tuple[StopErrors, ...]:
    if truth.surveyed is None:
        return ()
    times = {stop.name: stop.time for stop in truth.surveyed.stops}
    errors = [error for shot in shots for error in shot.errors]
    groups = by_stop(errors, times, asked.stop_limit)
    return tuple(StopErrors(stop, times[stop], pallet, group) for (stop, pallet), group in groups.items())


@dataclass(frozen=True, slots=True, eq=False)
class ComparedRuns:
    """One source of two runs, paired by shot and pallet."""

    first: str
    """Name of the run that is compared with."""
    second: str
    """Name of the run that is compared."""
    source: str
    """Name of the source that both have."""
    comparison: RunComparison
    """Second minus first."""


def side_by_side(runs: Sequence[EvaluatedRun]) -> tuple[ComparedRuns, ...]:
    """Compare every run with the first one, for each source that both have.

    Parameters
    ----------
    runs : sequence of EvaluatedRun
        Over one recording, with the same settings.

    Returns
    -------
    tuple of ComparedRuns
        Empty for a single run.
    """
    return tuple(
        ComparedRuns(
            runs[0].files.name,
            run.files.name,
            name,
            compare_runs(runs[0].sources[name].errors, source.errors, resamples=RESAMPLES, seed=SEED),
        )
        for run in runs[1:]
        for name, source in run.sources.items()
        if name in runs[0].sources
    )
