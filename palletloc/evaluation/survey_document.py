"""The part of metrics.json about a survey."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from palletloc.evaluation.truth import RecordingTruth
from palletloc.survey.polar import FaceErrors
from palletloc.survey.truth import PlacedBody, SurveyedTruth


def survey_document(surveyed: SurveyedTruth, truth: RecordingTruth, stop_limit: float) -> Mapping[str, Any]:
    """Return stops, instrument, bodies, notes, and how the survey agrees with the forklift's path.

    Parameters
    ----------
    surveyed : SurveyedTruth
        The survey.
    truth : RecordingTruth
        Whose survey it is.
    stop_limit : float
        How far a shot may be from the time of its stop, in seconds.
    """
    bodies = [*(stop.forklift for stop in surveyed.stops), *surveyed.pallets]
    return {
        "stops": [{"name": stop.name, "time_s": stop.time} for stop in surveyed.stops],
        "stop_limit_s": stop_limit,
        "sigma_m": surveyed.plan.sigma,
        "variance_factor": surveyed.variance_factor,
        "instrument": _instrument(surveyed.survey.faces),
        "bodies": [_body(one) for one in bodies],
        "notes": list(survey_notes(truth, stop_limit)),
        "against_path": [
            {
                "stop": one.stop,
                "pallet": one.pallet,
                "position_m": float(np.linalg.norm(one.error[:3])),
                "yaw_deg": math.degrees(one.error[3]),
                "largest_normalised": float(np.abs(one.normalised).max()),
            }
            for one in truth.agreement
        ],
    }


def survey_notes(truth: RecordingTruth, stop_limit: float) -> Iterator[str]:
    """Yield what a reader has to know about a survey: rejected lines, assumptions, and stops without a shot."""
    if truth.surveyed is None:
        return
    yield from truth.surveyed.notes
    times = np.array([shot.time for shot in truth.recording.shots])
    for stop in truth.surveyed.stops:
        away = float(np.abs(times - stop.time).min())
        if away > stop_limit:
            yield f"stop '{stop.name}': the nearest shot is {away:.3g} s away, not {stop_limit:g} s; see --stop-limit"


def instrument_errors(faces: Sequence[FaceErrors]) -> tuple[float, float] | None:
    """Return the median index and collimation errors of pairs of faces, in radians; None without a pair."""
    if not faces:
        return None
    index, collimation = np.median([[one.index, one.collimation] for one in faces], axis=0)
    return float(index), float(collimation)


def _instrument(faces: Sequence[FaceErrors]) -> dict[str, float] | None:
    errors = instrument_errors(faces)
    if errors is None:
        return None
    index, collimation = (math.degrees(one) for one in errors)
    return {"pairs": len(faces), "index_deg": index, "collimation_deg": collimation}


def _body(one: PlacedBody) -> dict[str, Any]:
    fit = one.fit
    residuals = np.linalg.norm(fit.residuals, axis=1)
    return {
        "body": one.body.label,
        "assumed_level": fit.assumed_level,
        "rms_m": fit.rms,
        "yaw_sigma_deg": math.degrees(fit.pose.yaw_sigma),
        "points": [
            {
                "name": point.name,
                "lines": list(point.lines),
                "residual_m": float(residual),
                "leave_one_out_m": float(left_out),
            }
            for point, residual, left_out in zip(one.body.points, residuals, fit.leave_one_out, strict=True)
        ],
    }
