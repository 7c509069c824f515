"""Which poses of a trajectory a relative error compares: a number of poses or a distance apart."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from palletloc.evaluation.errors import EvaluationError
from palletloc.evaluation.time_pairing import IntArray
from palletloc.geometry import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class StepPairs:
    """Poses at both ends of steps, by their indices."""

    first: IntArray
    """(k,) where each step begins."""
    last: IntArray
    """(k,) where it ends."""


def pairs_by_count(poses: int, delta: int, *, all_pairs: bool = False) -> StepPairs:
    """Return steps over a number of poses.

    Parameters
    ----------
    poses : int
        How many there are.
    delta : int
        Poses per step.
    all_pairs : bool
        Whether a step begins at every pose; otherwise each begins where the one before ends.

    Returns
    -------
    StepPairs
        In order.

    Raises
    ------
    ValueError
        If the step is not positive.
    EvaluationError
        If no step fits.
    """
    if delta < 1:
        raise ValueError(f"delta: expected 1 pose or more, got {delta}")
    first = np.arange(0, max(poses - delta, 0), 1 if all_pairs else delta, dtype=np.int64)
    return _require_some(StepPairs(first, first + delta), f"{delta} poses in {poses}")


def pairs_by_distance(
    positions: FloatArray, delta: float, *, all_pairs: bool = False, tolerance: float = 0.1
) -> StepPairs:
    """Return steps over a distance along the path, by the rules of evo.

    Consecutive steps begin at the first pose, and each ends at the first pose at which the way since its
    begin is at least ``delta``: steps are longer than asked, not shorter, and the rest of the path is in none.
    With ``all_pairs`` a step begins at every pose and ends at the later pose whose way is nearest to ``delta``.

    Parameters
    ----------
    positions : (n, 3) array
        Of the trajectory that the way is measured on, in metres: evo takes the estimate.
    delta : float
        Way per step, in metres.
    all_pairs : bool
        Whether a step begins at every pose.
    tolerance : float
        With ``all_pairs``, the largest deviation from ``delta``, as a part of it; steps beyond are left out.

    Returns
    -------
    StepPairs
        In order.

    Raises
    ------
    ValueError
        If the distance is not positive.
    EvaluationError
        If no step fits.
    """
    if not delta > 0:
        raise ValueError(f"delta: expected a positive distance, got {delta}")
    lengths = np.linalg.norm(np.diff(positions, axis=0), axis=1)
    steps = _nearest_steps(lengths, delta, tolerance) if all_pairs else _consecutive_steps(lengths, delta)
    return _require_some(steps, f"{delta:.6g} m in a path of {lengths.sum():.6g} m")


def _consecutive_steps(lengths: FloatArray, delta: float) -> StepPairs:
    ends, way = [0], 0.0
    for index, length in enumerate(lengths, start=1):
        way += float(length)
        if way >= delta:
            ends.append(index)
            way = 0.0
    marks = np.array(ends, dtype=np.int64)
    return StepPairs(marks[:-1], marks[1:])


def _nearest_steps(lengths: FloatArray, delta: float, tolerance: float) -> StepPairs:
    way = np.concatenate([[0.0], np.cumsum(lengths)])
    first = np.arange(len(lengths), dtype=np.int64)
    last = np.array([index + 1 + int(np.abs(way[index + 1 :] - way[index] - delta).argmin()) for index in first])
    kept = np.abs(way[last] - way[first] - delta) <= tolerance * delta if len(first) else np.zeros(0, dtype=bool)
    return StepPairs(first[kept], last.astype(np.int64)[kept])


def _require_some(steps: StepPairs, what: str) -> StepPairs:
    if not len(steps.first):
        raise EvaluationError(f"no step of {what}; expected a shorter step")
    return steps
