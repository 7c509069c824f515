"""Which samples of two series belong together by their times; what has no partner is left out, not invented."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from palletloc.errors import seconds
from palletloc.evaluation.pose_error import EvaluationError
from palletloc.geometry import FloatArray

IntArray = NDArray[np.int64]
"""Array of indices."""


@dataclass(frozen=True, slots=True, eq=False)
class TimePairs:
    """Samples of two series that belong together."""

    first: IntArray
    """(k,) indices in the first series."""
    second: IntArray
    """(k,) indices in the second series."""
    differences: FloatArray
    """(k,) time of the second minus that of the first, in seconds."""


@dataclass(frozen=True, slots=True, eq=False)
class Brackets:
    """Wanted times between samples."""

    wanted: IntArray
    """(k,) indices of the wanted times that lie between samples."""
    before: IntArray
    """(k,) index of the sample at or before each."""
    after: IntArray
    """(k,) index of the sample at or after each."""
    share: FloatArray
    """(k,) weight of ``after``, 0 to 1."""


def require_overlap(first: FloatArray, second: FloatArray, names: tuple[str, str], slack: float = 0.0) -> None:
    """Refuse two series that have no time in common.

    Parameters
    ----------
    first, second : (n,), (m,) array
        Times in seconds, in any order.
    names : (str, str)
        What the two are, for the message.
    slack : float
        How far apart they may be, in seconds.

    Raises
    ------
    EvaluationError
        If a series is empty or there is no common time.
    """
    for times, name in zip((first, second), names, strict=True):
        if not np.size(times):
            raise EvaluationError(f"{name}: no times; expected at least one")
    begin, end = float(max(np.min(first), np.min(second))), float(min(np.max(first), np.max(second)))
    if begin - end > slack:
        ends = seconds(*(float(end(times)) for times in (first, second) for end in (np.min, np.max)))
        spans = (
            f"{name} from {start} s to {stop} s"
            for name, start, stop in zip(names, ends[::2], ends[1::2], strict=True)
        )
        raise EvaluationError(
            f"{', '.join(spans)}: expected times that overlap; are they of one clock?"
            f" They are {begin - end:.12g} s apart"
        )


def nearest_pairs(first: FloatArray, second: FloatArray, limit: float) -> TimePairs:
    """Give each sample of the first series the nearest one of the second, where there is one within the limit.

    Several samples may get the same partner.

    Parameters
    ----------
    first, second : (n,), (m,) array
        Times in seconds, in any order.
    limit : float
        Largest difference, inclusive, in seconds.

    Returns
    -------
    TimePairs
        In the order of the first series; of two equally near samples the earlier in the second series.

    Raises
    ------
    ValueError
        If the limit is negative.
    """
    if limit < 0:
        raise ValueError(f"limit: expected 0 s or more, got {limit}")
    first, second = np.asarray(first, dtype=np.float64), np.asarray(second, dtype=np.float64)
    if not first.size or not second.size:
        none = np.zeros(0, dtype=np.int64)
        return TimePairs(none, none, np.zeros(0))
    order = np.argsort(second, kind="stable")
    partner = order[_nearest_in_order(first, second[order])]
    differences = second[partner] - first
    kept = np.flatnonzero(np.abs(differences) <= limit)
    return TimePairs(kept, partner[kept], differences[kept])


def _nearest_in_order(wanted: FloatArray, samples: FloatArray) -> IntArray:
    """Return the index of the nearest of ascending samples; the first of those equally near."""
    after = np.searchsorted(samples, wanted, side="left").clip(0, samples.size - 1)
    before = np.searchsorted(samples, samples[np.maximum(after - 1, 0)], side="left")
    earlier = np.abs(wanted - samples[before]) <= np.abs(samples[after] - wanted)
    return np.asarray(np.where(earlier, before, after))


def brackets(wanted: FloatArray, samples: FloatArray, limit: float) -> Brackets:
    """Find the samples before and after each wanted time.

    Parameters
    ----------
    wanted : (n,) array
        Times in seconds, in any order.
    samples : (m,) array
        Strictly increasing times in seconds.
    limit : float
        Largest distance of the two samples, in seconds: across a longer gap nothing is known.

    Returns
    -------
    Brackets
        Without the times outside the samples and those in too long a gap. A wanted time that is a sample's
        needs no second one.
    """
    wanted, samples = np.asarray(wanted, dtype=np.float64), np.asarray(samples, dtype=np.float64)
    after = np.searchsorted(samples, wanted, side="left")
    inside = np.flatnonzero((after < samples.size) & (wanted >= (samples[0] if samples.size else np.inf)))
    after = after[inside]
    before = np.where(samples[after] == wanted[inside], after, after - 1)
    gap = samples[after] - samples[before]
    kept = gap <= limit
    inside, before, after, gap = inside[kept], before[kept], after[kept], gap[kept]
    share = (wanted[inside] - samples[before]) / np.where(gap > 0, gap, 1.0)
    return Brackets(inside, before, after, share)
