"""Two runs over the same shots: which one has the smaller errors, and how sure that is."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from palletloc.evaluation.pose_error import COMPONENTS, PoseError
from palletloc.geometry import FloatArray

View = tuple[float, str]
"""A shot's time and a pallet's id."""


@dataclass(frozen=True, slots=True)
class PairedDifference:
    """How much larger the absolute errors of the second run are; negative where it is the better one."""

    mean: float
    """Mean over all views that both runs have, in the unit of the errors."""
    low: float
    """Lower end of its bootstrap interval; NaN where there is a single shot."""
    high: float
    """Upper end."""
    smaller: int
    """In how many views the second run's error is smaller."""
    larger: int
    """In how many it is larger."""


@dataclass(frozen=True, slots=True)
class RunComparison:
    """Two runs, view by view."""

    views: int
    """Views of a pallet in a shot that both runs have."""
    shots: int
    """Shots that they are of."""
    only_first: tuple[View, ...]
    """Views that only the first run has, in the order of time."""
    only_second: tuple[View, ...]
    """Views that only the second run has."""
    confidence: float
    """Of the intervals."""
    differences: dict[str, PairedDifference]
    """By component: depth, along and height in metres, yaw in radians. Empty without a common view."""


def compare_runs(
    first: Iterable[PoseError],
    second: Iterable[PoseError],
    confidence: float = 0.95,
    resamples: int = 2000,
    seed: int | np.random.Generator = 0,
) -> RunComparison:
    """Compare the absolute errors of two runs, paired by shot and pallet.

    Parameters
    ----------
    first, second : iterable of PoseError
        Of the same recording, matched with the same shots. Use `paired_difference` for several recordings.
    confidence : float
        Of the intervals, 0 to 1.
    resamples : int
        Bootstrap samples.
    seed : int or numpy.random.Generator
        The same seed gives the same interval; a generator goes on from where it is.

    Returns
    -------
    RunComparison
        Second minus first.

    Raises
    ------
    ValueError
        If a run has a pallet twice in a shot.
    """
    ours, theirs = _by_view(first), _by_view(second)
    common = sorted(ours.keys() & theirs.keys())
    only = [tuple(sorted(a.keys() - b.keys())) for a, b in ((ours, theirs), (theirs, ours))]
    times = np.array([time for time, _ in common])
    before, after = (np.array([np.abs(run[view].offset) for view in common]) for run in (ours, theirs))
    rng = np.random.default_rng(seed)
    differences = {
        name: paired_difference(before[:, column], after[:, column], times, confidence, resamples, rng)
        for column, name in enumerate(COMPONENTS)
        if common
    }
    return RunComparison(len(common), len(np.unique(times)), only[0], only[1], confidence, differences)


def _by_view(errors: Iterable[PoseError]) -> dict[View, PoseError]:
    views: dict[View, PoseError] = {}
    for error in errors:
        view = (error.time, error.face.id)
        if view in views:
            raise ValueError(f"pallet '{view[1]}' stands twice in the shot at {view[0]:.6g} s; expected one estimate")
        views[view] = error
    return views


def paired_difference(
    first: FloatArray,
    second: FloatArray,
    shots: ArrayLike,
    confidence: float = 0.95,
    resamples: int = 2000,
    seed: int | np.random.Generator = 0,
) -> PairedDifference:
    r"""Return the mean difference of paired values with a bootstrap interval.

    All values of a shot are drawn together, since they share the shot's errors: with
    :math:`d_i` the sum of the differences in shot *i* and :math:`n_i` their number, the mean is
    :math:`\sum d_i / \sum n_i` and shots are resampled. The interval is bias-corrected and accelerated (BCa:
    Efron, *Journal of the American Statistical Association* 82, 1987). Errors that last longer than a shot are
    not allowed for.

    Parameters
    ----------
    first, second : (n,) array
        Values of the same views, n at least 1.
    shots : (n,) array_like
        The shot of each value: its time or number.
    confidence, resamples, seed
        As for `compare_runs`.

    Returns
    -------
    PairedDifference
        Second minus first.
    """
    changes = np.asarray(second, dtype=np.float64) - np.asarray(first, dtype=np.float64)
    _, of_shot = np.unique(np.asarray(shots), return_inverse=True)
    sums = np.bincount(of_shot, changes).astype(np.float64)
    counts = np.bincount(of_shot).astype(np.float64)
    mean = float(sums.sum() / counts.sum())
    low, high = _interval(sums, counts, mean, confidence, resamples, np.random.default_rng(seed))
    return PairedDifference(mean, low, high, int((changes < 0).sum()), int((changes > 0).sum()))


def _interval(
    sums: FloatArray, counts: FloatArray, mean: float, confidence: float, resamples: int, rng: np.random.Generator
) -> tuple[float, float]:
    if len(sums) < 2:
        return float("nan"), float("nan")
    if np.allclose(sums, mean * counts, rtol=1e-12, atol=1e-300):
        return mean, mean  # every shot gives the same: nothing to resample

    def ratio(total: FloatArray, number: FloatArray, axis: int = -1) -> FloatArray:
        return np.asarray(total.sum(axis=axis) / number.sum(axis=axis))

    from scipy.stats import bootstrap  # takes longer to import than all of the evaluation

    drawn = bootstrap(
        (sums, counts),
        ratio,
        paired=True,
        vectorized=True,
        confidence_level=confidence,
        n_resamples=resamples,
        batch=max(1, 1_000_000 // len(sums)),
        method="BCa",
        rng=rng,
    )
    return float(drawn.confidence_interval.low), float(drawn.confidence_interval.high)
