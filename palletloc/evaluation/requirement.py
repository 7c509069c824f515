"""A requirement on the pose errors, and whether a run meets it at a stated confidence."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from palletloc.evaluation.statistics import Proportion, clopper_pearson, lower_bound, upper_bound
from palletloc.geometry import FloatArray


class Verdict(StrEnum):
    """Whether a requirement is met."""

    MET = "met"
    """At the confidence, at least the required share of errors is inside the limit."""
    NOT_MET = "not_met"
    """At the confidence, fewer are."""
    UNDECIDED = "undecided"
    """There are too few errors to say."""


@dataclass(frozen=True, slots=True)
class Requirement:
    """How large errors may be, how often, and how sure one wants to be of it.

    Raises
    ------
    ValueError
        If a limit is not positive, or the share or the confidence is not between 0 and 1.
    """

    depth: float = 0.02
    """Largest absolute error into the pallet, in metres; infinite for no limit, here and below."""
    along: float = 0.02
    """Largest absolute error along the front, in metres."""
    height: float = 0.02
    """Largest absolute error of the height, in metres."""
    yaw: float = math.radians(2.0)
    """Largest absolute error of the yaw, in radians."""
    share: float = 0.95
    """Part of all errors that has to be inside, between 0 and 1."""
    confidence: float = 0.95
    """Of the intervals and the verdict, between 0 and 1."""

    def __post_init__(self) -> None:
        """Check the limits."""
        for name in ("depth", "along", "height", "yaw"):
            if not getattr(self, name) > 0:
                raise ValueError(f"requirement.{name}: expected a positive limit, got {getattr(self, name)}")
        for name in ("share", "confidence"):
            if not 0 < getattr(self, name) < 1:
                raise ValueError(f"requirement.{name}: expected a part between 0 and 1, got {getattr(self, name)}")

    @property
    def limits(self) -> FloatArray:
        """(4,) of depth, along and height in metres, and of yaw in radians."""
        return np.array([self.depth, self.along, self.height, self.yaw])


@dataclass(frozen=True, slots=True)
class Check:
    """One quantity against its limit."""

    proportion: Proportion
    """How many errors are inside, with a two-sided interval."""
    verdict: Verdict
    """By the one-sided bounds at the same confidence."""
    needed: int
    """How many errors there have to be until the requirement is met, if no more than now are outside; where it is met
    or not met, as many as there are."""

    @property
    def decision(self) -> str:
        """What is missing for a verdict, in words; empty where there is one."""
        if self.verdict is not Verdict.UNDECIDED:
            return ""
        there, outside = self.proportion.trials, self.proportion.trials - self.proportion.successes
        return f"{self.needed} errors decide if no more than {outside} are outside; there are {there}"


@dataclass(frozen=True, slots=True)
class RequirementCheck:
    """A run against a requirement."""

    requirement: Requirement
    """What was asked."""
    missed: int
    """Pallets that were not found and count as outside; see `check_requirement`."""
    depth: Check
    """Into the pallet."""
    along: Check
    """Along its front."""
    height: Check
    """Up."""
    yaw: Check
    """The heading."""
    together: Check
    """All four at once: the verdict on the run."""


def check_requirement(
    offsets: FloatArray, requirement: Requirement | None = None, missed: int = 0
) -> RequirementCheck:
    """Count the errors that are inside the limits, and say what follows.

    A requirement is met where the one-sided lower bound of the probability to be inside is at least the
    required share, and not met where the upper bound is below it. With no error outside, 59 independent
    errors show a share of 95 % at a confidence of 95 %. Shots of one approach share errors; what they show
    holds for that approach, not for the next.

    Parameters
    ----------
    offsets : (n, 4) array
        Errors of depth, along and height in metres, and of yaw in radians.
    requirement : Requirement, optional
        By default 2 degrees and 2 cm in each direction.
    missed : int
        Pallets that should have been found and were not, to count as outside; 0 leaves them out.

    Returns
    -------
    RequirementCheck
        Each quantity, and all together.

    Raises
    ------
    ValueError
        If the shape does not fit.
    """
    offsets = np.asarray(offsets, dtype=np.float64)
    if offsets.ndim != 2 or offsets.shape[1] != 4:
        raise ValueError(f"offsets: expected (n, 4), got {offsets.shape}")
    asked = requirement or Requirement()
    inside = np.abs(offsets) <= asked.limits
    trials = len(offsets) + missed

    def check(count: int) -> Check:
        verdict = _verdict(count, trials, asked)
        needed = needed_errors(trials - count, asked) if verdict is Verdict.UNDECIDED else trials
        return Check(clopper_pearson(count, trials, asked.confidence), verdict, needed)

    depth, along, height, yaw = (check(int(count)) for count in inside.sum(axis=0))
    return RequirementCheck(asked, missed, depth, along, height, yaw, check(int(inside.all(axis=1).sum())))


def needed_errors(outside: int, requirement: Requirement) -> int:
    """Return how many errors show that a requirement is met, where some of them are outside.

    Parameters
    ----------
    outside : int
        How many.
    requirement : Requirement
        Its share and confidence.

    Examples
    --------
    >>> [needed_errors(outside, Requirement()) for outside in (0, 1, 2)]
    [59, 93, 124]
    """

    def is_met(total: int) -> bool:
        return lower_bound(total - outside, total, requirement.confidence) >= requirement.share

    enough = outside + 1
    while not is_met(enough):
        enough *= 2
    low = max(outside, enough // 2)
    while enough - low > 1:
        middle = (low + enough) // 2
        low, enough = (low, middle) if is_met(middle) else (middle, enough)
    return enough


def _verdict(inside: int, trials: int, asked: Requirement) -> Verdict:
    if lower_bound(inside, trials, asked.confidence) >= asked.share:
        return Verdict.MET
    return Verdict.NOT_MET if upper_bound(inside, trials, asked.confidence) < asked.share else Verdict.UNDECIDED
