"""Short names by which pictures, tables and files speak of the candidates of one shot."""

from __future__ import annotations

import numpy as np

from palletloc.candidate import Candidate
from palletloc.localizer import Explanation

Named = tuple[tuple[str, Candidate], ...]
"""Candidates with their names."""


def name_candidates(explanation: Explanation) -> Named:
    """Give candidates short names: P1, P2, ... to pallets from left to right, C1, C2, ... to the others.

    Parameters
    ----------
    explanation : Explanation
        Of a shot.

    Returns
    -------
    tuple of (str, Candidate)
        Pallets first; the others by score, best first.
    """
    found = [one for one in explanation.candidates if one.refusal is None and one.pose is not None]
    others = [one for one in explanation.candidates if one.refusal is not None or one.pose is None]
    found.sort(key=_bearing, reverse=True)
    others.sort(key=lambda one: one.score, reverse=True)
    return (
        *((f"P{i}", one) for i, one in enumerate(found, start=1)),
        *((f"C{i}", one) for i, one in enumerate(others, start=1)),
    )


def given_up(candidate: Candidate) -> str:
    """Return what a title says of a candidate that was given up: where and why; nothing for a pallet."""
    if candidate.refusal is None:
        return ""
    stage, reason = candidate.refusal
    return f" (given up in {stage}: {str(reason).replace('_', ' ')})"


def _bearing(candidate: Candidate) -> float:
    pose = candidate.pose or candidate.start
    return float(np.arctan2(pose.y, pose.x))
