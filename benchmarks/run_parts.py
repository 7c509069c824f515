"""A method's run over a recording against the truth, and the part of it that stands at some heights."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace

from palletloc.choices import TimeRule
from palletloc.evaluation.pose_error import EvaluationError, from_measurements
from palletloc.evaluation.run_match import RunMatch, ShotMatch, TrueScene, match_run
from palletloc.io.recording import Recording
from palletloc.io.truth import Truth
from palletloc.measurement import PalletMeasurement
from palletloc.pallet_library import load_library

FAR_BELOW = 0.6
"""How far below the camera a pallet's lower edge lies for a horizontal plane to serve well, in metres."""


def match_recording(recording: Recording, truth: Truth, measured: Iterable[PalletMeasurement]) -> RunMatch:
    """Match a method's measurements with the truth, which has to cover every shot.

    Parameters
    ----------
    recording : Recording
        Gives the shots, the mounting and the pallet models beside the library's.
    truth : Truth
        Of the recording; interpolated at the times of the shots.
    measured : iterable of PalletMeasurement
        In any order.

    Raises
    ------
    EvaluationError
        If the truth does not cover a shot, or has a pallet of an unknown model.
    """
    models = load_library() | {model.name: model for model in recording.models}
    widths = {name: model.width for name, model in models.items()}
    scene = TrueScene(truth.forklift, truth.pallets, widths, recording.forklift_from_camera)
    times = [shot.time for shot in recording.shots]
    match = match_run(times, from_measurements(measured), scene, TimeRule.INTERPOLATED, math.inf)
    if match.without_truth:
        raise EvaluationError(
            f"{recording.folder}: no truth for the shot at {match.without_truth[0]:.6g} s; expected it for every shot"
        )
    return match


def between(shot: ShotMatch, low: float, high: float, camera_height: float) -> ShotMatch:
    """Return only what lies at least ``low`` and less than ``high`` metres below the camera.

    Parameters
    ----------
    shot : ShotMatch
        A shot against the truth.
    low, high : float
        In metres; negative above the camera.
    camera_height : float
        Of the camera in the forklift frame, in metres.

    Returns
    -------
    ShotMatch
        Pallets count where they truly are, false estimates where they say.
    """
    return replace(
        shot,
        errors=tuple(error for error in shot.errors if low <= error.face.below < high),
        beyond=tuple(error for error in shot.beyond if low <= error.face.below < high),
        missed=tuple(face for face in shot.missed if low <= face.below < high),
        false=tuple(
            estimate for estimate in shot.false if low <= camera_height - estimate.forklift_from_pallet.z < high
        ),
    )
