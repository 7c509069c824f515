"""The document metrics.json: all results with keys that stay. `docs/evaluation.md` describes them."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from palletloc.evaluation.breakdown import Spreads, by_distance, by_pallet, by_track, distance_edges, spreads
from palletloc.evaluation.consistency import chi_square_check
from palletloc.evaluation.estimate_error import COMPONENTS, EstimateError
from palletloc.evaluation.evaluated_run import EvaluatedRun, EvaluatedSource, Settings, StopErrors
from palletloc.evaluation.paired_comparison import Difference
from palletloc.evaluation.proportion import Proportion
from palletloc.evaluation.requirement import Requirement, RequirementCheck
from palletloc.evaluation.shot_match import Detection
from palletloc.evaluation.side_by_side import RESAMPLES, SEED, ComparedRuns
from palletloc.evaluation.spread import Spread
from palletloc.evaluation.survey_document import survey_document
from palletloc.evaluation.truth import RecordingTruth

FORMAT = 1
"""Number of the form; a change that breaks a reader gets the next one."""
METRICS = "metrics.json"
"""Name of the file."""
Document = dict[str, Any]
"""What JSON can hold."""


def metrics_document(
    truth: RecordingTruth,
    runs: Sequence[EvaluatedRun],
    settings: Settings,
    compared: Sequence[ComparedRuns] = (),
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
            "max_range_m": settings.sight.max_range,
            "min_bearing_deg": settings.sight.min_bearing_deg,
            "max_bearing_deg": settings.sight.max_bearing_deg,
        },
        "requirement": _requirement(settings.requirement),
        "runs": [
            {
                "name": run.files.name,
                "estimate": str(run.files.folder),
                "sources": {name: _source(source, settings) for name, source in run.sources.items()},
            }
            for run in runs
        ],
        "comparisons": [_comparison(one) for one in compared],
    }


def _comparison(one: ComparedRuns) -> Document:
    compared = one.comparison
    scales = {f"{name}_m": (name, 1.0) for name in COMPONENTS[:3]} | {"yaw_deg": ("yaw", math.degrees(1.0))}
    return {
        "first": one.first,
        "second": one.second,
        "source": one.source,
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


def _difference(one: Difference, scale: float) -> Document:
    numbers = {"mean": scale * one.mean, "low": scale * one.low, "high": scale * one.high}
    return numbers | {"smaller": one.smaller, "larger": one.larger}


def metrics_text(document: Mapping[str, Any]) -> str:
    """Return the content of metrics.json; numbers that are not finite become null."""
    return json.dumps(_plain(document), indent=1, allow_nan=False, ensure_ascii=False) + "\n"


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _plain(one) for key, one in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(one) for one in value]
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
        document["survey"] = survey_document(truth.surveyed, truth, settings.stop_limit)
    return document


def _requirement(asked: Requirement) -> Document:
    limits = {f"{name}_m": float(limit) for name, limit in zip(COMPONENTS[:3], asked.limits, strict=False)}
    return {
        **limits,
        "yaw_deg": math.degrees(asked.yaw),
        "share": asked.share,
        "confidence": asked.confidence,
    }


def _source(source: EvaluatedSource, settings: Settings) -> Document:
    errors = source.errors
    edges = distance_edges(settings.bin_width, settings.sight.max_range)
    return {
        "errors": spreads_document(spreads(errors)),
        "detection": detection_document(source.detection),
        "requirement": check_document(source.requirement),
        "consistency": consistency_document(errors),
        "pallets": {
            name: {
                "errors": spreads_document(spreads(group)),
                "missed": sum(face.id == name for shot in source.shots for face in shot.missed),
            }
            for name, group in sorted(by_pallet(errors).items())
        },
        "never_found": sorted(
            {face.id for shot in source.shots for face in shot.missed} - set(by_pallet(errors)),
        ),
        "distance": [
            {
                "from_m": one.low,
                "to_m": one.high,
                "found": _proportion(one.found),
                "errors": spreads_document(spreads(one.errors)),
            }
            for one in by_distance(source.shots, edges)
        ],
        "stops": [_stop(one) for one in source.stops],
        "tracks": [
            {
                "track": one.track,
                "pallets": list(one.pallets),
                "false": one.false,
                "errors": spreads_document(spreads(one.errors)),
            }
            for one in by_track(source.shots)
        ],
    }


def spreads_document(one: Spreads) -> Document:
    """Return the statistics of some errors: lengths in metres, the yaw in degrees; None for an empty group."""
    parts = {f"{name}_m": _spread(getattr(one, name), 1.0) for name in (*COMPONENTS[:3], "position")}
    return parts | {"yaw_deg": _spread(one.yaw, math.degrees(1.0))}


def _spread(one: Spread | None, scale: float) -> Document | None:
    if one is None:
        return None
    names = ("bias", "mean", "median", "rms", "p95", "maximum")
    return {"n": one.n} | {name: scale * getattr(one, name) for name in names}


def _proportion(one: Proportion) -> Document:
    return {
        "count": one.successes,
        "of": one.trials,
        "share": one.value,
        "low": one.low,
        "high": one.high,
        "confidence": one.confidence,
    }


def detection_document(one: Detection) -> Document:
    """Return recall and false detections."""
    return {
        "shots": one.shots,
        "recall": _proportion(one.found),
        "false": one.false,
        "false_per_shot": one.false_per_shot,
    }


def check_document(check: RequirementCheck) -> Document:
    """Return the verdict with each quantity's Clopper-Pearson interval."""
    return {
        "verdict": str(check.together.verdict),
        "missed_counted": check.missed,
        **{
            name: {"verdict": str(one.verdict), "inside": _proportion(one.proportion)}
            for name in ("together", *COMPONENTS)
            for one in [getattr(check, name)]
        },
    }


def consistency_document(errors: Sequence[EstimateError]) -> Document:
    """Return NEES against chi-square, and how many errors lie within two standard deviations."""
    check = chi_square_check([one.nees_with_truth for one in errors], 4)
    normalised = np.array([one.normalised for one in errors]).reshape(-1, 4)
    inside = (np.abs(normalised) <= 2).mean(axis=0) if len(errors) else np.full(4, np.nan)
    return {
        "nees": {
            "n": check.n,
            "improper": check.improper,
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


def _stop(one: StopErrors) -> Document:
    accuracy = one.accuracy
    truth = np.sqrt(np.diag(_truth_covariance(one)))
    return {
        "stop": one.stop,
        "time_s": one.time,
        "pallet": one.pallet,
        "n": accuracy.n,
        "ap_m": accuracy.ap,
        "rp_m": accuracy.rp,
        "ap_yaw_deg": math.degrees(accuracy.ap_yaw),
        "rp_yaw_deg": math.degrees(accuracy.rp_yaw),
        "mean_m": {name: float(value) for name, value in zip(COMPONENTS[:3], accuracy.mean, strict=True)},
        "truth_sigma_m": {name: float(value) for name, value in zip(COMPONENTS[:3], truth, strict=False)},
        "truth_sigma_yaw_deg": math.degrees(truth[3]),
        "nees_mean": float(np.mean([error.nees_with_truth for error in one.errors])),
    }


def _truth_covariance(one: StopErrors) -> Any:
    covariance = one.errors[0].truth_covariance
    return np.zeros((4, 4)) if covariance is None else covariance
