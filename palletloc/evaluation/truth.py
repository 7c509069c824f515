"""The truth of a recording from its folder: the forklift's path, the pallets, and the survey where there is one."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from palletloc.errors import nearest_name
from palletloc.evaluation.pose_error import EvaluationError, PlacedPallet
from palletloc.evaluation.run_match import PAIRING_DISTANCE
from palletloc.evaluation.time_pairing import require_overlap
from palletloc.geometry import FloatArray, level_pose
from palletloc.io.recording import Recording, read_recording
from palletloc.io.truth import TruePallet, path_file, read_pallets, read_truth
from palletloc.survey.truth import SurveyedTruth, TruePose, read_surveyed_truth
from palletloc.trajectory import Trajectory

_SURVEY = "survey.yaml"
"""What was surveyed."""
_MOST_APART = 5.0
"""How long before the first or after the last shot all stops may be, in seconds: a forklift may stand first."""
_MOST_TURNED = np.radians(15.0)
"""Largest angle between a surveyed pallet and the same by path and pallets.csv, in radians."""


@dataclass(frozen=True, slots=True, eq=False)
class SurveyAgreement:
    """A surveyed pose minus that of the continuous truth."""

    stop: str
    """Name of the stop."""
    pallet: str
    """Id of the pallet."""
    error: FloatArray
    """(4,) of x, y and z in metres, and of yaw in radians."""
    normalised: FloatArray
    """(4,) the same in standard deviations of the survey."""


@dataclass(frozen=True, slots=True, eq=False)
class RecordingTruth:
    """A recording with all that is true of it."""

    recording: Recording
    """The recording."""
    pallets: tuple[TruePallet, ...]
    """Of truth/pallets.csv."""
    path: Trajectory | None
    """``world_from_forklift`` over time; None where only stops were surveyed."""
    surveyed: SurveyedTruth | None
    """Of truth/survey.yaml; None without one."""
    agreement: tuple[SurveyAgreement, ...] = ()
    """Of survey and path, where there are both."""
    notes: tuple[str, ...] = ()
    """What was dropped or assumed when the path's file was read."""

    @property
    def widths(self) -> Mapping[str, float]:
        """Width of each model's front face, in metres."""
        return {model.name: model.width for model in self.recording.models}


def read_recording_truth(folder: str | Path, columns: Sequence[str] | None = None) -> RecordingTruth:
    """Read a recording with its truth.

    Parameters
    ----------
    folder : str or Path
        The recording, with a folder ``truth`` that holds pallets.csv, and forklift.csv (or forklift.tum), or
        survey.yaml, or both.
    columns : sequence of str, optional
        What the columns of a surveyed table are, from the left.

    Returns
    -------
    RecordingTruth
        Checked: every pallet has a known model, and survey and path agree to the decimetre.

    Raises
    ------
    PalletLocError
        If a file is missing or wrong, or belongs to another site.
    """
    folder = Path(folder)
    recording = read_recording(folder)
    place = folder / "truth"
    surveyed = read_surveyed_truth(folder, columns) if (place / _SURVEY).exists() else None
    if surveyed is not None and path_file(folder) is None:
        pallets, path = read_pallets(place / "pallets.csv"), None
        notes: tuple[str, ...] = ()
    else:
        truth = read_truth(folder, recording.truth_form)
        pallets, path, notes = truth.pallets, truth.forklift, truth.notes
    _check_models(place, pallets, recording)
    if surveyed is None:
        return RecordingTruth(recording, pallets, path, None, notes=notes)
    _check_surveyed(place, pallets, surveyed, recording)
    agreement = () if path is None else _agreement(place, pallets, path, surveyed)
    return RecordingTruth(recording, pallets, path, surveyed, agreement, notes)


def continuous_poses(
    world_from_forklift: Trajectory, pallets: Iterable[PlacedPallet], time: float
) -> tuple[TruePose, ...]:
    """Return the true poses at any time of a continuous truth, taken as exact.

    Parameters
    ----------
    world_from_forklift : Trajectory
        The forklift's true path.
    pallets : iterable of PlacedPallet
        Where the pallets stand.
    time : float
        In seconds.

    Returns
    -------
    tuple of TruePose
        In the pallets' order, without covariance.

    Raises
    ------
    TrajectoryError
        If the path does not cover the time.
    """
    forklift_from_world = world_from_forklift.pose_at(time).transform().inv()
    return tuple(
        TruePose(pallet.id, level_pose(forklift_from_world * pallet.world_from_pallet.transform()))
        for pallet in pallets
    )


def survey_notes(truth: RecordingTruth, stop_limit: float) -> Iterator[str]:
    """Yield what a reader has to know about a survey: rejected lines, assumptions, and stops without a shot."""
    if truth.surveyed is None:
        return
    yield from truth.surveyed.notes
    times = np.array([shot.time for shot in truth.recording.shots])
    for stop in truth.surveyed.stops:
        gap = float(np.abs(times - stop.time).min())
        if gap > stop_limit:
            yield f"stop '{stop.name}': the nearest shot is {gap:.3g} s away, not {stop_limit:g} s; see --stop-limit"


def _check_models(place: Path, pallets: tuple[TruePallet, ...], recording: Recording) -> None:
    known = [model.name for model in recording.models]
    if not pallets:
        raise EvaluationError(f"{place / 'pallets.csv'}: has no rows; expected at least one pallet")
    for pallet in pallets:
        if pallet.model not in known:
            hint = nearest_name(pallet.model, known)
            raise EvaluationError(
                f"{place / 'pallets.csv'}: pallet '{pallet.id}': the recording has no model '{pallet.model}'{hint}"
            )


def _check_surveyed(
    place: Path, pallets: tuple[TruePallet, ...], surveyed: SurveyedTruth, recording: Recording
) -> None:
    known = [pallet.id for pallet in pallets]
    for name in surveyed.plan.pallets:
        if name not in known:
            hint = nearest_name(name, known)
            raise EvaluationError(f"{place / _SURVEY}: bodies: pallet '{name}' is not in pallets.csv{hint}")
    stops = np.array([stop.time for stop in surveyed.stops])
    shots = np.array([shot.time for shot in recording.shots])
    require_overlap(stops, shots, (f"{place / _SURVEY}: stops", "shots"), slack=_MOST_APART)


def _agreement(
    place: Path, pallets: tuple[TruePallet, ...], path: Trajectory, surveyed: SurveyedTruth
) -> tuple[SurveyAgreement, ...]:
    """Compare the survey with the path at every stop that the path covers."""
    found = []
    start, end = path.span
    for stop in surveyed.stops:
        if not start <= stop.time <= end:
            continue
        true = {pose.id: pose.forklift_from_pallet for pose in continuous_poses(path, pallets, stop.time)}
        for pose in stop.poses:
            error = -pose.error(true[pose.id])
            distance = float(np.linalg.norm(error[:3]))
            if abs(error[3]) > _MOST_TURNED:
                raise EvaluationError(
                    f"{place / _SURVEY}: stop '{stop.name}', pallet '{pose.id}': is turned by"
                    f" {np.degrees(error[3]):.0f} degrees from how the forklift's path and pallets.csv put it;"
                    " are their angles in radians?"
                )
            if distance > PAIRING_DISTANCE:
                raise EvaluationError(
                    f"{place / _SURVEY}: stop '{stop.name}', pallet '{pose.id}': is {distance:.2f} m from where the"
                    f" forklift's path and pallets.csv put it, expected at most {PAIRING_DISTANCE} m;"
                    " is it the survey of another site, or of another time?"
                )
            found.append(SurveyAgreement(stop.name, pose.id, error, -pose.normalised_error(true[pose.id])))
    return tuple(found)
