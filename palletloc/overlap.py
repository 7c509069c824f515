"""One pallet in one place: of the candidates of a shot that stand in each other, the likeliest set stays.

Different models, or the same one on different levels, may fit the same face; and along a viewing ray a face nearer to
the camera covers the same part of the image as a larger one behind it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from palletloc.candidate import Fit, Refusal
from palletloc.footprint import outline, overlaps
from palletloc.measurement import Reason, Stage
from palletloc.rivals import FAR_APART
from palletloc.verification import VerificationConfig, verify

MOST_RIVALS = 16
"""Most candidates in one heap of which the likeliest are looked for; the least likely ones beyond are given up. The
search takes up to two to the power of this many steps."""
STEEP = 30
"""Power of scores from which on the highest one outweighs others that are lower by a few hundredths."""


def exclude_overlaps(outcomes: Sequence[Fit | Refusal], config: VerificationConfig) -> list[Fit | Refusal]:
    """Refuse fits that stand in each other until no two do: those stay that together are the likeliest.

    Two pallets side by side outweigh one that would stand in both. What shows a pallet's blocks and openings but was
    given up for its edges or its height keeps its place, too: whatever else is found there is that pallet, seen
    wrongly. Where it was given up as uncertain, though, another fit of about the same pose may be of use.

    Parameters
    ----------
    outcomes : sequence of Fit or Refusal
        All of one shot.
    config : VerificationConfig
        Tells what shows a pallet.

    Returns
    -------
    list of Fit or Refusal
        In the same order.
    """
    standing = [(i, outcome.fit) for i, outcome in enumerate(outcomes) if _stands(outcome, config)]
    places = sorted(((i, fit) for i, fit in standing if fit is not None), key=lambda place: -place[1].rank)
    if not places:
        return list(outcomes)
    poses = np.array([fit.pose.as_array() for _, fit in places])
    outlines = np.array([outline(fit.candidate.model) for _, fit in places])
    clash = overlaps(poses[:, None], outlines[:, None], poses, outlines)
    clash = (clash | clash.T) & ~np.eye(len(places), dtype=bool)
    for i, j in np.argwhere(np.triu(clash)).tolist():
        clash[i, j] = clash[j, i] = not _one_of_use(outcomes[places[i][0]], outcomes[places[j][0]])
    weights = [_weight(fit) for _, fit in places]
    stays = _likeliest(weights, [frozenset(np.flatnonzero(row).tolist()) for row in clash])
    kept = list(outcomes)
    for k, (i, fit) in enumerate(places):
        if k not in stays and isinstance(outcomes[i], Fit):
            kept[i] = Refusal(fit.candidate, Stage.VERIFICATION, Reason.OVERLAP, fit, fit.steps)
    return kept


def _stands(outcome: Fit | Refusal, config: VerificationConfig) -> bool:
    """Tell whether something keeps its place: a fit, or a pallet that was given up."""
    if isinstance(outcome, Fit):
        return True
    if outcome.fit is None or outcome.reason is Reason.OVERLAP:
        return False
    if outcome.fit.evidence is None:  # a coarse pose of what may be a pallet
        return outcome.reason in {Reason.UNCERTAIN, Reason.OFF_LEVEL}
    return verify(outcome.fit.evidence, config) is None


def _weight(fit: Fit) -> float:
    """Return what a fit counts against others in its place: the evidence of what is seen of it, in nats.

    A mere score is no evidence, so that two lower ones do not add up to more than a higher one.
    """
    return fit.candidate.score**STEEP if fit.evidence is None else fit.evidence.visible


def _one_of_use(outcome: Fit | Refusal, other: Fit | Refusal) -> bool:
    """Tell whether of two poses of one pallet, as far as their fits can tell, one alone was given up as uncertain."""
    given_up = [isinstance(each, Refusal) and each.reason is Reason.UNCERTAIN for each in (outcome, other)]
    if sum(given_up) != 1 or outcome.fit is None or other.fit is None:
        return False
    face, other_face = outcome.fit.face, other.fit.face
    if face is None or other_face is None:
        return False
    apart = face.forklift_from_pallet.minus(other_face.forklift_from_pallet)
    return bool(apart @ np.linalg.solve(face.covariance + other_face.covariance, apart) < FAR_APART**2)


def _likeliest(weights: Sequence[float], clashes: Sequence[frozenset[int]]) -> frozenset[int]:
    """Return which of some candidates stay, so that none clash and their weights sum up to the most."""
    left, stays = set(range(len(weights))), frozenset[int]()
    while left:
        group, found = {min(left)}, {min(left)}
        while found:
            found = set().union(*(clashes[i] for i in found)) - group
            group |= found
        left -= group
        stays |= _best(sorted(group, key=lambda i: -weights[i])[:MOST_RIVALS], weights, clashes)[1]
    return stays


def _best(
    among: Sequence[int], weights: Sequence[float], clashes: Sequence[frozenset[int]]
) -> tuple[float, frozenset[int]]:
    """Return the greatest sum of weights without a clash, and whose; of equal ones that with the first."""
    if not among:
        return 0.0, frozenset()
    first, rest = among[0], among[1:]
    weight, chosen = _best([i for i in rest if i not in clashes[first]], weights, clashes)
    with_it = weight + weights[first], chosen | {first}
    if not clashes[first].intersection(rest):
        return with_it
    without = _best(rest, weights, clashes)
    return with_it if with_it[0] >= without[0] else without
