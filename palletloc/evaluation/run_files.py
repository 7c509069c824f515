"""The files of a run that is to be evaluated: measurements.csv and, if there, tracks.csv."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from palletloc.evaluation.errors import SAME_TIME, EvaluationError
from palletloc.evaluation.estimate import PalletEstimate, from_measurements, without_state
from palletloc.evaluation.time_pairing import require_overlap
from palletloc.io.measurements import read_measurements
from palletloc.io.recording import Recording
from palletloc.io.tracks import TRACKS, TrackRow, read_tracks
from palletloc.measurement import PalletMeasurement
from palletloc.track_status import Status

MEASUREMENTS = "measurements.csv"
"""Name of the file that a run must have."""
SHOTS_SOURCE, TRACKS_SOURCE = "measurements", "tracks"
"""Names of the sources of estimates: single shots, and tracks."""


@dataclass(frozen=True, slots=True, eq=False)
class RunFiles:
    """What a run says of a recording."""

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
    measured = from_measurements(one for one in read_measurements(path) if isinstance(one, PalletMeasurement))
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
        sources[TRACKS_SOURCE] = without_state(rows, str(Status.TENTATIVE))
    return RunFiles(name or folder.resolve().name, folder, sources)


def _estimate(row: TrackRow) -> PalletEstimate:
    return PalletEstimate(row.time, row.model, row.pose, row.covariance, str(row.track), str(row.status))


def _check_times(path: Path, estimates: Sequence[PalletEstimate], recording: Recording) -> None:
    shots = np.array([shot.time for shot in recording.shots])
    require_overlap(np.array([one.time for one in estimates]), shots, (str(path), "shots"), slack=SAME_TIME)
    for one in estimates:
        nearest = float(shots[np.abs(shots - one.time).argmin()])
        if abs(nearest - one.time) > SAME_TIME:
            raise EvaluationError(
                f"{path}: the pose at {one.time:.6g} s is of no shot; the nearest is at {nearest:.6g} s;"
                " is it a run over this recording?"
            )
