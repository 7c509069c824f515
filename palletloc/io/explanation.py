"""The file explain.json: every number of every stage of one shot."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from palletloc.candidate import Candidate
from palletloc.geometry import LevelPose
from palletloc.joint_search import JointSearch
from palletloc.localizer import Explanation
from palletloc.position import Sweep
from palletloc.refinement.alignment import FaceEstimate
from palletloc.yaw import YawEstimate

_AXES = ("x_m", "y_m", "z_m", "yaw_rad")


def explanation_document(
    explanation: Explanation, named: Iterable[tuple[str, Candidate]], method: str
) -> dict[str, Any]:
    """Return what was found in a shot in a form that JSON can hold.

    Parameters
    ----------
    explanation : Explanation
        Of the shot.
    named : iterable of (str, Candidate)
        Its candidates with their names.
    method : str
        How poses were measured.

    Returns
    -------
    dict
        Metres, radians and seconds, as the keys say; poses are ``forklift_from_pallet``. A stage that a
        candidate did not reach is absent.
    """
    return {
        "file": explanation.file,
        "time_s": explanation.time,
        "method": method,
        "pallets": len(explanation.measurements),
        "candidates": [_candidate(name, one) for name, one in named],
    }


def _candidate(name: str, one: Candidate) -> dict[str, Any]:
    document: dict[str, Any] = {
        "name": name,
        "model": one.model.name,
        "detection_score": _rounded(one.score),
        "start": _pose(one.start),
    }
    if one.refusal is not None:
        document["refused"] = {"stage": str(one.refusal[0]), "reason": str(one.refusal[1])}
    if one.pose is not None and one.covariance is not None:
        sigma = np.sqrt(np.diag(one.covariance))
        document["pose"] = _pose(one.pose) | {"yaw_from": str(one.yaw_from)}
        document["sigma"] = dict(zip(_AXES, _list(sigma), strict=True))
        document["covariance"] = [_list(row) for row in one.covariance]
    if one.lines:
        document["hough_lines"] = [
            {"turn_rad": _rounded(line.turn), "up_m": _rounded(line.up), "votes": line.votes} for line in one.lines
        ]
    parts = {
        "yaw": one.yaw and _yaw(one.yaw),
        "sweep": one.sweep and _sweep(one.sweep),
        "joint_search": one.joint and _joint(one.joint),
        "face": one.face and _face(one.face),
    }
    document |= {key: part for key, part in parts.items() if part}
    if one.verification is not None:
        document["verification"] = {
            "contrast": _rounded(one.verification.contrast),
            "coverage": _rounded(one.verification.coverage),
            "score": _rounded(one.verification.score),
            "rank": _rounded(one.verification.rank),
        }
    return document


def _yaw(estimate: YawEstimate) -> dict[str, Any]:
    return {
        "yaw_rad": _rounded(estimate.yaw),
        "sigma_rad": _rounded(estimate.sigma),
        "votes": [
            {
                "edge": str(vote.edge.kind),
                "turn_rad": _rounded(vote.turn),
                "sigma_rad": _rounded(vote.sigma),
                "used": vote.used,
            }
            for vote in estimate.votes
        ],
    }


def _sweep(swept: Sweep) -> dict[str, Any]:
    return {
        "depth_m": _list(swept.depth),
        "score": _list(swept.score),
        "peaks": [_pose(peak) for peak in swept.peaks],
    }


def _joint(found: JointSearch) -> dict[str, Any]:
    return {
        "turn_rad": _list(found.turns),
        "depth_m": _list(found.depths),
        "score": [_list(row) for row in found.score],
    }


def _face(face: FaceEstimate) -> dict[str, Any]:
    return {
        "coverage": _rounded(face.coverage),
        "chi2": _rounded(face.chi2),
        "edges": [
            {
                "edge": str(one.edge.kind),
                "offset_m": _rounded(one.fit.offset),
                "sigma_m": _rounded(one.sigma),
                "coverage": _rounded(one.fit.coverage),
                "weight": _rounded(float(weight)),
            }
            for one, weight in zip(face.seen.edges, face.weights, strict=True)
        ],
    }


def _pose(pose: LevelPose) -> dict[str, float | None]:
    return dict(zip(_AXES, _list(pose.as_array()), strict=True))


def _list(values: Sequence[float] | np.ndarray[Any, np.dtype[np.float64]]) -> list[float | None]:
    return [_rounded(float(value)) for value in values]


def _rounded(value: float) -> float | None:
    """Return seven significant digits; null for what JSON has no number for."""
    return float(f"{value:.7g}") if np.isfinite(value) else None
