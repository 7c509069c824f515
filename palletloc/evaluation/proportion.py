"""A proportion, and what it says of the probability behind it."""

from __future__ import annotations

from dataclasses import dataclass

from scipy.special import betaincinv


@dataclass(frozen=True, slots=True)
class Proportion:
    """How many of some trials succeeded, with an interval for the probability of success."""

    successes: int
    """Trials that succeeded."""
    trials: int
    """All of them."""
    confidence: float
    """Of the interval, 0 to 1."""
    low: float
    """Its lower end."""
    high: float
    """Its upper end."""

    @property
    def value(self) -> float:
        """Part that succeeded, 0 to 1; NaN without a trial."""
        return self.successes / self.trials if self.trials else float("nan")


def clopper_pearson(successes: int, trials: int, confidence: float = 0.95) -> Proportion:
    r"""Return a proportion with its two-sided Clopper-Pearson interval.

    The ends are where a binomial tail holds half of what is left of the confidence:

    .. math:: P(X \ge k \mid p_\text{low}) = P(X \le k \mid p_\text{high}) = \alpha/2,
              \qquad X \sim \operatorname{Bin}(n, p), \quad \alpha = 1 - \text{confidence}

    (Clopper and Pearson, *Biometrika* 26, 1934). They are quantiles of the beta distribution. The interval
    covers the true probability at least as often as it says, if the trials are independent.

    Parameters
    ----------
    successes : int
        k, 0 to ``trials``.
    trials : int
        n; without a trial the interval is 0 to 1.
    confidence : float
        0 to 1.

    Returns
    -------
    Proportion
        The counts with the interval.

    Raises
    ------
    ValueError
        If the counts or the confidence are out of range.

    Examples
    --------
    >>> found = clopper_pearson(59, 59)
    >>> round(found.low, 3), found.high
    (0.939, 1.0)
    """
    _require_counts(successes, trials, confidence)
    tail = (1 - confidence) / 2
    return Proportion(
        successes,
        trials,
        confidence,
        lower_bound(successes, trials, 1 - tail),
        upper_bound(successes, trials, 1 - tail),
    )


def lower_bound(successes: int, trials: int, confidence: float) -> float:
    """Return the one-sided lower Clopper-Pearson bound of a probability.

    Parameters
    ----------
    successes, trials : int
        As for `clopper_pearson`.
    confidence : float
        Least probability with which the bound is below the true value.

    Returns
    -------
    float
        0 to 1. With n of n successes it is ``(1 - confidence) ** (1 / n)``.
    """
    _require_counts(successes, trials, confidence)
    return float(betaincinv(successes, trials - successes + 1, 1 - confidence)) if successes else 0.0


def upper_bound(successes: int, trials: int, confidence: float) -> float:
    """Return the one-sided upper Clopper-Pearson bound of a probability; see `lower_bound`."""
    _require_counts(successes, trials, confidence)
    return float(betaincinv(successes + 1, trials - successes, confidence)) if successes < trials else 1.0


def _require_counts(successes: int, trials: int, confidence: float) -> None:
    if not 0 <= successes <= trials:
        raise ValueError(f"expected 0 to {trials} successes in {trials} trials, got {successes}")
    if not 0 < confidence < 1:
        raise ValueError(f"confidence: expected a number between 0 and 1, got {confidence}")
