"""A run against the truth of its recording: all errors, and how they are to be judged."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from palletloc.evaluation.breakdown import by_stop
from palletloc.evaluation.errors import EvaluationError, Sight, by_shot, true_faces
from palletloc.evaluation.estimate import PalletEstimate
from palletloc.evaluation.estimate_error import EstimateError, offsets
from palletloc.evaluation.iso9283 import StopAccuracy, stop_accuracy
from palletloc.evaluation.requirement import Requirement, RequirementCheck, check_requirement
from palletloc.evaluation.run_files import RunFiles
from palletloc.evaluation.run_match import NEAREST_LIMIT, TrueScene, match_run
from palletloc.evaluation.shot_match import Detection, ShotMatch, detection, match_shot
from palletloc.evaluation.time_pairing import TimeRule, nearest_pairs
from palletloc.evaluation.truth import RecordingTruth
from palletloc.geometry import LevelPose
from palletloc.io.truth import path_file
from palletloc.survey.truth import SurveyedStop

INTERPOLATED_LIMIT = 0.5
"""How far apart the truth's samples on both sides of a shot may be, in seconds, where nothing else is asked."""
_FORKLIFT = LevelPose(0.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class Settings:
    """How to evaluate."""

    sight: Sight = field(default_factory=Sight)
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
    errors: tuple[EstimateError, ...]
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
    def errors(self) -> tuple[EstimateError, ...]:
        """Of the pallets that have to be found, in the order of time."""
        return tuple(error for shot in self.shots for error in shot.errors)

    @property
    def detection(self) -> Detection:
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
                asked.sight,
                name=str(path_file(folder) or "truth"),
            )
            match = match_run(times, estimates, scene, asked.rule, asked.limit)
            shots, largest, left_out = match.shots, match.largest, match.without_truth
        if not shots:
            raise EvaluationError(_no_truth(truth, asked))
        check = check_requirement(offsets([one for shot in shots for one in shot.errors]), asked.requirement)
        sources[name] = EvaluatedSource(shots, _by_stop(truth, at_stops, asked), check)
    return EvaluatedRun(run, sources, largest, left_out)


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
        _match_surveyed(truth, stops[stop], times[shot], shots[shot], asked.sight)
        for shot, stop in zip(pairs.first, pairs.second, strict=True)
    ]


@dataclass(frozen=True, slots=True)
class _AtForklift:
    """A pallet whose frame of reference is the forklift."""

    id: str
    model: str
    world_from_pallet: LevelPose


def _match_surveyed(
    truth: RecordingTruth, stop: SurveyedStop, time: float, found: Sequence[PalletEstimate], sight: Sight
) -> ShotMatch:
    models = {pallet.id: pallet.model for pallet in truth.pallets}
    placed = [_AtForklift(pose.id, models[pose.id], pose.forklift_from_pallet) for pose in stop.poses]
    faces = true_faces(placed, truth.widths, _FORKLIFT, truth.recording.forklift_from_camera, sight)
    return match_shot(time, found, faces, {pose.id: pose.covariance for pose in stop.poses})


def _by_stop(truth: RecordingTruth, shots: Sequence[ShotMatch], asked: Settings) -> tuple[StopErrors, ...]:
    if truth.surveyed is None:
        return ()
    times = {stop.name: stop.time for stop in truth.surveyed.stops}
    errors = [one for shot in shots for one in shot.errors]
    groups = by_stop(errors, times, asked.stop_limit)
    return tuple(StopErrors(stop, times[stop], pallet, group) for (stop, pallet), group in groups.items())
