"""The file explain.json: every number of every stage of one shot."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from palletloc.candidate import Candidate
from palletloc.explained import EdgeAccount, SearchAxes, account_edges
from palletloc.geometry import FloatArray, LevelPose
from palletloc.joint_search import JointSearch
from palletloc.localizer import Explanation
from palletloc.pallet import PalletModel
from palletloc.position import Sweep
from palletloc.refinement.alignment import FaceEstimate
from palletloc.refinement.search import Search
from palletloc.yaw import YawEstimate

_AXES = ("x_m", "y_m", "z_m", "yaw_rad")
"""Keys of a pose's numbers, in the order of its covariance."""


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
        "candidates": [_candidate(name, candidate) for name, candidate in named],
    }


def _candidate(name: str, candidate: Candidate) -> dict[str, Any]:
    document: dict[str, Any] = {
        "name": name,
        "model": candidate.model.name,
        "detection_score": _rounded(candidate.score),
        "start": _pose(candidate.start),
    }
    if candidate.refusal is not None:
        document["refused"] = {"stage": str(candidate.refusal[0]), "reason": str(candidate.refusal[1])}
    if candidate.pose is not None and candidate.covariance is not None:
        sigma = np.sqrt(np.diag(candidate.covariance))
        document["pose"] = _pose(candidate.pose) | {"yaw_from": str(candidate.yaw_from)}
        document["sigma"] = dict(zip(_AXES, _list(sigma), strict=True))
        document["covariance"] = [_list(row) for row in candidate.covariance]
        document["ellipse"] = _ellipse(candidate.covariance)
    if candidate.lines:
        document["hough_lines"] = [
            {"turn_rad": _rounded(line.turn), "up_m": _rounded(line.up), "votes": line.votes}
            for line in candidate.lines
        ]
    parts = {
        "yaw": candidate.yaw and _yaw(candidate.yaw),
        "sweep": candidate.sweep and _sweep(candidate.sweep),
        "joint_search": candidate.joint and _joint(candidate.joint),
        "search": candidate.search and _search(candidate.search),
        "face": candidate.face and _face(candidate.face, candidate.model),
    }
    document |= {key: part for key, part in parts.items() if part}
    if candidate.verification is not None:
        document["verification"] = {
            "contrast": _rounded(candidate.verification.signs.contrast),
            "coverage": _rounded(candidate.verification.signs.coverage),
            "score": _rounded(candidate.verification.signs.score),
            "doubt": _rounded(candidate.verification.signs.doubt),
            "hidden": _rounded(candidate.verification.signs.hidden),
            "rank": _rounded(candidate.verification.rank),
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


def _ellipse(covariance: FloatArray) -> dict[str, float | None]:
    """Return one standard deviation of the position on the floor."""
    values, vectors = np.linalg.eigh(covariance[:2, :2])
    minor, major = np.sqrt(np.maximum(values, 0.0))
    heading = float(np.arctan2(vectors[1, 1], vectors[0, 1]))
    return {"major_m": _rounded(major), "minor_m": _rounded(minor), "heading_rad": _rounded(heading)}


def _search(looked: Search) -> dict[str, Any]:
    """Return the hypotheses: scores have a row for each yaw and a column for each ground distance."""
    on, found = SearchAxes.of(looked.patch), looked.found
    document: dict[str, Any] = {
        "base": _pose(on.base),
        "yaw_rad": _list(on.yaws(found.grid.turns)),
        "range_m": _list(on.ranges(found.grid.ranges)),
        "sideways_m": _list(found.grid.places),
        "upward_m": _list(found.grid.rises),
        "score": [_list(row) for row in found.score],
        "peaks": [
            {
                "pose": _pose(peak.pose),
                "range_m": _rounded(float(on.place(peak.pose)[1])),
                "score": _rounded(peak.score),
            }
            for peak in found.peaks
        ],
    }
    if looked.finer:
        document["closer"] = [_search(closer) for closer in looked.finer]
    return document


def _face(face: FaceEstimate, model: PalletModel) -> dict[str, Any]:
    return {
        "coverage": _rounded(face.coverage),
        "chi2": _rounded(face.chi2),
        "doubt": _rounded(face.doubt),
        "hidden_m": [_list(span) for span in face.seen.hidden],
        "edges": [_edge(account) for account in account_edges(face, model)],
    }


def _edge(account: EdgeAccount) -> dict[str, Any]:
    document: dict[str, Any] = {
        "number": account.number,
        "edge": str(account.edge.kind),
        "name": account.name,
        "fate": str(account.fate),
        "load_above": account.loaded,
        "weight": _rounded(account.weight),
    }
    if account.measured is not None:
        fit = account.measured.fit
        document |= {
            "offset_m": _rounded(fit.offset),
            "slope": _rounded(fit.slope),
            "sigma_m": _rounded(account.sigma),
            "coverage": _rounded(fit.coverage),
            "expected_m": _rounded(account.measured.shift.mean),
        }
    return document


def _pose(pose: LevelPose) -> dict[str, float | None]:
    return dict(zip(_AXES, _list(pose.as_array()), strict=True))


def _list(values: Sequence[float] | np.ndarray[Any, np.dtype[np.float64]]) -> list[float | None]:
    return [_rounded(float(value)) for value in values]


def _rounded(value: float) -> float | None:
    """Return seven significant digits; null for what JSON has no number for."""
    return float(f"{value:.7g}") if np.isfinite(value) else None
