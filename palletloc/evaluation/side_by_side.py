"""Several runs over one recording, each against the first."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from palletloc.evaluation.evaluated_run import EvaluatedRun
from palletloc.evaluation.paired_comparison import RunComparison, compare_runs

SEED = 0
"""Of the bootstrap: the same runs give the same intervals."""
RESAMPLES = 2000
"""How many bootstrap samples are drawn."""


@dataclass(frozen=True, slots=True, eq=False)
class ComparedRuns:
    """One source of two runs, paired by shot and pallet."""

    first: str
    """Name of the run that is compared with."""
    second: str
    """Name of the run that is compared."""
    source: str
    """Name of the source that both have."""
    comparison: RunComparison
    """Second minus first."""


def side_by_side(runs: Sequence[EvaluatedRun]) -> tuple[ComparedRuns, ...]:
    """Compare every run with the first one, for each source that both have.

    Parameters
    ----------
    runs : sequence of EvaluatedRun
        Over one recording, with the same settings.

    Returns
    -------
    tuple of ComparedRuns
        Empty for a single run.
    """
    return tuple(
        ComparedRuns(
            runs[0].files.name,
            run.files.name,
            name,
            compare_runs(runs[0].sources[name].errors, source.errors, resamples=RESAMPLES, seed=SEED),
        )
        for run in runs[1:]
        for name, source in run.sources.items()
        if name in runs[0].sources
    )
