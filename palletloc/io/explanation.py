"""The file explain.json: every number of every stage of one shot."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from palletloc.candidate import Fit, Refusal, last_step, steps_of
from palletloc.explained import EdgeAccount, SearchAxes, account_edges
from palletloc.geometry import FloatArray, LevelPose
from palletloc.localizer import Explanation
from palletloc.pallet import PalletModel
from palletloc.paper.boundary import BoundaryLine
from palletloc.paper.joint_search import JointSearch
from palletloc.paper.position import Sweep
from palletloc.paper.yaw import YawEstimate
from palletloc.refinement.face_fit import FaceEstimate
from palletloc.refinement.search import Search

_AXES = ("x_m", "y_m", "z_m", "yaw_rad")
"""Keys of a pose's numbers, in the order of its covariance."""


def explanation_document(
    explanation: Explanation, named: Iterable[tuple[str, Fit | Refusal]], method: str
) -> dict[str, Any]:
    """Return what was found in a shot in a form that JSON can hold.

    Parameters
    ----------
    explanation : Explanation
        Of the shot.
    named : iterable of (str, Fit or Refusal)
        What became of its candidates, with their names.
    method : str
        How poses were measured.

    Returns
    -------
    dict
        Metres, radians and seconds, as the keys say; poses are ``forklift_from_pallet``. A stage that a
        candidate did not reach is absent.
    """
    return {
        "file": explanation.shot.file,
        "time_s": explanation.shot.time,
        "method": method,
        "pallets": len(explanation.measurements),
        "candidates": [_outcome(name, outcome) for name, outcome in named],
    }


def _outcome(name: str, outcome: Fit | Refusal) -> dict[str, Any]:
    candidate, fit = outcome.candidate, outcome.fit
    document: dict[str, Any] = {
        "name": name,
        "model": candidate.model.name,
        "detection_score": _rounded(candidate.score),
        "start": _pose(candidate.start),
    }
    if isinstance(outcome, Refusal):
        document["refused"] = {"stage": str(outcome.stage), "reason": str(outcome.reason)}
    if fit is not None:
        sigma = np.sqrt(np.diag(fit.covariance))
        document["pose"] = _pose(fit.pose) | {"yaw_from": str(fit.yaw_from)}
        document["sigma"] = dict(zip(_AXES, _list(sigma), strict=True))
        document["covariance"] = [_list(row) for row in fit.covariance]
        document["ellipse"] = _ellipse(fit.covariance)
    if lines := steps_of(outcome, BoundaryLine):
        document["hough_lines"] = [
            {"turn_rad": _rounded(line.turn), "up_m": _rounded(line.up), "votes": line.votes} for line in lines
        ]
    yaw, swept = last_step(outcome, YawEstimate), last_step(outcome, Sweep)
    joint, search = last_step(outcome, JointSearch), last_step(outcome, Search)
    parts = {
        "yaw": yaw and _yaw(yaw),
        "sweep": swept and _sweep(swept),
        "joint_search": joint and _joint(joint),
        "search": search and _search(search),
        "face": fit and fit.face and _face(fit.face, candidate.model),
    }
    document |= {key: part for key, part in parts.items() if part}
    if fit is not None and fit.evidence is not None:
        document["verification"] = {
            "contrast": _rounded(fit.evidence.contrast),
            "coverage": _rounded(fit.evidence.coverage),
            "score": _rounded(fit.evidence.score),
            "doubt": _rounded(fit.evidence.doubt),
            "hidden": _rounded(fit.evidence.hidden),
            "rank": _rounded(fit.evidence.probability),
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
