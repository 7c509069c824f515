"""The document metrics.json: all results with keys that stay. `docs/evaluation.md` describes them."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from palletloc.evaluation.breakdown import by_distance, by_pallet, by_track, distance_edges, spreads
from palletloc.evaluation.comparison import PairedDifference
from palletloc.evaluation.pose_error import COMPONENTS, PoseError, squared_errors
from palletloc.evaluation.requirement import Requirement, RequirementCheck
from palletloc.evaluation.run import (
    RESAMPLES,
    SEED,
    ComparedRuns,
    EvaluatedRun,
    EvaluatedSource,
    Settings,
    StopErrors,
)
from palletloc.evaluation.run_match import DetectionRate
from palletloc.evaluation.statistics import Proportion, Spread, chi_square_check
from palletloc.evaluation.truth import RecordingTruth, survey_notes
from palletloc.mounting_yaw import turn_document
from palletloc.survey.polar import FaceErrors, instrument_errors
from palletloc.survey.truth import PlacedBody, SurveyedTruth

FORMAT = 1
"""Number of the form; a change that breaks a reader gets the next one."""
METRICS = "metrics.json"
"""Name of the file."""
Document = dict[str, Any]
"""What JSON can hold."""


def metrics_document(
    truth: RecordingTruth, runs: Sequence[EvaluatedRun], settings: Settings, compared: Sequence[ComparedRuns] = ()
) -> Document:
    """Return the document about the runs over one recording.

    Parameters
    ----------
    truth : RecordingTruth
        Of the recording.
    runs : sequence of EvaluatedRun
        At least one.
    settings : Settings
        With which they were evaluated.
    compared : sequence of ComparedRuns
        The runs side by side.

    Returns
    -------
    dict
        Of JSON's own kinds; what is not known is None.
    """
    return {
        "format": FORMAT,
        "recording": truth.recording.folder.resolve().name,
        "shots": len(truth.recording.shots),
        "truth": _truth(truth, runs[0], settings),
        "sight": {
            "max_range_m": settings.visibility.max_range,
            "min_bearing_deg": settings.visibility.min_bearing_deg,
            "max_bearing_deg": settings.visibility.max_bearing_deg,
        },
        "requirement": _requirement(settings.requirement),
        "runs": [
            {
                "name": run.files.name,
                "estimate": str(run.files.folder),
                "sources": {name: _source(source, settings) for name, source in run.sources.items()},
                **turn_document(run.turn),
            }
            for run in runs
        ],
        "comparisons": [_comparison(runs) for runs in compared],
    }


def _comparison(runs: ComparedRuns) -> Document:
    compared = runs.comparison
    scales = {f"{name}_m": (name, 1.0) for name in COMPONENTS[:3]} | {"yaw_deg": ("yaw", math.degrees(1.0))}
    return {
        "first": runs.first,
        "second": runs.second,
        "source": runs.source,
        "views": compared.views,
        "shots": compared.shots,
        "only_first": len(compared.only_first),
        "only_second": len(compared.only_second),
        "confidence": compared.confidence,
        "resamples": RESAMPLES,
        "seed": SEED,
        "differences": {
            key: None if name not in compared.differences else _difference(compared.differences[name], scale)
            for key, (name, scale) in scales.items()
        },
    }


def _difference(found: PairedDifference, scale: float) -> Document:
    numbers = {"mean": scale * found.mean, "low": scale * found.low, "high": scale * found.high}
    return numbers | {"smaller": found.smaller, "larger": found.larger}


def metrics_text(document: Mapping[str, Any]) -> str:
    """Return the content of metrics.json; numbers that are not finite become null."""
    return json.dumps(_plain(document), indent=1, allow_nan=False, ensure_ascii=False) + "\n"


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _plain(part) for key, part in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(part) for part in value]
    if isinstance(value, float):
        return float(f"{value:.9g}") if math.isfinite(value) else None
    return value


def _truth(truth: RecordingTruth, run: EvaluatedRun, settings: Settings) -> Document:
    document: Document = {
        "kind": "survey" if truth.path is None else "path",
        "pairing": {
            "rule": "nearest stop" if truth.path is None else str(settings.rule),
            "limit_s": settings.stop_limit if truth.path is None else settings.limit,
            "largest_s": run.largest,
            "shots_without_truth": list(run.without_truth),
        },
        "pallets": len(truth.pallets),
        "survey": None,
    }
    if truth.surveyed is not None:
        document["survey"] = _survey(truth.surveyed, truth, settings.stop_limit)
    return document


def _requirement(asked: Requirement) -> Document:
    limits = {f"{name}_m": float(limit) for name, limit in zip(COMPONENTS[:3], asked.limits, strict=False)}
    return {**limits, "yaw_deg": math.degrees(asked.yaw), "share": asked.share, "confidence": asked.confidence}


def _source(source: EvaluatedSource, settings: Settings) -> Document:
    errors = source.errors
    edges = distance_edges(settings.bin_width, settings.visibility.max_range)
    return {
        "errors": _spreads(errors),
        "detection": _detection(source.detection),
        "requirement": check_document(source.requirement),
        "consistency": _consistency(errors),
        "pallets": {
            name: {
                "errors": _spreads(group),
                "missed": sum(face.id == name for shot in source.shots for face in shot.missed),
            }
            for name, group in sorted(by_pallet(errors).items())
        },
        "never_found": sorted({face.id for shot in source.shots for face in shot.missed} - set(by_pallet(errors))),
        "distance": [
            {"from_m": part.low, "to_m": part.high, "found": _proportion(part.found), "errors": _spreads(part.errors)}
            for part in by_distance(source.shots, edges)
        ],
        "stops": [_stop(stop) for stop in source.stops],
        "tracks": [
            {
                "track": track.track,
                "pallets": list(track.pallets),
                "false": track.false,
                "errors": _spreads(track.errors),
            }
            for track in by_track(source.shots)
        ],
    }


def _spreads(errors: Sequence[PoseError]) -> Document:
    """Return the statistics of some errors: lengths in metres, the yaw in degrees; None for an empty group."""
    found = spreads(errors)
    parts = {f"{name}_m": _spread(getattr(found, name), 1.0) for name in (*COMPONENTS[:3], "position")}
    return parts | {"yaw_deg": _spread(found.yaw, math.degrees(1.0))}


def _spread(found: Spread | None, scale: float) -> Document | None:
    if found is None:
        return None
    names = ("bias", "mean", "median", "rms", "p95", "maximum")
    return {"n": found.n} | {name: scale * getattr(found, name) for name in names}


def _proportion(found: Proportion) -> Document:
    return {
        "count": found.successes,
        "of": found.trials,
        "share": found.value,
        "low": found.low,
        "high": found.high,
        "confidence": found.confidence,
    }


def _detection(rate: DetectionRate) -> Document:
    """Return recall and false detections."""
    return {
        "shots": rate.shots,
        "recall": _proportion(rate.found),
        "false": rate.false,
        "false_per_shot": rate.false_per_shot,
    }


def check_document(check: RequirementCheck) -> Document:
    """Return the verdict with each quantity's Clopper-Pearson interval."""
    return {
        "verdict": str(check.together.verdict),
        "missed_counted": check.missed,
        **{
            name: {"verdict": str(part.verdict), "inside": _proportion(part.proportion), "needed": part.needed}
            for name in ("together", *COMPONENTS)
            for part in [getattr(check, name)]
        },
    }


def _consistency(errors: Sequence[PoseError]) -> Document:
    """Return NEES against chi-square, and how many errors lie within two standard deviations."""
    check = chi_square_check(squared_errors(errors), 4)
    normalised = np.array([error.normalised for error in errors]).reshape(-1, 4)
    inside = (np.abs(normalised) <= 2).mean(axis=0) if len(errors) else np.full(4, np.nan)
    return {
        "nees": {
            "n": check.n,
            "improper": check.unknown,
            "expected": check.expected,
            "mean": check.mean,
            "median": check.median,
            "low": check.low,
            "high": check.high,
            "confidence": check.confidence,
            "verdict": str(check.verdict),
        },
        "within_two_sigma": {name: float(part) for name, part in zip(COMPONENTS, inside, strict=True)},
    }


def _stop(stop: StopErrors) -> Document:
    accuracy = stop.accuracy
    truth = np.sqrt(np.diag(_truth_covariance(stop)))
    return {
        "stop": stop.stop,
        "time_s": stop.time,
        "pallet": stop.pallet,
        "n": accuracy.n,
        "ap_m": accuracy.ap,
        "rp_m": accuracy.rp,
        "ap_yaw_deg": math.degrees(accuracy.ap_yaw),
        "rp_yaw_deg": math.degrees(accuracy.rp_yaw),
        "mean_m": {name: float(value) for name, value in zip(COMPONENTS[:3], accuracy.mean, strict=True)},
        "truth_sigma_m": {name: float(value) for name, value in zip(COMPONENTS[:3], truth, strict=False)},
        "truth_sigma_yaw_deg": math.degrees(truth[3]),
        "nees_mean": chi_square_check(squared_errors(stop.errors), 4).mean,
    }


def _truth_covariance(stop: StopErrors) -> Any:
    covariance = stop.errors[0].truth_covariance
    return np.zeros((4, 4)) if covariance is None else covariance


def _survey(surveyed: SurveyedTruth, truth: RecordingTruth, stop_limit: float) -> Document:
    """Return stops, instrument, bodies, notes, and how the survey agrees with the forklift's path."""
    bodies = [*(stop.forklift for stop in surveyed.stops), *surveyed.pallets]
    return {
        "stops": [{"name": stop.name, "time_s": stop.time} for stop in surveyed.stops],
        "stop_limit_s": stop_limit,
        "sigma_m": surveyed.plan.sigma,
        "variance_factor": surveyed.variance_factor,
        "instrument": _instrument(surveyed.survey.faces),
        "bodies": [_body(body) for body in bodies],
        "notes": list(survey_notes(truth, stop_limit)),
        "against_path": [
            {
                "stop": agreement.stop,
                "pallet": agreement.pallet,
                "position_m": float(np.linalg.norm(agreement.error[:3])),
                "yaw_deg": math.degrees(agreement.error[3]),
                "largest_normalised": float(np.abs(agreement.normalised).max()),
            }
            for agreement in truth.agreement
        ],
    }


def _instrument(faces: Sequence[FaceErrors]) -> Document | None:
    errors = instrument_errors(faces)
    if errors is None:
        return None
    index, collimation = (math.degrees(error) for error in errors)
    return {"pairs": len(faces), "index_deg": index, "collimation_deg": collimation}


def _body(placed: PlacedBody) -> Document:
    fit = placed.fit
    residuals = np.linalg.norm(fit.residuals, axis=1)
    return {
        "body": placed.body.label,
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
            for point, residual, left_out in zip(placed.body.points, residuals, fit.leave_one_out, strict=True)
        ],
    }
